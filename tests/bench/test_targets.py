"""Targets: when a run reached one, what of it is known exactly, and what is only an interval."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calibench import bench, optimizers, problems
from calibench.bench.statistics.targets import levels_of, references
from calibench.bench.store import hits as hits_module
from calibench.bench.store.arrays import HITS_SCHEMA
from calibench.bench.store.hits import Points, crossings
from calibench.bench.store.runs import ResultStore
from calibench.problems.suites.black_box import COCO_GAPS

pytestmark = pytest.mark.usefixtures("one_process")


class Valley:
    """A problem of our own with many targets, which the gate watches one by one."""

    lower, upper, start = np.full(4, -5.0), np.full(4, 5.0), np.full(4, 3.0)
    targets = tuple(float(level) for level in np.logspace(2, -6, 120))

    def __call__(self, x):
        return float((x**2 * np.array([1.0, 3.0, 10.0, 30.0])).sum() + 0.3 * abs(np.sin(5 * x)).sum())


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    made = ResultStore(tmp_path_factory.mktemp("targets") / "study")
    made.open()
    for name in ("de", "pso", "nlopt_LN_SBPLX"):
        for seed in range(4):
            made.write(bench.execute(Valley(), optimizers.make(name), budget=3000, seed=seed, start="random"))
    for seed in range(3):
        problem = problems.make("full12", noise=1e-4)
        made.write(bench.execute(problem, optimizers.make("lm"), budget=2000, seed=seed, start="random"))
    return made


def test_a_declared_level_is_hit_where_the_gate_saw_it(store):
    runs, hits = store.runs(), store.hits()
    for row in runs.to_dict("records"):
        mine = hits[hits["run_id"] == row["run_id"]]
        assert mine["target"].tolist() == list(row["targets"])
        for name, told in (("evaluations", "hits"), ("charged", "hits_charged")):
            assert [None if pd.isna(v) else int(v) for v in mine[name]] == list(row[told])
        there = mine.dropna(subset=["charged"])
        assert (there["charged"] - there["charged_after"] == 1).all()


def test_the_true_hit_lies_in_the_interval_that_a_thinned_trace_leaves(store):
    runs, traces = store.runs(), store.traces()
    own, levels = runs[runs["optimizer"] != "lm"], np.array(Valley.targets)
    inside = exact = 0
    for row in own.to_dict("records"):
        trace = traces[traces["run_id"] == row["run_id"]]
        columns = [trace[name].to_numpy() for name in ("evaluations", "charged", "best_value")]
        found = crossings(Points(*columns, np.array([len(trace)])), levels, np.array([True]))
        for j, hit in enumerate(row["hits"]):
            if hit is None:
                assert found[0, 0, j] == -1
                continue
            after, until = found[2, 0, j], found[0, 0, j]
            assert after < hit <= until
            exact += until - after == 1
            inside += hit < until
    assert exact > 300  # what the trace alone tells exactly ...
    assert inside > 20  # ... and what it would tell too late, were its points taken for the truth


def test_other_levels_are_hemmed_in_by_the_declared_ones(store):
    runs = store.runs()
    between = [float(np.sqrt(a * b)) for a, b in zip(Valley.targets[:-1], Valley.targets[1:], strict=True)]
    hits = store.hits(levels_of(runs[runs["optimizer"] != "lm"], {"value": between}))
    for row in runs[runs["optimizer"] != "lm"].to_dict("records"):
        mine = hits[hits["run_id"] == row["run_id"]]
        known = [np.inf if hit is None else hit for hit in row["hits"]]
        for easier, harder, here, after in zip(known, known[1:], mine["charged"], mine["charged_after"], strict=False):
            if not pd.isna(here):
                assert easier - 1 <= after < here <= harder


def test_a_trace_of_another_kind_tells_nothing_between_its_points():
    points = Points(np.array([10, 100]), np.array([10, 100]), np.array([5.0, 1.0]), np.array([2]))
    ours = crossings(points, np.array([1.0]), np.array([True]))
    other = crossings(points, np.array([1.0]), np.array([False]))
    assert (ours[3, 0, 0], other[3, 0, 0]) == (99, 10)


def test_an_error_is_known_of_the_answer_alone(store):
    runs = store.runs()
    mine = runs[runs["optimizer"] == "lm"]
    hits = store.hits(levels_of(mine, {"parameter_error_mm_aligned": [1e3, 1e-9]}))
    easy, hard = hits[hits["target"] == 1e3], hits[hits["target"] == 1e-9]
    assert easy["evaluations"].tolist() == mine["best_evaluation"].tolist()
    assert (easy["evaluations_after"] == 0).all()  # whether it was reached before is not known
    assert hard["evaluations"].isna().all()
    assert (easy["charged"].to_numpy() <= mine["charged"].to_numpy()).all()


def test_the_noise_level_is_what_the_truth_leaves_on_average():
    seeds = [problems.make("full12", noise=1e-4, data_seed=seed) for seed in range(60)]
    left = np.array([problem(problem.truth) for problem in seeds])
    run = bench.execute(seeds[0], optimizers.make("lm"), budget=50, seed=0)
    levels = levels_of(pd.DataFrame([vars(run.record)]), {"noise": [1.0, 2.0]})
    assert levels["target"].tolist() == [2.0, 1.0]
    one = levels["level"].iloc[1]
    assert levels["level"].iloc[0] == pytest.approx(2 * one)
    assert abs(left.mean() - one) < 4 * left.std(ddof=1) / np.sqrt(len(left))
    quiet = bench.execute(problems.make("full12"), optimizers.make("lm"), budget=50, seed=0)
    assert levels_of(pd.DataFrame([vars(quiet.record)]), {"noise": [1.0]}).empty


def test_a_gap_is_above_the_best_of_the_study_where_no_minimum_is_declared(store):
    runs = store.runs()
    own = runs[runs["optimizer"] != "lm"]
    (known,) = references(own).to_dict("records")
    assert known["reference"] == own["best_value"].min()
    assert not known["declared"]
    declared = own.assign(minimum=own["best_value"].min() - 1.0)
    assert references(declared)["reference"].tolist() == [own["best_value"].min() - 1.0]
    wrong = own.assign(minimum=own["best_value"].min() + 1.0)  # a run fell below it: nobody believes it
    assert references(wrong)["reference"].tolist() == [own["best_value"].min()]
    levels = levels_of(own, {"gap": COCO_GAPS})
    assert len(levels) == 51
    assert (levels["level"] - levels["target"]).to_numpy() == pytest.approx(known["reference"])


def test_a_failed_run_reaches_nothing(tmp_path):
    class Breaks(Valley):
        calls = 0

        def __call__(self, x):
            self.calls += 1
            if self.calls > 500:
                raise RuntimeError("broken")
            return super().__call__(x)

    made = ResultStore(tmp_path / "study")
    made.open()
    made.write(bench.execute(Breaks(), optimizers.make("de"), budget=3000, seed=0))
    (row,) = made.runs().to_dict("records")
    assert row["status"] == "failed"
    assert any(hit is not None for hit in row["hits"])
    assert made.hits()["charged"].isna().all()


def test_hits_are_the_same_in_journals_and_tables_and_in_any_pieces(store, tmp_path, monkeypatch):
    levels = levels_of(store.runs())
    assert {"value", "gap", "noise", "parameter_error_mm"} <= set(levels["quantity"])
    before = store.hits(levels).drop(columns="seconds")
    store.collect()
    keys = ["run_id", "quantity", "target"]
    after = store.hits(levels).drop(columns="seconds")
    same = [frame.sort_values(keys).reset_index(drop=True) for frame in (before, after)]
    pd.testing.assert_frame_equal(*same)
    monkeypatch.setattr(hits_module, "_CHUNK", 3)
    pd.testing.assert_frame_equal(store.hits(levels).drop(columns="seconds"), after)
    path = store.write_hits(levels)
    written = pd.read_parquet(path)
    assert list(written.columns) == HITS_SCHEMA.names
    assert written["charged"].astype(float).equals(after["charged"].astype(float))
    path.unlink()


def test_seconds_are_known_of_what_the_last_evaluation_reached(tmp_path):
    made = ResultStore(tmp_path / "study")
    made.open()
    made.write(bench.execute(Valley(), optimizers.make("de"), budget=3000, seed=0, target=Valley.targets[10]))
    (row,) = made.runs().to_dict("records")
    hits = made.hits()
    at_the_end = hits[hits["evaluations"] == row["evaluations"]]
    assert not at_the_end.empty
    assert (at_the_end["seconds"] == row["wall_s"]).all()
    assert hits.drop(at_the_end.index)["seconds"].isna().all()


def test_swept_options_are_columns_of_their_own(tmp_path):
    made = ResultStore(tmp_path / "study")
    made.open()
    for n, population in ((3, 20), (9, 30)):
        problem = problems.make("sensor_zero", n=n)
        made.write(bench.execute(problem, optimizers.make("de", population=population), budget=100, seed=0))
        made.write(bench.execute(problem, optimizers.make("lm"), budget=100, seed=0))
    runs = made.runs(options=True)
    assert [name for name in runs if name.startswith(("opt.", "prob."))] == ["prob.n", "opt.population"]
    told = {(row["optimizer"], row["prob.n"]): row["opt.population"] for row in runs.to_dict("records")}
    assert told["de", 3] == 20
    assert told["de", 9] == 30
    assert np.isnan(told["lm", 3])
    assert list(made.runs(["optimizer"], options=True)) == ["optimizer", "prob.n", "opt.population"]
    assert "opt.population" not in made.runs()


def test_an_answer_outside_the_box_reaches_no_gap_above_the_best_inside(tmp_path):
    store = ResultStore(tmp_path / "mine")
    store.open()
    run = bench.execute(Valley(), optimizers.make("de"), budget=100)
    store.write(run)
    store.write(replace(run, record=replace(run.record, run_id="f" * 16, inside_box=False)))
    levels = levels_of(store.runs(), {"gap": [1e9], "value": [1e9]})
    hits = store.hits(levels).set_index(["quantity", "run_id"])["evaluations"]
    assert hits["value"].notna().all()
    assert hits["gap"].notna().to_dict() == {run.run_id: True, "f" * 16: False}
    declared = levels_of(store.runs().assign(minimum=0.0), {"gap": [1e9]})  # then it is known what is above it
    assert store.hits(declared)["evaluations"].notna().all()


@pytest.mark.parametrize("quantity", ["parameter_eror_mm", "gaps"])
def test_a_quantity_that_is_none_is_refused_with_what_is_near(store, quantity):
    with pytest.raises(ValueError, match=f"no quantity '{quantity}'.*(parameter_error_mm|gap)"):
        levels_of(store.runs(), {quantity: [1.0]})


class Told:
    """A problem with figures of merit of its own, one of them text."""

    lower, upper, start = np.full(2, -1.0), np.full(2, 1.0), np.full(2, 0.5)

    def __call__(self, x):
        return float(x @ x)

    def merit(self, x):
        return {"distance": float(np.hypot(*x)), "corner": "low"}


def test_a_figure_of_merit_that_no_run_has_or_that_is_text_is_refused(tmp_path):
    made = ResultStore(tmp_path / "study")
    made.open()
    made.write(bench.execute(Told(), optimizers.make("nlopt_LN_BOBYQA"), budget=40, seed=0))
    runs = made.runs()
    assert len(levels_of(runs, {"merit.distance": [0.1]})) == 1
    with pytest.raises(ValueError, match=r"'merit\.distance'"):
        levels_of(runs, {"merit.distnce": [0.1]})
    with pytest.raises(ValueError, match=r"merit\.corner is text"):
        levels_of(runs, {"merit.corner": [0.1]})
