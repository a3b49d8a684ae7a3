"""The model: a machine, its data and its effects, before anything is fitted.

`data` holds measured columns, `machine` the protocols of a machine and its constraints, `sensor` its instruments,
`description` its units, words and plans, `constraints` a ready-made formulation, `effect` and `family` what an effect
is, `linear` and `change_point` the two usual forms, `model` the constraints with effects added and all derivatives.
"""
