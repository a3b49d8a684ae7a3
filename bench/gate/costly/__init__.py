"""For evaluations that take long: batches in several processes, and values that a killed run goes on from."""
