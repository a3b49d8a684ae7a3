"""What is asked for: checked once, named, and made ready for all runs of a pair."""
