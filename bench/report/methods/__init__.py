"""The tables of docs/optimizers.md: what each method of NLopt and pygmo gets, and why."""
