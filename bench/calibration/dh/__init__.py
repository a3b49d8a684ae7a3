"""What is wrong in a table of Denavit and Hartenberg that readings do not fit: which change of it cures that."""
