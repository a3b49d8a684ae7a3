"""pygmo's algorithms, each under its own name: ``pygmo_de`` is pygmo's de.

`population_sizes` says how many members each has and why, `adapter` runs one, `populations` and `trajectories` register
them: those that evolve a random population, and those that move one point from the start.
"""

from calibench.optimizers.pygmo import populations, trajectories  # noqa: F401  (they register themselves)
