"""The Orthoglide's catalogue: laws of every candidate, what calibration swallows, hidden physics it must match."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.blind import orthoglide as blind
from calibench.discrepancy import MeasuredData, Model, machines
from calibench.discrepancy.effects import catalogue, families
from calibench.discrepancy.model.effect import Effect, name_of
from calibench.discrepancy.model.model import signature


def _formulation(plan: str = "loaded", free: str = "auto"):
    case = blind.case(3, plan=plan)
    metadata = case.metadata | ({"free": free} if free != "auto" else {})
    data = MeasuredData(case.columns, "orthoglide", metadata, plan)
    rows = slice(None, None, 7) if plan == "loaded" else slice(None)
    formulation = machines.make("orthoglide").formulate(data)
    return formulation.on(formulation.data.rows(np.arange(len(data))[rows]))


FORMULATION = _formulation()
CANDIDATES = catalogue(FORMULATION).candidates


def _visible(effect: Effect, formulation) -> float:
    """Return the part of an effect's signature that the calibration leaves, at the nominal machine."""
    model = Model(formulation)
    q, true = model.quantities(model.start)
    left = signature(effect, np.zeros(len(effect.coefficients)), q, formulation.slopes(true), formulation)[:, 0, :]
    basis, _ = np.linalg.qr(model.jacobian(model.start)[:, 0, :])
    whole = np.linalg.norm(left)
    return float(np.linalg.norm(left - basis @ (basis.T @ left)) / whole) if whole > 1e-9 else 0.0


def test_the_catalogue_holds_the_families_of_the_orthoglide() -> None:
    more = {"leg_length", "guide_lean", "thermal_drives"}
    served = {family.name for family in families("orthoglide") if family.names_in(FORMULATION)}
    assert served == {*blind.TARGETS, *more}
    assert len({name_of(effect) for effect in CANDIDATES}) == len(CANDIDATES)


def test_declared_twins_leave_the_same_trace_and_name_each_other() -> None:
    by_name = {name_of(effect): effect for effect in CANDIDATES}
    declared = [(effect, twin) for effect in CANDIDATES for twin in effect.twins]
    assert declared
    model = Model(FORMULATION)
    q, true = model.quantities(model.start)
    slopes = FORMULATION.slopes(true)
    basis, _ = np.linalg.qr(model.jacobian(model.start)[:, 0, :])
    for effect, twin in declared:
        assert name_of(effect) in by_name[twin].twins
        one, two = (signature(e, np.zeros(1), q, slopes, FORMULATION)[:, 0, 0] for e in (effect, by_name[twin]))
        one, two = (t - basis @ (basis.T @ t) for t in (one, two))
        assert abs(one @ two) / np.linalg.norm(one) / np.linalg.norm(two) > 1 - 1e-9


def test_the_lengths_are_swallowed_by_the_joint_offsets_on_the_papers_plan() -> None:
    formulation = _formulation("paper", "rho")
    found = {name_of(effect): _visible(effect, formulation) for effect in catalogue(formulation).candidates}
    for leg in "xyz":
        assert found[f"leg_length leg {leg}"] < 0.05
    assert not any(name.startswith("gauge_placement") for name in found)  # a parallel leg looks the same from anywhere
    assert found["axis_orthogonality pair xy"] > 0.5  # half of it is left: orientation can be seen there
    assert found["axis_orthogonality cyclic"] < 0.3


def test_what_the_data_lack_is_told_family_by_family() -> None:
    case = blind.case(3, plan="paper")
    columns = {name: column for name, column in case.columns.items() if name not in ("temp_K", "zero_t_s")}
    data = MeasuredData(columns, "orthoglide", case.metadata, "bare")
    gaps = {
        (gap.family, gap.target): gap.reason
        for gap in catalogue(machines.make("orthoglide").formulate(data)).untestable
    }
    assert "temp_K" in gaps["thermal_legs", "all"]
    assert "zero_t_s" in gaps["drift", "all"]
    assert "payload_N is constant" in gaps["gravity", "all"]
    assert "10 mm would not show in these readings: it takes" in gaps["gauge_placement", "leg x"]
    calibrated = {(gap.family, gap.target): gap.reason for gap in catalogue(FORMULATION).untestable}
    assert "calibrated" in calibrated["leg_length", "leg x"]


_SEALED = {
    "scale": ("pitch", "axis y", np.array([0, 2e-3, 0])),
    "axis_orthogonality": ("lean", "axis x", np.array([[0, 2e-3, -1e-3], [0, 0, 0], [0, 0, 0]])),
    "axis_intersection": ("aside", "axis z", np.array([[0, 0, 0], [0, 0, 0], [0.4, -0.3, 0]])),
    "bar_skew": ("skew", "leg y", np.array([[0, 0, 0], [0.3, 0, 0.2], [0, 0, 0]])),
    "backlash": ("play", "axis x", np.array([0.1, 0, 0])),
    "thermal_legs": ("growth", "leg z", np.array([0, 0, 0.06])),
    "gravity": ("give", "all", 5e-3),
    "gauge_tilt": ("roll", "gauge z_x", np.array([[0, 0, 4e-3], [0, 0, 0], [0, 0, 0]])),
    "gauge_placement": ("place", "leg y", np.array([[0, 0, 0], [0.4, 0, 0.4], [0, 0, 0]])),
    "zero_reading": ("misread", "gauge x_y", np.array([[0, 0, 0], [0.1, 0, 0], [0, 0, 0]])),
}


@pytest.mark.slow
@pytest.mark.parametrize("family", _SEALED)
def test_the_catalogue_removes_what_a_simulator_of_its_own_physics_hides(family: str) -> None:
    field, target, value = _SEALED[family]
    fault = blind.replace(blind.Fault(), **{field: np.asarray(value, dtype=float) if field != "give" else value})
    case = blind.quiet(4, fault, "loaded")
    data = MeasuredData(case.columns, "orthoglide", case.metadata, family)
    formulation = machines.make("orthoglide").formulate(data)
    formulation = formulation.on(formulation.data.rows(np.arange(len(data))[::5]))
    (effect,) = (e for e in catalogue(formulation).candidates if name_of(e) == f"{family} {target}")
    without, with_it = (_best(Model(formulation).with_effects(*effects)) for effects in ((), (effect,)))
    assert without > 2e-3  # mm: there is something to remove
    assert with_it < 0.01 * without  # what stays is of second order: the two sets of physics differ there


def _best(model: Model) -> float:
    """Return the rms residual [mm] after a fit by Gauss-Newton."""
    x = model.start
    for _ in range(6):
        x = x - np.linalg.lstsq(model.jacobian(x)[:, 0, :], model.residuals(x)[:, 0], rcond=1e-13)[0]
    return float(np.sqrt(np.mean(model.residuals(x) ** 2)))
