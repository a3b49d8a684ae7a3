"""Commands on machines: identify, discover, calibrate, design."""
