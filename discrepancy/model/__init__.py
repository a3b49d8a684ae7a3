"""The model: a machine, its data and its effects, before anything is fitted.

`measured` holds columns of readings and their instruments, `machine` the protocols of a machine and its constraints,
`roles` its parts, `formulations` the ready-made formulations, `effect` what an effect is, `model` the constraints with
effects added and all derivatives.
"""
