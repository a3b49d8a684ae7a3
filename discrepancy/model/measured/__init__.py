"""What was measured: columns of readings, the instruments that gave them, and which rows are complete."""
