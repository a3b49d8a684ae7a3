"""One run: the gate that counts every evaluation, the row that comes of it, its id, its seeds and its time limit."""
