"""Fixed budget: how good a method is after so many evaluations, and during the run."""
