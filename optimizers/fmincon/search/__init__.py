"""One search of `fmincon`: `run` takes it from start to exit flag, and its state is a value.

`sqp` and `interior_point` are SciPy's two algorithms, `walk` answers their calls, `state` is the state of a search,
`endings` its possible ends, `told` its display.
"""
