"""The noise of the readings: its propagation into the constraints, its estimation from repeats, other distributions.

`whiten` propagates noise into the constraints and removes it again, `repeats` compares readings of one pose, `mixture`
and `laws` fit outlying readings, coarse steps and heavy tails, `size` estimates how large they are.
"""
