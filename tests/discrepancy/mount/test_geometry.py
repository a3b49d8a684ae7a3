"""The mount's geometry: exact rotations, whose first order is the field's formulas, and a simulator's vectors agree."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from calibench.discrepancy.machines.mount.geometry import (
    ARCSEC,
    AXES,
    TERMS,
    TURNS,
    Kind,
    angles,
    direction,
    pointing,
    slopes_of,
    tangents,
    zenith,
)
from tests.independent.mount import Mechanism, _readings

SMALL = 0.01  # arcsec: second order is below rounding of what is compared
LATITUDE = np.radians(38.0)
_s, _c, _t = np.sin, np.cos, np.tan


def _sec(x: Any) -> Any:
    return 1 / np.cos(x)


def _field(kind: Kind, name: str, h: Any, d: Any) -> Any:
    """Return the correction of roll and of pitch for one unit, as P. T. Wallace's TPOINT defines the term."""
    f, zero = LATITUDE, 0 * h
    sine_of_height = _s(f) * _s(d) + _c(f) * _c(d) * _c(h) if kind == "equatorial" else _s(d)
    if kind == "equatorial":
        droop = _c(f) * _s(h) * _sec(d), _c(f) * _c(h) * _s(d) - _s(f) * _c(d)
        return {
            "IH": (1 + zero, zero), "ID": (zero, 1 + zero), "CH": (_sec(d), zero), "NP": (_t(d), zero),
            "MA": (-_c(h) * _t(d), _s(h)), "ME": (_s(h) * _t(d), _c(h)), "TF": droop,
            "TX": (droop[0] / sine_of_height, droop[1] / sine_of_height),
            "DAF": (_s(f) * _t(d) + _c(f) * _c(h), zero), "FO": (zero, _c(h)), "HCES": (_s(h), zero),
            "HCEC": (_c(h), zero), "DCES": (zero, _s(d)), "DCEC": (zero, _c(d)), "HDSH": (zero, _s(h)),
            "HDSH2": (zero, _s(2 * h)), "HDCH2": (zero, _c(2 * h)), "HHSH2": (_s(2 * h), zero),
            "HHCH2": (_c(2 * h), zero), "HXSH": (_s(h) * _sec(d), zero), "HXCH": (_c(h) * _sec(d), zero),
            "HPSH": (_s(h) * _t(d), zero), "HPCH": (_c(h) * _t(d), zero), "PHH": (h, zero), "PDD": (zero, d),
        }[name]  # fmt: skip
    return {
        "IA": (-1 + zero, zero), "IE": (zero, 1 + zero), "CA": (-_sec(d), zero), "NPAE": (-_t(d), zero),
        "AN": (-_s(h) * _t(d), -_c(h)), "AW": (-_c(h) * _t(d), _s(h)), "TF": (zero, -_c(d)),
        "TX": (zero, -_c(d) / _s(d)), "ACES": (-_s(h), zero), "ACEC": (_c(h), zero), "ECES": (zero, _s(d)),
        "ECEC": (zero, _c(d)), "HESA": (zero, _s(h)), "HECA": (zero, -_c(h)),
    }[name]  # fmt: skip


def _pointed(kind: Kind, quantity: dict[str, Any], h: Any, d: Any) -> Any:
    terms = {name: quantity.get(name, 0.0) + 0 * h for name in (*TURNS[kind], "TF", "TX")}
    return pointing(kind, LATITUDE, h, d, terms)


def _places(kind: Kind, beyond: bool = False) -> tuple[Any, Any]:
    rng = np.random.default_rng(3)
    h, d = rng.uniform(-1.2, 1.2, 40), rng.uniform(0.3, 1.2, 40)
    return h, (np.pi - d if beyond else d)


def _named() -> list[Any]:
    terms = [(k, name) for k in ("equatorial", "altaz") for name in (*TURNS[k], "TF", "TX")]
    more = ("DAF", "FO", "HCES", "HCEC", "DCES", "DCEC", "HDSH", "HDSH2", "HDCH2", "HHSH2", "HHCH2", "HXSH", "HXCH",
            "HPSH", "HPCH", "PHH", "PDD")  # fmt: skip
    also = ("ACES", "ACEC", "ECES", "ECEC", "HESA", "HECA")
    return [*terms, *(("equatorial", n) for n in more), *(("altaz", n) for n in also)]


