"""What a table declares for commands and pages: what may be stated, and which general families it has otherwise."""

from __future__ import annotations

from pathlib import Path

from calibench.discrepancy.model.description import Description, Stated
from calibench.discrepancy.registries import describe

# drift and step are its own, and a trend is told by its powers
_REPLACED = ("polynomial", "instrument_scale", "instrument_lag", "frame_drift", "frame_shift")

describe(
    "table",
    Description(
        stated=(Stated("periods", "names", 'periods={"month":12}'),),
        demonstrations=Path(__file__).resolve().parents[2] / "demo" / "table",
        replaced=_REPLACED,
        part_of=str,
        own_units=True,
    ),
)
