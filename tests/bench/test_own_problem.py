"""A user's own problem says what is known of it: names, unit, minimum, merit, noise; what is wrong is refused."""

import json
import sys
from dataclasses import dataclass

import numpy as np
import pyarrow.parquet as pq
import pytest

from calibench import bench, optimizers, problems, testing
from calibench.bench.cli import main
from calibench.bench.execution.request import FRESH, check_extras, seeded
from calibench.bench.report.study import figures
from calibench.bench.statistics import summary
from calibench.bench.statistics.optimum import optimum_of
from calibench.bench.statistics.tables import calibrated
from calibench.bench.store.runs import ResultStore
from calibench.bench.sweep.costs import costs_of
from calibench.problems import Parameter
from calibench.problems.base import coordinates_of, parameters_of

pytestmark = pytest.mark.usefixtures("one_process")


class Well:
    lower, upper, start = -np.ones(2), np.ones(2), np.array([0.8, -0.6])

    def __call__(self, x):
        return float((x - 0.25) @ (x - 0.25)) - 3.2


class Noisy(Well):
    stochastic, targets = True, (-2.0, -3.1)

    def __call__(self, x):
        return super().__call__(x) + 0.3 * self.rng.standard_normal()


class Quiet(Noisy):
    def noise_free(self, x):
        return Well.__call__(self, x)


def saying(base=Well, **said):
    return type("Said", (base,), said)()


def run_of(problem, method="de", budget=60, seed=0, **given):
    return bench.execute(problem, optimizers.make(method), budget=budget, seed=seed, **given)


def test_none_is_that_a_problem_has_it_not():
    """A subclass switches off by None what it inherits: any of it, and all of it together."""
    derivatives = ("residuals", "jacobian", "gradient", "value_and_gradient", "batch", "batch_below")
    judged = ("merit", "physical", "seeded", "noise_free", "compile", "compile_values", "stochastic", "default_start")
    said = ("targets", "budgets", "minimum", "unit", "group", "parameters", "coordinates", "truth", "data_id", "kernel")
    names = (*derivatives, *judged, *said, "name", "options", "side_effect_free")
    for off in (*((name,) for name in names), names):
        problem = saying(**dict.fromkeys(off))
        run = run_of(problem)
        assert (run.status, run.row["error"]) == ("ok", ""), off
    sums = saying(__call__=lambda _, x: float(x @ x), jacobian=lambda _, x: np.eye(2), residuals=None)
    for problem in (saying(**dict.fromkeys(names)), sums):
        testing.check_problem(problem)
    assert [p.name for p in parameters_of(saying(physical=None, parameters=("a", "b")))] == ["a", "b"]


def stored(tmp_path, *runs):
    store = ResultStore(tmp_path / "study")
    store.open()
    for run in runs:
        store.write(run)
    return store


# names


def test_a_plain_string_is_the_name_of_a_parameter(tmp_path):
    problem = saying(parameters=("gain", "offset"), truth=np.array([0.25, 0.25]), upper=np.array([1.0, 0.3]))
    run = run_of(problem)
    assert run.row["parameter_names"] == ["gain", "offset"]
    assert parameters_of(problem)[1] == Parameter("offset", "", -0.6, -1.0, 0.3, 0.25)


def test_a_parameter_that_ends_at_its_bound_is_named():
    problem = saying(parameters=("gain", "offset"), upper=np.array([1.0, 0.0]))
    run = run_of(problem, "nlopt_LN_BOBYQA", 100)
    assert run.row["at_bound"] == ["offset"]


