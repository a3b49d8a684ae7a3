"""Write the nights that ship as ``data=demo_...``: ``python -m tests.independent.write_mount_demonstrations``.

The simulator shares nothing with the machine. ``discrepancy/demo/README.md`` tells what is hidden, the files do not.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calibench import discrepancy
from tests.independent.mount import Case, case

DEMO = Path(discrepancy.__file__).resolve().parent / "demo" / "mount"
NIGHTS = {"demo_flexure": (3, "TF"), "demo_still": (5, "")}  # name -> seed, fault


def main() -> None:
    """Write the nights as TheSky writes them: an equatorial mount, stars and readings in sexagesimal numbers."""
    DEMO.mkdir(parents=True, exist_ok=True)
    for name, (seed, fault) in NIGHTS.items():
        night = case(seed, only=fault, altaz=False, visible=3.0)
        (DEMO / f"{name}.dat").write_text(tpoint_text(night))


def tpoint_text(night: Case) -> str:
    """Return an equatorial night as a file of TheSky."""
    columns = {key: np.degrees(value) if key != "t_s" else value for key, value in night.columns.items()}
    lines = ["!a simulated night", "demonstration", ":NODA", ":EQUAT",
             f"{_sexagesimal(night.stated['latitude_deg'], 0)} 2025 3 14 5.0 990.0 200.0 0.6 0.55 0.0065"]  # fmt: skip
    for ha, dec, star_ha, star_dec, t in zip(*(columns[n] for n in ("ha", "dec", "star_ha", "star_dec", "t_s"))):
        sidereal = (9.0 + t / 3590.17) % 24
        places = (
            _sexagesimal((sidereal - star_ha / 15) % 24, 4), _sexagesimal(star_dec, 3, signed=True),
            _sexagesimal((sidereal - ha / 15) % 24, 4), _sexagesimal(dec, 3, signed=True),
        )  # fmt: skip
        lines.append(f"{' '.join(places)}  {int(sidereal):02d} {60 * (sidereal % 1):08.5f}")
    return "\n".join([*lines, "END", ""])


def _sexagesimal(value: float, places: int, signed: bool = False) -> str:
    units = round(abs(value) * 3600 * 10**places)
    whole, rest = divmod(units, 3600 * 10**places)
    minutes, seconds = divmod(rest, 60 * 10**places)
    sign = "-" if value < 0 else "+" if signed else ""
    width = places + 3 if places else 2
    return f"{sign}{whole:02d} {minutes:02d} {seconds / 10**places:0{width}.{places}f}"


if __name__ == "__main__":
    main()
