"""The gate: every candidate of every optimiser passes it. It alone counts, refuses, and ends a run in time."""
