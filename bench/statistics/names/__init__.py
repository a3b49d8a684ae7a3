"""What problems, cells and methods are called beside each other."""
