"""One search of `fmincon`: `run` takes it from start to exit flag, and its state is a value.

`sqp` and `interior_point` are SciPy's two algorithms, `walk` answers what they ask, `state` is where a search stands,
`endings` how it ends, `told` what it shows along the way.
"""
