"""The project's own optimisers, written from Cong et al. 2008: `de`, `ga`, `pso` and `nine_point`.

The steps of a method stand in compiled modules (`_differential_kernels` and so on), its options and its loop in
`population` or `nine_point`.
"""

from calibench.optimizers.own import nine_point, population  # noqa: F401  (they register themselves)
