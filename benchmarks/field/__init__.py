"""The field of all methods, run twice: what a change of adapters, defaults or methods did to each, method by method."""
