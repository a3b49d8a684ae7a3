"""What a calibration tells: the calibrated URDF, what it changes, words, JSON and a page."""
