"""Values that hold functions made within functions, such as an effect of the catalogue, and how they are pickled.

Python pickles a function by its name alone. Here one that no other process finds by its name goes into the pickle
whole, and so does what a user's own file defines. Such a pickle is read by the same minor version of Python.
"""

import copyreg
import pickle
import sys
from importlib import import_module
from io import BytesIO
from typing import Any

from calibench.core import user_file


def by_value(self: Any) -> tuple[Any, ...]:
    """Return how `self` is pickled: `__reduce__` of its class."""
    cloudpickle: Any = import_module("numba.cloudpickle")  # numba is heavy, and most values are never pickled

    class Whole(cloudpickle.Pickler):  # type: ignore[misc]
        def reducer_override(self, value: Any) -> Any:
            if getattr(type(value), "__reduce__", None) is by_value:  # its arrays are those of the value it stands in
                return copyreg.__newobj__, (type(value),), vars(value)  # type: ignore[attr-defined]
            return super().reducer_override(value)

    for module in (one for one in user_file.LOADED.values() if sys.modules.get(one.__name__) is one):
        cloudpickle.register_pickle_by_value(module)
    Whole(written := BytesIO()).dump(vars(self))
    return _read, (type(self), written.getvalue())


def _read(kind: type[Any], written: bytes) -> Any:
    value: Any = object.__new__(kind)
    vars(value).update(pickle.loads(written))
    return value
