"""Fixed budget: how good a method is after so many evaluations, and on the whole way there."""
