"""Progress of a run while it runs: read by another thread, shown as files and lines."""
