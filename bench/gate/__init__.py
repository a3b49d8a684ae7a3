"""The gate: every candidate of every optimiser passes it, and it alone counts, refuses, and ends a run in time."""
