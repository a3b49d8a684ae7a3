"""NLopt's algorithms, each under its own name: ``nlopt_LN_BOBYQA`` is NLopt's LN_BOBYQA.

`_table` has the traits of each, `settings` the parameters of each and the reasons, `adapter` runs one, `algorithms`
registers them with the options of their family.
"""

from calibench.optimizers.nlopt import algorithms  # noqa: F401  (they register themselves)
