"""The compiled kernels of an arm, and a chain and its readings as they take them."""