def test_a_class_with_named_parameters_and_no_options_has_its_table_of_values(tmp_path, monkeypatch):
    (tmp_path / "named_well.py").write_text(
        "import numpy as np\nclass Well:\n    lower, upper, start = -np.ones(2), np.ones(2), np.ones(2) / 2\n"
        "    parameters, truth = ('gain', 'offset'), np.zeros(2)\n    def __call__(self, x): return float(x @ x)\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    from named_well import Well as Named  # written above

    run = run_of(Named(), problem_name="named_well:Well")
    table = calibrated(stored(tmp_path, run).runs()).set_index("parameter")
    assert table.loc["gain", "true"] == 0.0
    assert table.loc["offset", "median"] == run.best_x[1]


def test_coordinates_are_told_from_what_they_are_turned_into():
    problem = saying(parameters=("length", "angle", "area"), physical=lambda _, x: np.array([*x, x[0] * x[1]]))
    assert [p.name for p in coordinates_of(problem)] == ["x0", "x1"]
    row = run_of(problem).row
    assert row["parameter_names"] == ["length", "angle", "area"]
    assert row["parameter_values"][2] == pytest.approx(row["best_x"][0] * row["best_x"][1])


# refusals


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ({"constraints": [lambda x: x[0]]}, "constraints are not handled"),
        ({"constraints": lambda self, x: x}, "constraints are not handled"),
        ({"constraints": "x < 1"}, "constraints are not handled"),
        ({"integrality": np.array([0, 1])}, "whole numbers are not handled"),
        ({"lower": 0.0, "upper": 1.0, "start": 0.5}, r"lower, upper and start have shape \(\); one axis is needed"),
        ({"n_objectives": 2}, "several objectives are not handled"),
        ({"objectives": ("cost", "mass")}, "several objectives are not handled"),
        ({"targets": 1e-8}, "a list of finite numbers is needed"),
        ({"targets": (1.0, np.nan)}, "a list of finite numbers is needed"),
        ({"targets": ("low",)}, "a list of finite numbers is needed"),
        ({"minimum": "low"}, "minimum='low': a finite number is needed"),
        ({"minimum": -np.inf}, "a finite number is needed"),
        ({"minimum": -3.2, "targets": (-3.0, -4.0)}, "the target -4 lies below minimum=-3.2"),
        ({"minimum": -1.0, "residuals": lambda self, x: x}, "never below 0"),
        ({"unit": 3}, "unit=3: text is needed"),
        ({"group": 3}, "group=3: text is needed"),
        ({"parameters": ("gain",)}, "parameters: 1 are named, and x has 2"),
        ({"parameters": "ab"}, "a tuple of names is needed"),
        ({"parameters": ("a", 3)}, r"parameters\[1\]=3"),
        ({"parameters": ("a", "a")}, "'a' is named twice"),
        ({"truth": np.zeros(3)}, r"truth has shape \(3,\)"),
        ({"budgets": 500}, "a mapping from ci and paper"),
        ({"merit": {"overshoot": 1.0}}, "merit is no method"),
        ({"stochastic": "yes"}, "True or False is needed"),
        ({"noise_free": lambda self, x: 0.0}, "noise_free.x. is for stochastic = True"),
        ({"stochastic": True, "noise_free": 3.0}, "noise_free is no method"),
        ({"stochastic": True, "seeded": lambda self, rng: self}, "must return another problem"),
    ],
)
def test_what_is_said_wrongly_or_out_of_scope_is_refused_in_one_line(said, words):
    with pytest.raises(ValueError, match=words) as refused:
        run_of(saying(**said))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "said",
    [
        {"constraints": ()}, {"constraints": None}, {"integrality": np.zeros(2)}, {"integrality": False},
        {"n_objectives": 1}, {"objectives": ("cost",)}, {"minimum": None}, {"targets": np.array([1.0])},
    ],
)  # fmt: skip
def test_what_asks_for_nothing_is_not_refused(said):
    check_extras(saying(**said), "well")


@pytest.mark.parametrize("value", [np.ones(2), [1.0, 2.0], (1.0, 2.0)])
def test_several_objectives_in_a_value_are_a_failure_that_says_so(value):
    run = run_of(saying(__call__=lambda self, x: value))
    assert run.status == "failed"
    assert "one number is needed" in run.row["error"]
    assert "several objectives" in run.row["error"]


# merit


def test_any_figure_of_merit_is_kept_and_offered(tmp_path):
    problem = saying(
        merit=lambda self, x: {
            "overshoot": np.float64(abs(x[0])),
            "stable": np.bool_(True),
            "note": "slow",
            "kmrmse": 0.5,
            "best_value": 99.0,
            "lost": np.nan,
        }
    )
    run = run_of(problem)
    assert run.best_value < 99.0
    store = stored(tmp_path, run, run_of(Well()))
    store.collect()
    runs = store.runs().set_index("run_id").loc[[run.run_id]]
    row = runs.iloc[0]
    assert row["merit.overshoot"] == abs(run.best_x[0])
    assert (row["merit.stable"], row["merit.note"], row["merit.best_value"]) == (True, "slow", 99.0)
    assert (row["kmrmse"], row["best_value"]) == (0.5, run.best_value)
    assert json.loads(pq.read_table(store.folder / "runs.parquet")["merit"].drop_null()[0].as_py())["lost"] is None
    assert not [name for name, dtype in runs.dtypes.items() if str(dtype) == "object"]


