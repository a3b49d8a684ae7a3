"""The noise of the readings: its propagation into the constraints, its estimation from repeats, other distributions.

`whiten` propagates noise into the constraints and removes it again, `repeats` compares readings of one pose, `laws`
fits outlying readings, coarse steps and heavy tails.
"""
