"""Sweeps: a command line becomes a list of runs; runs that are done are skipped, and the rest are executed."""
