"""The search: effects are selected stepwise, each with the set that data cannot tell from it; then the verdict.

`stepwise` is the loop and the verdict, `select` chooses and refits, `screening` spares fits of very many readings,
`alternatives` adds what is never named by itself, `finding` puts one pick into words, `smoother` is the fallback where
no name fits.
"""
