"""Files that survive a kill: written whole or appended by checksummed lines, by one process at a time."""
