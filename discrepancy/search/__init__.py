"""The search: effects are selected stepwise, each with the set that data cannot tell from it; then the verdict.

`stepwise` is the loop and the verdict, `select` chooses and refits, `form` asks how far a formula is off, `finding`
describes one pick, `smoother` is the model where no name fits.
"""
