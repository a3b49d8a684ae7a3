"""Hand-eye and robot-world calibration: a table of a robot's poses and of a board's poses gives both unknown frames."""
