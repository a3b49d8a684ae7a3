"""The Hydra configuration: what a command line may choose. Problems and optimisers come from the registries."""

from calibench._checkout import one_module

one_module(__name__)
