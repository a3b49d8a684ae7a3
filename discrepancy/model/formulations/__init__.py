"""Ready-made formulations: a machine as constraints, as predictions, or as blocks of several kinds of readings."""
