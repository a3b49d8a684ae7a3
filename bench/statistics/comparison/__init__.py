"""Which of two or of many is better, as far as the runs can tell: tests, effect sizes, verdicts."""
