"""Statistics of a fixed target besides ERT itself: its interval, simulated restarts, profiles."""
