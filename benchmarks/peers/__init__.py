"""Other ways to close the gap between a model and data, on the same sealed cases."""
