"""Names of problems, cells and methods, and their order."""
