"""What belongs to a fixed target besides ERT itself: its interval, restarts that are simulated, profiles."""
