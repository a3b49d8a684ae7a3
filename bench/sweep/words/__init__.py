"""The words of a command line: read, composed with conf/, and turned into values or refused."""
