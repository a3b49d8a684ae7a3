"""One run: what is asked for, what came of it, and the row that is kept."""
