"""The project's own optimisers, written from Cong et al. 2008: `de`, `ga`, `pso` and `nine_point`.

The steps of a method stand in compiled modules (`_differential_kernels` and so on); the method's module has its options
and its loop.
"""

from calibench.optimizers.own import differential, genetic, nine_point, swarm  # noqa: F401  (they register themselves)
