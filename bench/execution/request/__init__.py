"""The request of a run: checked once, named, and prepared for all runs of a problem and an optimiser."""
