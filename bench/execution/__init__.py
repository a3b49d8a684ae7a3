"""One run: the request, the execution, and the row that is kept."""
