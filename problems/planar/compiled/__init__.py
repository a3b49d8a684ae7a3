"""The compiled kernels of the GPM2002, and how they are called."""
