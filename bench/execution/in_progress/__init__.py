"""How far a run is while it runs: read by another thread, told as files and lines."""
