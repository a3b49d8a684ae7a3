"""What repeats tell: carried noise, misstated noise, heavy tails, each from the differences of readings alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from benchmarks.blind.gpm2002.simulate import case
from calibench.bench.measured import read_measured, shipped_path
from calibench.discrepancy import Joint, MeasuredData, Model, Predicted, Roles, explain, machines
from calibench.discrepancy.fitting.fit import fit
from calibench.discrepancy.noise.repeats import law_of
from calibench.discrepancy.noise.whiten import Noise
from calibench.problems.base import Parameter
from tests.discrepancy.empty_runs import empty_run
from tests.few import few

pytestmark = pytest.mark.usefixtures("at_one_noise")


def _run(poses: int = 80) -> MeasuredData:
    visits = np.concatenate([np.arange(poses), np.arange(poses)])
    n = 2 * len(visits)
    return MeasuredData(
        {"pose_id": np.repeat(visits, 2), "visit_id": np.arange(n) // 2, "t_s": np.arange(n, dtype=float)}, "gpm2002"
    )


def test_pairs_below_the_stated_noise_beside_visits_as_stated_mean_carried_noise() -> None:
    data, rng = _run(), np.random.default_rng(1)
    white = rng.standard_normal(len(data)) * np.sqrt(1 - 0.45**2)
    law, _, notes = law_of(lfilter([1.0], [1.0, -0.45], white)[:, None], data)
    assert law.scale == 1.0
    assert 0.25 < law.autocorrelation < 0.65
    shown, _, rest = notes[0].text.partition(
        " times the stated noise, poses that were read again later as much as stated: "
    )
    share = f"{100 * (1 - float(shown.removeprefix('repeats show ')) ** 2):.0f}"
    assert abs(int(rest.partition(" %")[0]) - int(share)) <= 1
    assert rest.endswith("% of the noise is carried on to the next reading")


def test_repeats_below_the_stated_noise_without_later_visits_say_by_how_much_and_what_to_do() -> None:
    """Nobody can tell noise that was stated too large from noise that is carried on: the second is assumed."""
    data = MeasuredData({k: c for k, c in _run().columns.items() if k != "pose_id"}, "gpm2002")
    law, _, notes = law_of(0.5 * np.random.default_rng(2).standard_normal((len(data), 1)), data)
    assert law.scale == 1.0
    assert law.autocorrelation > 0.6
    assert float(notes[0].text.removeprefix("repeats show ").partition(" ")[0]) == pytest.approx(0.5, rel=0.15)
    assert "the noise is smaller than stated, or " in notes[0].text
    assert notes[0].text.endswith("where the first is true, state the smaller noise")


@pytest.mark.parametrize("factor", [0.6, 1.7])
def test_repeats_are_believed_where_pairs_and_visits_agree_against_the_statement(factor: float) -> None:
    data = _run()
    law, _, notes = law_of(factor * np.random.default_rng(2).standard_normal((len(data), 1)), data)
    assert law.autocorrelation == 0.0
    assert law.scale == pytest.approx(factor, rel=0.15)
    assert "their scatter is used" in notes[0].text


def test_noise_as_stated_is_left_alone() -> None:
    data = _run()
    law, _, notes = law_of(np.random.default_rng(3).standard_normal((len(data), 1)), data)
    assert (law.scale, law.autocorrelation, law.t_degrees) == (1.0, 0.0, np.inf)
    assert notes == ()


def test_heavy_tails_are_seen_between_repeats() -> None:
    data = _run(200)
    law, _, _ = law_of(np.random.default_rng(4).standard_t(3, (len(data), 1)) / np.sqrt(3), data)
    assert law.t_degrees < 10


def test_data_without_repeats_say_what_that_costs() -> None:
    data = MeasuredData({"t_s": np.arange(50.0)}, "gpm2002")
    law, _, notes = law_of(np.ones((50, 1)), data)
    assert law.scale == 1.0
    assert "no repeats" in notes[0].text


def test_carried_noise_is_told_from_visits_where_the_statement_is_of_no_use() -> None:
    data, rng = _run(), np.random.default_rng(5)
    white = 20 * rng.standard_normal(len(data)) * np.sqrt(1 - 0.45**2)
    law, _, notes = law_of(lfilter([1.0], [1.0, -0.45], white)[:, None], data)
    assert law.scale == pytest.approx(20, rel=0.25)
    assert 0.2 < law.autocorrelation < 0.7
    assert any("carried on" in note.text for note in notes)


@pytest.mark.slow
def test_repeats_are_not_asked_again_of_a_fit_that_ran_away() -> None:
    """A joint with a memory: names and their forms lead a fit away, and its residuals tell nothing of the noise."""
    blind = case(601067)
    report = explain("gpm2002", MeasuredData(blind.columns, "gpm2002", blind.metadata, "case"))
    assert not any("stated noise" in note.text for note in report.notes)
    assert report.gap.noise_floor < 2.0
    assert report.verdict == "unknown"


def test_a_wider_law_is_not_believed_in_the_place_of_heavy_tails(monkeypatch: pytest.MonkeyPatch) -> None:
    explain_module = import_module("calibench.discrepancy.procedure")
    at_fit = import_module("calibench.discrepancy.diagnostics.noise")
    formulation = machines.make("gpm2002").formulate(empty_run(np.random.default_rng(3), poses=40))
    found = SimpleNamespace(sets=((),), fit=fit(Model(formulation), Noise()))
    for scale, believed in ((0.97, True), (40.0, False)):
        law = Noise(scale, 0.0)
        monkeypatch.setattr(at_fit, "law_of", lambda *_, law=law: (law, None, ()))
        assert (explain_module._relearned(found, Noise(0.9, 0.0, t_degrees=4.0)) is not None) == believed


@dataclass(frozen=True)
class _Gantry:
    """Three slides before a tracker; the third is read from both sides."""

    name: str = "gantry"

    def formulate(self, data: MeasuredData) -> Predicted:
        roles = Roles(
            (Joint("x", "sx", "sliding"), Joint("y", "sy", "sliding"), Joint("z", "sz", "sliding", direction="side"))
        )
        zeros = tuple(Parameter(f"zero_{k}", "mm", 0.0, -5.0, 5.0) for k in "xyz")

        def read(q: Mapping[str, np.ndarray]) -> np.ndarray:
            return np.stack([q[f"s{k}"] + q[f"zero_{k}"] for k in "xyz"], axis=-1)

        return Predicted(data, read, zeros, dict.fromkeys("xyz", 0.02), inputs=("sx", "sy", "sz"), roles=roles)


def _read_from_both_sides(play: float, wild: int, seed: int, poses: int) -> MeasuredData:
    rng, pose = np.random.default_rng(seed), np.repeat(np.arange(poses), 2)
    stands, side = rng.uniform(0, 300, (poses, 3))[pose], rng.choice([-1.0, 1.0], len(pose))
    seen = stands + 0.7 + 0.02 * rng.standard_normal(stands.shape)
    seen[:, 2] -= 0.5 * play * side
    seen[rng.choice(len(pose), wild, replace=False), 2] += rng.choice([-1, 1], wild) * rng.uniform(0.3, 0.9, wild)
    columns = {f"s{k}": stands[:, i] for i, k in enumerate("xyz")} | {k: seen[:, i] for i, k in enumerate("xyz")}
    about = {"pose_id": pose, "visit_id": pose, "t_s": np.arange(len(pose), dtype=float), "side": side}
    return MeasuredData({**about, **columns}, "gantry")


@pytest.mark.parametrize("seed", few(1, [1, 4, 7]))
def test_a_play_between_repeats_from_both_sides_is_not_told_as_wild_readings_as_well(seed: int) -> None:
    report = explain(_Gantry(), _read_from_both_sides(0.12, 0, seed, poses=40))
    assert [finding.effect for finding in report.findings] == ["backlash z"]
    low, high = report.findings[0].amplitude.ci95
    assert low < 0.12 < high
    assert high - low < 0.03  # the repeats tell the noise once the play is known


@pytest.mark.parametrize("seed", few(1, [1, 2, 3]))
def test_wild_readings_beside_a_play_are_told(seed: int) -> None:
    report = explain(_Gantry(), _read_from_both_sides(0.12, 8, seed, poses=80))
    assert {finding.family for finding in report.findings} == {"backlash", "outlier"}


def test_a_few_repeats_are_called_too_few_and_not_none() -> None:
    few = _run(1)
    law, told, [note] = law_of(np.random.default_rng(4).standard_normal((len(few), 2)), few)
    assert law.profiled
    assert told == 4
    assert note.text.startswith(
        "repeats are too few to tell the noise, 4 differences between readings where 10 are needed"
    )
    none = MeasuredData({"t_s": np.arange(8.0)}, "gpm2002")
    assert law_of(np.ones((8, 2)), none)[2][0].text.startswith("no repeats tell the noise: ")


def test_repeats_of_other_rows_are_no_noise_under_which_nothing_is_missing():
    data = read_measured(shipped_path("demo_nothing", "gpm2002"), "gpm2002")
    moved = data.with_columns({"enc_1": np.roll(data["enc_1"], 3)})
    assert explain("gpm2002", moved).verdict == "unknown"
