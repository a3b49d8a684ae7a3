"""Stars that could be observed: spread over the sky above a lowest elevation, on the side of the pier that suits."""

from __future__ import annotations

from typing import Literal

import numpy as np

from calibench.discrepancy.machines.mount.geometry import Kind, angles, direction
from calibench.discrepancy.model.measured.data import DataError, MeasuredData
from calibench.problems.base import Array

PlanName = Literal["sky", "cross"]
_MOST = 100_000
_MINUTES = 1.0  # between two stars


def planned(
    plan: PlanName = "sky",
    n: int = 100,
    mount: Kind = "equatorial",
    latitude_deg: float = 40.0,
    lowest_deg: float = 25.0,
    flips: bool = True,
    sigma_arcsec: float = 60.0,
    seed: int = 0,
) -> MeasuredData:
    """Return `n` stars evenly spread over the sky (plan=sky) or along the meridian and one vertical (plan=cross).

    With `flips` an equatorial mount observes stars east of the meridian with the tube gone over the pole. Raises
    `DataError` for stars that no sky has.
    """
    if not 3 <= n <= _MOST or not 0 <= lowest_deg < 85 or abs(latitude_deg) > 90:
        raise DataError(f"plan.n={n}, lowest_deg={lowest_deg:g}, latitude_deg={latitude_deg:g}: 3 stars or more, "
                        "a lowest elevation of 0 to 85 and a latitude of -90 to 90 degrees are needed")  # fmt: skip
    rng = np.random.default_rng(seed)
    lowest = np.radians(lowest_deg)
    if plan == "sky":
        azimuth = 2 * np.pi * rng.random(n)
        elevation = np.arcsin(rng.uniform(np.sin(lowest), 1.0, n))
    else:
        turn = np.linspace(lowest, np.pi - lowest, n)
        elevation, azimuth = np.minimum(turn, np.pi - turn), np.where(turn < np.pi / 2, 0.0, np.pi)
        azimuth = azimuth + np.where(np.arange(n) % 2, np.pi / 2, 0.0)
    t_s = 60 * _MINUTES * np.arange(n)
    if mount == "altaz":
        columns = {"az": azimuth, "el": elevation, "star_az": azimuth, "star_el": elevation, "t_s": t_s}
    else:
        hour, declination = _equatorial(azimuth, elevation, np.radians(latitude_deg))
        over = flips & (hour < 0)
        ha, dec = np.where(over, hour + np.pi, hour), np.where(over, np.pi - declination, declination)
        columns = {"ha": ha, "dec": dec, "star_ha": hour, "star_dec": declination, "t_s": t_s}
    stated = {"machine": "mount", "mount": mount, "latitude_deg": latitude_deg, "sigma_arcsec": sigma_arcsec}
    return MeasuredData(columns, "mount", stated, f"{plan} of {n} stars")


def _equatorial(azimuth: Array, elevation: Array, latitude: float) -> tuple[Array, Array]:
    north, east, up = direction(azimuth, elevation).T
    meridian = up * np.cos(latitude) - north * np.sin(latitude)
    pole = up * np.sin(latitude) + north * np.cos(latitude)
    return angles(np.stack([meridian, -east, pole], axis=-1))