def test_an_infinite_merit_counts_in_the_median(tmp_path):
    """A run whose merit is infinite has no small one: the median over the few others would praise what fails."""
    errors = iter([1.0, np.inf, 2.0, np.inf, np.inf])
    runs = []
    for seed in range(5):
        error = next(errors)
        runs.append(run_of(saying(merit=lambda self, x, e=error: {"error": e, "none": np.nan}), seed=seed))
    told = stored(tmp_path, *runs).runs()
    assert sorted(told["merit.error"]) == [1.0, 2.0, np.inf, np.inf, np.inf]
    assert told["merit.none"].isna().all()
    assert summary.summary(told)["merit.error_median"].tolist() == [np.inf]


def test_a_summary_has_the_median_of_a_merit_and_the_share_of_a_flag(tmp_path):
    problem = saying(merit=lambda self, x: {"overshoot": abs(x[0]), "low": x[0] < 0.25})
    runs = stored(tmp_path, *(run_of(problem, seed=s) for s in range(4))).runs()
    row = summary.summary(runs).iloc[0]
    assert row["merit.overshoot_median"] == np.median([abs(x[0]) for x in runs["best_x"]])
    assert row["merit.low_share"] == np.mean([x[0] < 0.25 for x in runs["best_x"]])


@pytest.mark.parametrize(
    ("merit", "told"),
    [(3.0, "returned float"), ({"a": object()}, "gave a="), ({"kmrmse": "much"}, "gave kmrmse='much'")],
)
def test_a_merit_that_no_row_can_hold_is_a_failure_with_its_name(merit, told):
    run = run_of(saying(merit=lambda self, x: merit))
    assert (run.status, run.evaluations) == ("failed", 0), "found before the budget is spent"
    assert run.row["error"].startswith("before the first evaluation: ")
    assert told in run.row["error"]
    later = run_of(saying(merit=lambda self, x: {"a": 1.0} if (x == self.start).all() else merit))
    assert (later.status, later.evaluations > 0) == ("failed", True)
    assert later.row["error"].startswith("in judging the answer: ")
    assert told in later.row["error"]


def test_a_merit_that_fails_at_the_start_alone_harms_no_run():
    def merit(self, x):
        if (x == self.start).all():
            raise ZeroDivisionError
        return {"a": 1.0}

    assert run_of(saying(merit=merit)).status == "ok"


# floors and rows of before


def test_only_what_is_rounding_is_called_a_rounding_floor(tmp_path):
    clean, noisy = problems.make("full11"), problems.make("full11", noise=1e-4)
    runs = stored(tmp_path, run_of(clean, budget=20), run_of(noisy, budget=20)).runs()
    options = runs["problem_options"].str.contains('"noise":0.0001')
    known, measured = optimum_of(runs[~options]), optimum_of(runs[options])
    assert (known.floor_text, measured.floor_text) == ("rounding floor: J(truth)", "J(truth)")
    goal = clean.targets[-1]
    assert known.is_floor(goal)
    assert not known.is_floor(1.0)  # a level of one's own, far above rounding
    assert not measured.is_floor(goal)
    assert (known.axis, known.level(goal)) == ("best J2 [mm⁴]", "J2 ≤ 1e-18 mm⁴")


def test_no_floor_is_told_of_a_problem_without_a_truth(tmp_path):
    known = optimum_of(stored(tmp_path, run_of(saying(minimum=0.0, __call__=lambda self, x: float(x @ x)))).runs())
    assert known.floor is None
    assert not known.is_floor(1e-30)
    assert known.quantity == "f"


def test_a_users_option_named_error_borrows_no_unit(tmp_path):
    problem = saying(options={"error": "J1"})
    assert optimum_of(stored(tmp_path, run_of(problem)).runs()).axis == "best J1"


# noise


def test_the_noise_of_a_run_comes_from_its_repetition():
    first, again, other = run_of(Noisy(), seed=3), run_of(Noisy(), seed=3), run_of(Noisy(), seed=4)
    assert first.row["best_value"] == again.row["best_value"]
    assert first.row["judged_value"] == again.row["judged_value"]
    assert first.row["best_value"] != other.row["best_value"]


def test_the_noise_is_the_same_stream_for_every_optimiser_and_leaves_the_problem_alone():
    problem = Noisy()
    values = [run_of(problem, method, budget=1).best_value for method in ("nlopt_LN_BOBYQA", "nlopt_LN_SBPLX")]
    assert values[0] == values[1]
    assert not hasattr(problem, "rng")


