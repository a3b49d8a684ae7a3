"""The model: a machine, its data and its effects, before anything is fitted.

`measured` holds columns of readings and their instruments, `machine` the protocols of a machine and its constraints,
`description` its units, words and plans, `roles` its parts, `formulations` the ready-made formulations, `effect` and
`family` what an effect is, `linear` and `change_point` the two usual forms, `model` the constraints with effects added
and all derivatives.
"""
