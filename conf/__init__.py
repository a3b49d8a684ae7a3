"""The Hydra configuration: what a command line may choose. Problems and optimisers come from the registries."""
