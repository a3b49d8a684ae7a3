"""Tests of the blind test data, and of how verdicts are scored."""
