"""The drawings of the pages in axes of your own, and the numbers behind each.

`convergence`, `ecdf`, `profile`, `ranks` and `heatmap` take what runs are kept in: a `ResultStore`, the path of its
folder, a table of runs, a `Run` or several. `discovery` takes the report of a search, `calibration` a
calibration.json. Each draws into `ax`, or into a figure of its own, and returns the axes; ``plot.NAME.data(...)``
returns the numbers as a DataFrame. Neither pyplot nor your rcParams are touched.

>>> from calibench import execute, optimizers, plot, problems
>>> runs = [execute(problems.make("sensor_zero"), optimizers.make(name), budget=200) for name in ("lm", "trf")]
>>> plot.convergence(runs).get_xlabel()
'charged evaluations'
"""

from calibench.core.lazy import public_names
from calibench.plot.reports import calibration, discovery
from calibench.plot.studies import convergence, ecdf, heatmap, profile, ranks

__all__ = ["calibration", "convergence", "discovery", "ecdf", "heatmap", "profile", "ranks"]
__dir__ = public_names(__all__)