def test_a_frozen_problem_and_one_with_a_generator_of_its_own_are_seeded_too():
    @dataclass(frozen=True)
    class Frozen(Noisy):
        depth: float = 1.0

    class Elsewhere(Noisy):
        source = None

        def seeded(self, rng):
            twin = Elsewhere()
            twin.source = rng
            return twin

        def __call__(self, x):
            return Well.__call__(self, x) + self.source.standard_normal()

    for problem in (Frozen(), Elsewhere()):
        assert seeded(problem, ["a"], 0)(np.zeros(2)) == seeded(problem, ["a"], 0)(np.zeros(2))
        assert run_of(problem).status == "ok"


def test_the_answer_is_judged_by_fresh_evaluations_outside_the_budget():
    calls = []

    class Counting(Noisy):
        def __call__(self, x):
            calls.append(np.array(x))
            return super().__call__(x)

    run = run_of(Counting(), budget=50)
    assert (run.evaluations, run.row["judged_evaluations"], len(calls)) == (50, FRESH, 50 + FRESH)
    assert (np.array(calls[50:]) == run.best_x).all()
    assert run.row["judged_value"] == pytest.approx(Well()(run.best_x), abs=5 * 0.3 / FRESH**0.5)
    assert run.best_value < run.row["judged_value"]  # the lowest of fifty noisy values is lucky


def test_the_answer_is_judged_without_noise_where_the_problem_can():
    run = run_of(Quiet())
    assert run.row["judged_value"] == Well()(run.best_x)
    assert run.row["judged_evaluations"] == 0


def test_a_lucky_value_reaches_no_target():
    run = run_of(saying(Quiet, targets=(-2.0, -3.25)), budget=200)
    assert run.best_value < -3.25  # lower than anything without noise
    assert run.row["hits"] == [run.row["best_evaluation"], None]


def test_what_a_target_cost_holds_the_derivatives_asked_for_until_then():
    noisy = saying(
        Quiet,
        __call__=lambda self, x: float(self.residuals(x) @ self.residuals(x)),
        residuals=lambda self, x: x - 0.25 + 1e-3 * self.rng.standard_normal(2),
        jacobian=lambda self, x: np.eye(2),
        noise_free=lambda self, x: float((x - 0.25) @ (x - 0.25)),
        targets=(1e-2,),
    )
    row = run_of(noisy, "lm", budget=40).row
    assert row["jacobian_evaluations"] > 0
    assert row["hits"][0] < row["hits_charged"][0] <= row["charged"]


def test_a_target_that_would_end_a_noisy_run_is_refused():
    with pytest.raises(ValueError, match="a lucky value would end the run"):
        run_of(Noisy(), target=-3.0)


def test_summaries_of_noisy_problems_are_of_the_judged_answers(tmp_path):
    runs = stored(tmp_path, *(run_of(Quiet(), seed=s) for s in range(5))).runs()
    row = summary.summary(runs).iloc[0]
    assert row["best_median"] == runs["judged_value"].median()
    assert row["seen_median"] == runs["best_value"].median()
    assert row["reached"] == (runs["judged_value"] <= -3.1).sum()


def test_what_a_noisy_call_takes_is_measured_and_chance_has_a_part_in_one_run(tmp_path):
    assert costs_of(Noisy())["value_s"] > 0
    assert summary.has_chance(stored(tmp_path, run_of(Noisy(), "nlopt_LN_BOBYQA")).runs())
    assert not summary.has_chance(stored(tmp_path / "still", run_of(Well(), "nlopt_LN_BOBYQA")).runs())


def test_a_noise_that_cannot_be_judged_is_a_failure_that_keeps_its_answer():
    run = run_of(saying(Quiet, noise_free=lambda self, x: 1 / 0))
    assert (run.status, run.row["error_type"]) == ("failed", "ZeroDivisionError")
    assert run.best_x is not None


# from the command line


