"""What keeps an optimiser from the counters: walls, a class of its own, a hook for what looks behind them."""
