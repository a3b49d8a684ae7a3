"""Noise that nobody states is learned again beside the effects that are found: a right name leaves nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.special import ndtri

from calibench.discrepancy import Blocks, Joint, MeasuredData, Predicted, Roles, explain
from calibench.discrepancy.fitting.rank import Held
from calibench.discrepancy.model.model import Model, relearned
from calibench.discrepancy.report import Report
from calibench.problems.base import Array, Parameter
from tests.few import few

PARAMETERS = tuple(Parameter(name, "mm", 0.0, -5.0, 5.0) for name in ("x0", "y0"))
ROLES = Roles(
    joints=(
        Joint("X axis", "X", "sliding", direction="X_dir", period=10.0),
        Joint("Y axis", "Y", "sliding", direction="Y_dir", period=10.0),
    ),
    time="t_s",
)
NOISE, ROWS = 0.003, 150


def _seen(q):
    return np.stack([q["x0"] + q["X"], q["y0"] + q["Y"]], axis=-1)


@dataclass(frozen=True)
class Table:
    """A table of two axes and a camera whose noise nobody states."""

    name: str = "own table"

    def formulate(self, data: MeasuredData) -> Predicted:
        return Predicted(data, _seen, PARAMETERS, {"cx": None, "cy": None}, inputs=("X", "Y"), roles=ROLES)


def _readings(seed: int, error: str, size: float, rows: int = ROWS, noise: float = NOISE) -> MeasuredData:
    """Return readings with an error of the X axis alone."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, 400, rows), rng.uniform(0, 300, rows)
    sides = rng.choice([-1.0, 1.0], (2, rows))
    cx, cy = 1.0 + x, -2.0 + y
    if error == "play":
        cx = cx - size / 2 * sides[0] * (1 + 0.1 * np.sin(x / 60))
    elif error == "screw":
        cx = cx + size * np.cos(2 * np.pi * x / 10 + 1)
    elif error == "bump":
        cx = cx + size * np.exp(-(((x - 150) / 18) ** 2))
    cx, cy = cx + noise * rng.normal(size=rows), cy + noise * rng.normal(size=rows)
    columns = {"cx": cx, "cy": cy, "X": x, "Y": y, "X_dir": sides[0], "Y_dir": sides[1], "t_s": 20.0 * np.arange(rows)}
    return MeasuredData(columns, "own table", name=f"{error} {seed}")


def _noise_of(report: Report) -> dict[str, float]:
    sigma = report.fitted.model.model.formulation.sigma
    return {name: float(np.median(value)) for name, value in sigma.items()}


@pytest.mark.parametrize("seed", few(1, range(6)))
@pytest.mark.parametrize(("error", "name"), [("play", "backlash"), ("screw", "screw_error")])
def test_a_right_name_is_the_whole_where_nobody_states_the_noise(error: str, name: str, seed: int) -> None:
    report = explain(Table(), _readings(seed, error, 0.04))
    assert report.verdict in ("named", "ambiguous")
    assert any(r.family == name and r.target == "X axis" for r in report.findings[0].set)
    assert report.left is not None
    assert 0.7 < report.left.times < 1.3
    told = _noise_of(report)
    assert told["cx"] == pytest.approx(NOISE, rel=0.35)
    assert told["cy"] == pytest.approx(NOISE, rel=0.35)


@pytest.mark.parametrize("seed", few(1, [4, 10]))
def test_names_that_explain_too_little_teach_no_noise(seed: int) -> None:
    readings = _readings(seed, "bump", 0.02, rows=60)
    report = explain(Table(), readings)
    assert report.verdict == "unknown"
    first = Table().formulate(readings).sigma
    assert _noise_of(report) == {name: float(np.median(first[name])) for name in ("cx", "cy")}


def test_noise_is_learned_in_each_block_and_around_held_parameters() -> None:
    first = Table().formulate(_readings(1, "none", 0.0))
    second = Table().formulate(_readings(2, "none", 0.0, rows=400, noise=10 * NOISE))
    stated = Predicted(second.data, _seen, PARAMETERS, {"cx": 7.0, "cy": None}, inputs=("X", "Y"), roles=ROLES)
    blocks = Held(Blocks(first, stated), frozenset({"x0"}))
    left = np.concatenate([2.0 * _unit(ROWS), 5.0 * _unit(400)])
    again = relearned(blocks, left, 0.0)
    assert again.parameters == blocks.parameters
    assert np.asarray(again.sigma["cx"])[:ROWS] == pytest.approx(2.0, rel=0.01)
    assert np.asarray(again.sigma["cy"])[:ROWS] == pytest.approx(2.0, rel=0.01)
    assert np.all(np.asarray(again.sigma["cx"])[ROWS:] == 7.0)
    assert np.asarray(again.sigma["cy"])[ROWS:] == pytest.approx(5.0, rel=0.01)
    assert np.array_equal(Model(again).residuals(Model(again).start), Model(blocks).residuals(Model(blocks).start))


def _unit(rows: int) -> Array:
    """Return two columns of a Gaussian's quantiles: their median modulus is that of deviation 1."""
    one = ndtri((np.arange(rows) + 0.5) / rows)
    return np.stack([one, one], axis=-1)


def _twice(seed: int, error: str, step: float = 0.0) -> MeasuredData:
    """Return 60 poses that are read twice, in steps of the camera where `step` is above 0."""
    once = _readings(seed, error, 0.02, rows=60, noise=0.0)
    rng = np.random.default_rng(100 + seed)
    columns = {name: np.repeat(value, 2) for name, value in once.columns.items()}
    columns |= {name: columns[name] + NOISE * rng.normal(size=120) for name in ("cx", "cy")}
    if step:
        columns |= {name: step * np.round(columns[name] / step) for name in ("cx", "cy")}
    columns |= {"t_s": 20.0 * np.arange(120), "pose_id": np.repeat(np.arange(60), 2)}
    return MeasuredData(columns | {"visit_id": columns["pose_id"]}, "own table")


@pytest.mark.parametrize("seed", few(2, range(4)))
def test_repeats_tell_noise_that_nobody_states(seed: int) -> None:
    report = explain(Table(), _twice(seed, "play"))
    assert [f.effect for f in report.findings] == ["backlash X axis"]
    law = report.fitted.model.fit.noise
    assert law.from_repeats
    assert not law.profiled
    assert not report.other_noise
    assert not any("stated noise" in note.text for note in report.notes)


def test_repeats_on_a_coarse_scale_tell_no_noise() -> None:
    law = explain(Table(), _twice(1, "none", step=0.05)).fitted.model.fit.noise
    assert law.profiled
    assert not law.from_repeats