@pytest.fixture
def call(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    (tmp_path / "story.py").write_text(STORY)
    sys.modules.pop("story", None)

    def run(*words):
        with pytest.raises(SystemExit) as ended:
            main(list(words))
        told = capsys.readouterr()
        return ended.value.code, told.out, told.err

    yield run
    sys.modules.pop("story", None)


STORY = """
import numpy as np
class Volts:
    lower, upper, start = -np.ones(2), np.ones(2), np.array([0.8, -0.6])
    minimum, unit, targets, parameters = -3.2, "V", (-3.1, -3.19999), ("gain", "offset")
    def __call__(self, x): return float((x - 0.25) @ (x - 0.25)) - 3.2
    def merit(self, x): return {"overshoot": float(x[0])}
class Plain:
    lower, upper, start = Volts.lower, Volts.upper, Volts.start
    def __call__(self, x): return Volts.__call__(self, x)
class Wrong(Volts):
    minimum, targets = -3.0, ()
class Noisy(Volts):
    stochastic, minimum = True, None
    def __call__(self, x): return Volts.__call__(self, x) + 0.3 * self.rng.standard_normal()
class Cut(Volts):
    constraints = [lambda x: x[0]]
"""


def test_a_deterministic_method_repeats_itself_on_no_noisy_problem(call, tmp_path):
    code, *_ = call("run", "problem=story:Noisy", "optimizer=nlopt_LN_BOBYQA", "budget=30", "seeds=4")
    runs = ResultStore(tmp_path / "results" / "adhoc").runs()
    assert (code, len(runs), runs["best_value"].nunique()) == (0, 4, 4)
    code, *_ = call("run", "problem=story:Volts", "optimizer=nlopt_LN_BOBYQA", "budget=30", "seeds=4", "study=still")
    assert len(ResultStore(tmp_path / "results" / "still").runs()) == 1


def test_a_value_below_the_declared_minimum_is_said_in_one_line(call):
    words = ("problem=story:Wrong,story:Volts,story:Noisy", "optimizer=nlopt_LN_BOBYQA", "budget=60", "seeds=2")
    _, out, _ = call("run", "-m", *words)
    assert [line for line in out.splitlines() if "declares" in line] == [
        "story:Wrong: a run found -3.2, below the minimum=-3 that it declares"
    ]


def test_constraints_are_refused_before_anything_is_written(call, tmp_path):
    code, out, err = call("run", "problem=story:Cut", "optimizer=de", "budget=30", "seeds=1")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "constraints are not handled" in err
    assert not (tmp_path / "results").exists()


@pytest.mark.slow
def test_the_words_and_axes_say_what_is_known_of_each_problem(call, tmp_path):
    problems = ",".join(f"story:{name}" for name in ("Volts", "Plain", "Wrong", "Noisy"))
    _, out, _ = call("run", "-m", f"problem={problems}", "optimizer=de,nlopt_LN_BOBYQA", "budget=80", "seeds=2")
    assert "f*+" in out
    assert "f*-2.0e-01 V" not in out  # Wrong is below the minimum it declares: its values are told as they are
    code, *_ = call("report", "results/adhoc")
    assert code == 0
    store = ResultStore(tmp_path / "results" / "adhoc")
    runs, traces = store.runs(), store.traces()
    axes = {
        name: figures.convergence(runs[runs["problem"] == f"story:{name}"], traces)[0].axes[0]
        for name in ("Volts", "Plain", "Wrong", "Noisy")
    }
    assert {name: a.get_ylabel() for name, a in axes.items()} == {
        "Volts": "best f - f* [V]", "Plain": "best f", "Wrong": "best f [V]", "Noisy": "lowest noisy f [V]"
    }  # fmt: skip
    assert {name: a.get_yscale() for name, a in axes.items()} == {
        "Volts": "log", "Plain": "linear", "Wrong": "linear", "Noisy": "linear"
    }  # fmt: skip
    assert (
        figures.target_chart(runs[runs["problem"] == "story:Volts"])[0]
        .axes[0]
        .get_xlabel()
        .endswith("to f - f* ≤ 1e-05 V")
    )
    page = (store.folder / "report.html").read_text(encoding="utf-8")
    assert "f - f*, above the least value [V] · goal f - f* ≤ 1e-05 V" in page
    assert "f · no goal is known" in page
    assert "below the minimum of -3 V that the problem declares" in page
    assert "f, noisy: the answer as judged [V] · goal judged f ≤ -3.19999 V" in page
    assert "overshoot, median" in page
    assert "rounding floor" not in page.partition("</details>")[2]


def test_one_run_is_shown_with_what_its_problem_says(call):
    call("run", "problem=story:Volts", "optimizer=nlopt_LN_BOBYQA", "budget=30", "seeds=1")
    _, out, _ = call("show", "")
    assert "best       -3.2 V" in out
    assert "minimum    -3.2 V, as the problem declares" in out
    assert "overshoot 0.25" in out
    call("run", "problem=story:Noisy", "optimizer=de", "budget=30", "seeds=1", "results=other")
    assert f"(mean of {FRESH} fresh evaluations)" in call("show", "", "results=other")[1]