@pytest.mark.parametrize(("kind", "name"), _named())
def test_a_small_term_is_the_fields_formula(kind: Kind, name: str) -> None:
    h, d = _places(kind)
    found = _change(kind, name, h, d)
    towards = _pointed(kind, {k: SMALL * v for k, v in found.items()}, h, d)
    along, up = tangents(h, d)
    moved = towards - direction(h, d)
    roll, pitch = _field(kind, name, h, d)
    np.testing.assert_allclose(np.sum(along * moved, axis=1) / ARCSEC / SMALL, roll * np.cos(d), atol=2e-5)
    np.testing.assert_allclose(np.sum(up * moved, axis=1) / ARCSEC / SMALL, pitch, atol=2e-5)


def _change(kind: Kind, name: str, h: Any, d: Any) -> dict[str, Any]:
    if name in TURNS[kind]:
        return {name: 1.0}
    term = next(term for term in TERMS if (term.kind, term.name) == (kind, name))
    height, side = direction(h, d) @ zenith(kind, LATITUDE), np.where(np.cos(d) < 0, -1.0, 1.0)
    return {term.quantity: term.shape({"roll": h, "pitch": d, "height": height, "side": side})}


@pytest.mark.parametrize("name", ["CH", "NP", "ID"])
def test_terms_of_the_axes_turn_their_sign_beyond_the_pole(name: str) -> None:
    h, d = _places("equatorial")
    on_the_sky = []
    for roll, pitch in ((h, d), (h + np.pi, np.pi - d)):
        moved = _pointed("equatorial", {name: SMALL}, roll, pitch) - direction(h, d)
        on_the_sky.append(moved)
    np.testing.assert_allclose(on_the_sky[1], -on_the_sky[0], atol=1e-12)


@pytest.mark.parametrize("altaz", [False, True])
def test_large_errors_point_where_a_mechanism_of_vectors_does(altaz: bool) -> None:
    kind: Kind = "altaz" if altaz else "equatorial"
    h, d = _places(kind)
    index = (8000.0, -5000.0)
    mechanism = Mechanism(altaz, float(LATITUDE), (index[0] * ARCSEC, index[1] * ARCSEC, 0.0, 0.0, 0.0, 0.0))
    names = [name for name in TURNS[kind] if TURNS[kind][name][0] in ("roll", "pitch")]
    told = {n: v * TURNS[kind][n][1] for n, v in zip(names, index)}
    one, two = _readings(mechanism, mechanism.points(h, d), False)
    np.testing.assert_allclose(_pointed(kind, told, h, d), direction(one, two), atol=1e-12)


def test_a_cone_error_of_two_degrees_is_exact_at_the_pole() -> None:
    across = 7200.0
    towards = _pointed("equatorial", {"CH": across}, np.zeros(1), np.array([np.pi / 2]))
    distance = np.degrees(np.arccos(towards[0, 2])) * 3600
    assert distance == pytest.approx(across, abs=1e-6)  # first order, sec d, would be infinite


def test_angles_are_the_inverse_of_direction() -> None:
    h, d = _places("equatorial")
    np.testing.assert_allclose(np.stack(angles(direction(h, d))), np.stack([h, d]), atol=1e-12)


def test_no_name_stands_for_two_terms_of_one_mount() -> None:
    for kind in ("equatorial", "altaz"):
        names = [term.name for term in TERMS if term.kind == kind]
        assert len(set(names)) == len(names)


@pytest.mark.parametrize("kind", ["equatorial", "altaz"])
def test_slopes_are_those_of_a_complex_step(kind: Kind) -> None:
    rng = np.random.default_rng(4)
    roll, pitch = rng.uniform(-3, 3, 40), rng.uniform(0.2, 1.3, 40)
    terms: dict[str, Any] = {name: rng.uniform(-3000, 3000, 40) for name in (*TURNS[kind], "TF", "TX")}
    found = slopes_of(kind, LATITUDE, roll, pitch, terms)
    for name, slope in found.items():
        one = dict(zip(AXES[kind], (roll, pitch), strict=True)) | terms
        one[name] = one[name] + 1e-30j
        stepped = pointing(kind, LATITUDE, *(one.pop(axis) for axis in AXES[kind]), one).imag / 1e-30
        assert slope == pytest.approx(stepped, rel=1e-12, abs=1e-12 * np.abs(stepped).max())
    assert {*found} == {*AXES[kind], *terms}
