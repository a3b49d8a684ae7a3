"""The noise of the readings: how it enters the constraints, what repeats tell of it, and other distributions.

`whiten` carries noise into the constraints and out again, `repeats` compares readings of one pose, `mixture` and `laws`
fit outlying readings, coarse steps and heavy tails, `size` tells how large they are.
"""
