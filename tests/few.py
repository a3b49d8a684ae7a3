"""Cases of a law of which some are quick, and the others are run by `make slow`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest

from calibench import optimizers


def few(quick: int, cases: Iterable[Any]) -> list[Any]:
    """Return the cases of a parametrised test, all but the first `quick` of them marked as slow.

    A tuple is the values of several arguments, as `pytest.mark.parametrize` has it.
    """
    return [case if k < quick else _slow(case) for k, case in enumerate(cases)]


def one_of_each(methods: Iterable[str]) -> list[Any]:
    """Return names of optimisers: slow is who has the library and the traits of one before.

    Our own methods are all quick.
    """
    seen: set[tuple[str, str]] = set()
    marked = []
    for name in methods:
        library = name.partition("_")[0] if name.startswith(("nlopt_", "pygmo_", "scipy_")) else name
        told = (library, str(optimizers.make(name).traits))
        marked.append(_slow(name) if told in seen else name)
        seen.add(told)
    return marked


def _slow(case: Any) -> Any:
    if hasattr(case, "marks"):
        return pytest.param(*case.values, marks=[*case.marks, pytest.mark.slow], id=case.id)
    return pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.slow)
