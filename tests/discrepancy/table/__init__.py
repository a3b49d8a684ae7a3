"""A table of columns with a base function."""
