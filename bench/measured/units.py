"""Units of measured columns, as the machines declare them; any other column is in the unit that its file states."""

from __future__ import annotations

from types import MappingProxyType

from calibench.core.units import factor_to_base
from calibench.discrepancy.labels import column_units

COLUMN_UNITS = MappingProxyType(column_units())


def factor(column: str, unit: str) -> tuple[str, float]:
    """Return the unit in which `column` is kept and the factor that turns `unit` into it.

    >>> factor("x", "m")
    ('mm', 1000.0)

    Raises `ValueError` with the column, the unit and the choices for one that is unknown or of another kind.
    """
    return factor_to_base(column, unit, COLUMN_UNITS.get(column))
