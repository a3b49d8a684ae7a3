"""Units of measured columns, as the machines declare them; any other column is in the unit that its file states."""

from __future__ import annotations

from types import MappingProxyType

from calibench.core.tables.units import factor_to_base
from calibench.discrepancy.labels import column_units
from calibench.discrepancy.registries import description_of, descriptions

COLUMN_UNITS = MappingProxyType(column_units())


def units_of(machine: str) -> dict[str, str]:
    """Return column -> unit of the files of one machine, as it declares them; nothing for one that declares nothing."""
    return {column.name: column.unit for column in description_of(machine).columns if column.unit}


def factor(column: str, unit: str, machine: str = "") -> tuple[str, float]:
    """Return the unit in which `column` of `machine` is kept and the factor that turns `unit` into it.

    >>> factor("x", "m")
    ('mm', 1000.0)

    Raises `ValueError` with the column, the unit, the choices and the way out for one that is unknown or of another
    kind; a machine whose files keep their own units takes any. The sensors of a machine that declares no columns may
    want another unit of the same kind (`Sensor.unit`).
    """
    if machine in descriptions() and description_of(machine).own_units:
        return unit, 1.0
    needed = (units_of(machine) if machine in descriptions() else {}) if machine else dict(COLUMN_UNITS)
    try:
        return factor_to_base(column, unit, needed.get(column))
    except ValueError as error:
        way_out = f'units={{"{column}": "UNIT"}} states it where the file cannot be changed'
        raise ValueError(f"{error}; {way_out}") from None
