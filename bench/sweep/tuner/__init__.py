"""A sweep whose next setting is proposed from the scores of those before: Optuna over the options of one optimiser."""
