"""The catalogue: a family of effects a file."""
