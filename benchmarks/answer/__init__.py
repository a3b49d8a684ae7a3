"""Which optimiser for robot calibration: the study `calibration24` as one compact table, and the page that it makes."""
