"""Protection of the counters from an optimiser: walls, a private class, a hook for attempts to look behind them."""
