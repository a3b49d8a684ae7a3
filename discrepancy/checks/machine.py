"""Refuse an object that is not a machine, in one line, before any method of it is called."""

from __future__ import annotations

import inspect

from calibench.discrepancy.model.measured.data import DataError

_FORMULATE = "formulate(data), which returns Predicted(...) or Constraints(...)"


def refuse_no_machine(machine: object, told: str = "") -> None:
    """Raise `DataError` for an object without `name` or without a `formulate` that takes data.

    `told` is what the user wrote.
    """
    if isinstance(machine, type):
        raise DataError(
            f"{told or 'machine'}: {machine.__name__} is a class; {machine.__name__}(), one of it, is needed"
        )
    told = told or f"machine: {type(machine).__name__}"
    formulate = getattr(machine, "formulate", None)
    if not callable(formulate):
        raise DataError(f"{told}: it has no {_FORMULATE}")
    try:
        inspect.signature(formulate).bind(None)
    except TypeError:
        raise DataError(f"{told}: formulate{inspect.signature(formulate)} does not take the data; "
                        f"def formulate(self, data) is needed") from None  # fmt: skip
    except ValueError:
        pass  # the signature of a function in C cannot be read
    if not isinstance(name := getattr(machine, "name", None), str) or not name:
        raise DataError(f'{told}: it has no name; name = "..." in the class says what a page calls it')
