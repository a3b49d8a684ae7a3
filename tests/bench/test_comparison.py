"""Two methods and many: tests, effects, verdicts, each beside SciPy or an independent library."""

import itertools
import json
import re
import shutil

import numpy as np
import pandas as pd
import pytest
from scipy import optimize, stats

from benchmarks.statistics import false_positives
from calibench import bench, optimizers, problems
from calibench.bench.cli import main
from calibench.bench.report.study.figures import critical_difference
from calibench.bench.statistics.ranking import (
    FEWEST,
    Blocks,
    blocks_of,
    friedman,
    holm,
    order_of_scores as order_of,
    scores,
)
from calibench.bench.statistics.two_studies import a12, compare, two_methods
from calibench.bench.store.runs import ResultStore

pytestmark = pytest.mark.usefixtures("one_process")

ORACLE = "an independent library, not installed here (see docs/statistics.md)"


def values(numbers):
    return np.column_stack([np.zeros(len(numbers)), np.asarray(numbers, dtype=float)])


def rows(numbers, hits=None, method="made:M", problem="made:P", first=0, **more):
    """Return runs of one cell: their values, and what the target 1.0 cost each (None: never), where it has one."""
    listed = [None] * len(numbers) if hits is None else hits
    return pd.DataFrame(
        {
            "problem": problem, "problem_options": "{}", "data_id": "", "optimizer": method, "optimizer_options": "{}",
            "start": "random", "budget": 1000, "target": np.nan, "status": "ok",
            "repetition": range(first, first + len(numbers)), "best_value": np.asarray(numbers, dtype=float),
            "inside_box": True,
            "charged": 1000, "judged_value": np.nan, "judged_evaluations": np.nan, "unit": "", "minimum": np.nan,
            "targets": [[] if hits is None else [1.0]] * len(numbers),
            "hits_charged": [[] if hits is None else [hit] for hit in listed],
        }
        | more
    )  # fmt: skip


def test_who_arrived_stands_before_who_did_not_then_cost_then_value():
    runs = rows([0.5, 0.1, 3.0, 2.0], hits=[70, 90, None, None])
    assert order_of(scores(runs)).tolist() == [1, 2, 4, 3]
    assert order_of(scores(runs, "value")).tolist() == [2, 1, 4, 3]
    failed = runs.assign(status=["failed", "ok", "ok", "ok"])  # it had arrived, and has no answer that was judged
    assert order_of(scores(failed)).tolist() == [2, 1, 4, 3]


@pytest.mark.parametrize("ties", [False, True])
def test_a12_and_its_variance_are_scipys(ties):
    rng = np.random.default_rng(1)
    x, y = rng.normal(0, 1, 14), rng.normal(0.5, 2, 19)
    x, y = (x.round(), y.round()) if ties else (x, y)
    effect = a12(values(x), values(y))
    known = stats.mannwhitneyu(y, x).statistic / (len(x) * len(y))  # how often y is the larger
    assert effect.a12 == pytest.approx(known, rel=1e-12)
    spread = effect.a12 * (1 - effect.a12)
    reach = (np.log(effect.high / (1 - effect.high)) - np.log(effect.low / (1 - effect.low))) / 2
    statistic = stats.brunnermunzel(x, y)
    error = abs((effect.a12 - 0.5) / statistic.statistic)
    freedom = stats.t.ppf(0.975, _freedom(x, y))
    assert reach == pytest.approx(freedom * error / spread, rel=1e-9)


def _freedom(x, y):
    """Return Brunner and Munzel's degrees of freedom from the p-value that SciPy gives for them."""
    found = stats.brunnermunzel(x, y)
    return optimize.brentq(lambda free: 2 * stats.t.sf(abs(found.statistic), free) - found.pvalue, 1, 100, xtol=1e-12)


def test_the_interval_of_a12_covers():
    rng = np.random.default_rng(20081598)
    held = {True: 0, False: 0}
    truth = stats.norm.cdf(0.6 / np.sqrt(2))
    for _ in range(200):
        shared = rng.normal(size=15)
        for paired in held:
            common = shared if paired else rng.normal(size=15)
            x, y = (0.7 * base + np.sqrt(0.51) * rng.normal(size=15) for base in (shared, common))
            effect = a12(values(x), values(y + 0.6), paired)
            held[paired] += effect.low <= truth <= effect.high
    assert all(count / 200 >= 0.93 for count in held.values())


def test_all_runs_better_is_no_certainty():
    effect = a12(values([1, 2, 3]), values([4, 5, 6]))
    assert effect.a12 == effect.high == 1
    assert effect.low == pytest.approx(stats.binomtest(3, 3).proportion_ci(method="wilson").low)


def test_pairs_are_tested_by_all_exchanges():
    rng = np.random.default_rng(2)
    first, second = values(rng.normal(size=7).round(1)), values(rng.normal(0.8, 1, 7).round(1))
    found = two_methods(first, second, paired=True)
    ranks = order_of(np.concatenate([first, second]))
    difference = ranks[7:] - ranks[:7]
    difference = difference[difference != 0]
    signed = stats.rankdata(np.abs(difference))
    sums = [signed[np.array(signs)].sum() for signs in itertools.product([True, False], repeat=len(signed))]
    middle, seen = signed.sum() / 2, signed[difference > 0].sum()
    known = np.mean([abs(s - middle) >= abs(seen - middle) - 1e-9 for s in sums])
    assert found.test == "signed-rank"
    assert found.p == pytest.approx(known, rel=1e-12)


def test_many_pairs_are_near_scipys_approximation():
    rng = np.random.default_rng(7)
    for n in (20, 30, 60):
        ranks = rng.permutation(2 * n) + 1.0
        near = stats.wilcoxon(ranks[n:] - ranks[:n], method="asymptotic").pvalue
        assert two_methods(values(ranks[:n]), values(ranks[n:]), paired=True).p == pytest.approx(near, abs=0.02)


def test_runs_without_partners_are_tested_by_mann_whitney():
    rng = np.random.default_rng(3)
    x, y = rng.normal(size=8), rng.normal(1, 1, 11)
    found = two_methods(values(x), values(y), paired=False)
    assert found.test == "Mann-Whitney"
    assert found.p == pytest.approx(stats.mannwhitneyu(x, y, method="exact").pvalue, rel=1e-12)


@pytest.mark.parametrize("runs", [2, 3, 30, 6000])
def test_a_single_run_beside_many_is_as_likely_to_be_any_of_them(runs):
    many, best = values(np.arange(1.0, runs + 1)), values([0.0])
    least = min(1.0, 2 / (runs + 1))
    for first, second in ((many, best), (best, many)):
        assert two_methods(first, second, paired=False).p == pytest.approx(least)
    middle = values([runs / 2 + 0.5])
    assert two_methods(many, middle, paired=False).p == 1


def test_five_pairs_decide_nothing_and_it_says_so():
    compared = compare(rows([1, 2, 3, 4, 5]), rows([11, 12, 13, 14, 15]))
    (cell,) = compared.cells.to_dict("records")
    assert (cell["verdict"], cell["pairs"]) == ("undecided", 5)
    assert cell["why"] == "5 pairs cannot give a p below 0.062"


def test_verdicts_are_of_the_second():
    a, b = rows(range(10)), rows(np.arange(10) + 20.0)
    assert compare(a, b).cells["verdict"].tolist() == ["worse"]
    assert compare(b, a).cells["verdict"].tolist() == ["better"]
    assert compare(a, a).cells["verdict"].tolist() == ["equal"]


def test_pairs_that_lean_to_one_side_and_couples_that_lean_to_the_other_decide_nothing():
    a = 2.0 * np.arange(1, 61)
    b = np.where(a > 12, a - 1, a + 1000)  # of 60 runs 54 are a little ahead of their partners, 6 far behind
    found = two_methods(values(a), values(b), paired=True)
    assert found.p < 1e-3
    assert found.effect.a12 < 0.5
    assert found.ahead == 0
    (cell,) = compare(rows(a), rows(b)).cells.to_dict("records")
    assert cell["verdict"] == "undecided"
    assert cell["why"].endswith("but of all couples as many or more say the opposite")


def test_pairs_share_their_repetition():
    a, b = rows(range(10)), rows(range(10), first=4)
    (cell,) = compare(a, b).cells.to_dict("records")
    assert (cell["pairs"], cell["test"]) == (6, "signed-rank")
    (apart,) = compare(a, rows(range(10), first=10)).cells.to_dict("records")
    assert apart["pairs"] == 0
    assert apart["runs_b"] == 10


def test_without_chance_a_difference_is_a_fact():
    a = rows([1.0], hits=[90], method="lm", start="nominal")
    slower = rows([1.0], hits=[91], method="lm", start="nominal")
    (cell,) = compare(a, slower).cells.to_dict("records")
    assert (cell["verdict"], cell["test"]) == ("worse", "fact")
    assert compare(a, a).cells["verdict"].tolist() == ["equal"]
    one = rows([1.0], hits=[90]), rows([1.0], hits=[91])  # a method that is not known here: one draw each
    assert compare(*one).cells["verdict"].tolist() == ["undecided"]


def test_one_value_without_chance_is_beside_the_runs_of_the_other_side():
    fixed = rows([1.0], hits=[90], method="lm", start="nominal")
    drawn = rows([1.0] * 9 + [5.0], hits=[*range(100, 109), None], method="lm")
    found = two_methods(scores(fixed), scores(drawn), paired=False, chance=(False, True))
    assert (found.test, found.p, found.ahead) == ("sign", stats.binomtest(10, 10).pvalue, -1)


def test_cells_match_by_chosen_options_or_by_the_only_other_ones():
    plain, full = '{"population":150}', '{"CR":0.8,"F":0.5,"early_abandon":false,"population":150}'
    a = rows(range(8), method="de", optimizer_options=plain)
    assert len(compare(a, rows(range(8), method="de", optimizer_options=full)).cells) == 1
    (cell,) = compare(a, rows(range(8), method="de", optimizer_options='{"population":30}')).cells.to_dict("records")
    assert cell["other_options"] == "population=default -> 30"
    two = pd.concat([rows(range(8), method="de", optimizer_options=f'{{"population":{n}}}') for n in (30, 40)])
    compared = compare(a, two)
    assert (len(compared.cells), compared.only_first, compared.only_second) == (0, 1, 2)


def test_holms_correction_is_over_all_cells():
    parts = [(rows(range(7), problem=f"made:P{i}"), rows(np.arange(7) + 9.0, problem=f"made:P{i}")) for i in range(8)]
    one = compare(*parts[0]).cells
    assert one["verdict"].tolist() == ["worse"]
    many = compare(*(pd.concat(side) for side in zip(*parts, strict=True))).cells
    assert (many["p"] == one["p"][0]).all()
    assert many["verdict"].unique().tolist() == ["undecided"]  # 8 times 2 / 2^7 is above .05


def test_equals_are_told_apart_no_more_often_than_allowed(capsys):
    found = list(false_positives(50, cells=2, settings=(2, 5)))
    assert len(found) == 2
    assert all(share <= 0.05 + 3 * np.sqrt(0.05 * 0.95 / 50) for _, share in found)


def test_holm_is_that_of_statsmodels():
    multitest = pytest.importorskip("statsmodels.stats.multitest", reason=ORACLE)
    p = np.random.default_rng(4).random(30) ** 3
    assert holm(p) == pytest.approx(multitest.multipletests(p, method="holm")[1], rel=1e-12)
    with_gap = np.insert(p, 5, np.nan)
    assert np.delete(holm(with_gap), 5) == pytest.approx(holm(p))


@pytest.fixture
def blocks():
    rng = np.random.default_rng(5)
    medians = rng.normal(size=(14, 5)).round(1) + np.array([0, 0.2, 0.8, 1.5, 1.6])
    return Blocks(tuple("abcde"), medians.round(1))


def test_friedman_and_nemenyi_are_those_of_scikit_posthocs(blocks):
    posthocs = pytest.importorskip("scikit_posthocs", reason=ORACLE)
    found = friedman(blocks)
    known = posthocs.posthoc_nemenyi_friedman(blocks.medians)
    order = [blocks.methods.index(name) for name in found.methods]
    assert found.nemenyi == pytest.approx(known.to_numpy()[np.ix_(order, order)], rel=1e-9, abs=1e-12)
    assert found.p == stats.friedmanchisquare(*blocks.medians.T).pvalue


def test_the_critical_difference_is_that_of_autorank(blocks):
    autorank = pytest.importorskip("autorank._util", reason=ORACLE)
    known = autorank._critical_distance(0.05, k=5, n=14)  # by a fit to a table, of five digits
    assert friedman(blocks).critical_difference == pytest.approx(known, rel=2e-5)


def test_the_critical_difference_is_demsars():
    """Demsar 2006, table 5: q of .05 is 2.569 for four methods, so CD 1.25 on 14 data sets (section 3.2.4)."""
    found = friedman(Blocks(tuple("abcd"), np.random.default_rng(6).normal(size=(14, 4))))
    assert found.critical_difference == pytest.approx(2.569 * np.sqrt(4 * 5 / (6 * 14)), rel=2e-4)


def test_groups_join_what_is_not_told_apart(blocks):
    found = friedman(blocks)
    for first, last in found.groups():
        assert found.mean_ranks[last] - found.mean_ranks[first] < found.critical_difference
        if last + 1 < 5:
            assert found.mean_ranks[last + 1] - found.mean_ranks[first] >= found.critical_difference


def test_repetitions_are_never_blocks():
    runs = pd.concat([rows(np.arange(30) + shift, method=f"made:{m}") for shift, m in enumerate("abc")])
    found = friedman(blocks_of(runs))
    assert found.blocks == 1
    assert found.refused.startswith(f"Friedman's test needs {FEWEST} blocks")
    with pytest.raises(ValueError, match="10 blocks"):
        critical_difference(found)


def test_budgets_of_one_problem_are_one_block_at_the_largest_that_all_methods_have():
    budgets = [(300, "abc"), (1500, "abc"), (9000, "a")]
    parts = [
        rows(np.arange(3.0) + shift * sign, method=f"made:{m}", problem=f"made:P{i}", budget=budget)
        for i in range(5)
        for budget, names in budgets
        for shift, m in enumerate(names)
        for sign in [-9.0 if budget == 300 else 9.0]
    ]
    blocks = blocks_of(pd.concat(parts))
    assert blocks.medians.shape == (5, 3)
    assert (np.diff(blocks.medians, axis=1) > 0).all()
    assert not blocks.left_out


def test_a_block_has_the_median_over_repetitions_and_incomplete_ones_are_told():
    parts = [
        rows(np.array([1.0, 2.0, 99.0]) + shift, method=f"made:{m}", problem=f"made:P{i}")
        for i in range(11)
        for shift, m in ((0.0, "a"), (0.5, "b"), (10.0, "c"))
        if (i, m) != (10, "c")
    ]
    blocks = blocks_of(pd.concat(parts))
    assert blocks.medians.shape == (10, 3)
    assert blocks.left_out.startswith("1 tasks")
    found = friedman(blocks)
    assert found.methods == ("made:a", "made:b", "made:c")
    assert not found.refused
    figure, numbers = critical_difference(found)
    assert numbers["mean_rank"].tolist() == found.mean_ranks.tolist()
    assert {"made:a", "made:b", "made:c"} <= {text.get_text().split()[0] for text in figure.axes[0].texts}


def test_the_command_compares_two_folders(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, budget_spent in (("a", 30), ("b", 60)):
        made = ResultStore(tmp_path / name)
        made.open()
        for seed in range(8):
            problem, own = problems.make("sensor_zero"), optimizers.make("de", population=budget_spent)
            made.write(bench.execute(problem, own, budget=600, seed=seed, start="random"))
    shutil.copytree(tmp_path / "a", tmp_path / "twin")
    assert _bench("compare", tmp_path / "a", tmp_path / "twin") == 0
    assert "1 equal" in capsys.readouterr().out
    assert _bench("compare", tmp_path / "a", tmp_path / "b") == 1  # twice the population is slower here
    assert "population=30 -> 60" in capsys.readouterr().out
    assert _bench("compare", tmp_path / "b", tmp_path / "a", "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["better"], told["worse"], told["cells"][0]["pairs"]) == (1, 0, 8)
    assert _bench("compare", tmp_path / "a") == 2
    assert _bench("compare", tmp_path / "a", tmp_path / "b", "by=speed") == 2
    assert _bench("compare", tmp_path / "a", tmp_path / "b", "by=value", "by=speed") == 2
    assert _bench("compare", tmp_path / "a", "--methods", "de", "lm") == 2
    assert "choices: de" in capsys.readouterr().err
    assert _bench("compare", tmp_path / "a", tmp_path / "b", "budget=600") == 2
    assert "compare: unknown argument 'budget'; choices: by" in capsys.readouterr().err
    (tmp_path / "a").rename("seeds=8")  # a folder may be called so
    assert _bench("compare", "seeds=8", tmp_path / "twin") == 0


def test_a_problem_of_other_code_is_told(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for study, side in (("a", 1), ("b", 2), ("c", 2)):
        lines = "class P:", f"    lower, upper, start = (-1, -1), ({side}, 1), (0.5, 0.5)", "    __call__ = sum"
        (tmp_path / "mine.py").write_text("\n".join(lines))
        assert _bench("run", "problem=mine.py:P", "optimizer=pso", "budget=40", "target=-0.5", f"study={study}") == 0
    capsys.readouterr()
    for one, other, told in (("a", "b", True), ("b", "c", False)):
        _bench("compare", f"results/{one}", f"results/{other}")
        out = capsys.readouterr().out
        assert ("mine.py:P is of other code, or other data, in B" in out) == told
        _bench("compare", f"results/{one}", f"results/{other}", "--json")
        assert json.loads(capsys.readouterr().out)["changed_problems"] == ["mine.py:P"] * told
        assert re.search(r"\d+/\d+ -> \d+/\d+ after \d+ -> \d+", out)  # what reaching the goal cost


def test_where_no_cell_is_in_both_it_says_what_differs(tmp_path, capsys):
    def compared(a, b):
        for name, sides in (("a", a), ("b", b)):
            runs_of(tmp_path / name, *sides)
        with pytest.raises(SystemExit) as ended:
            main(["compare", str(tmp_path / "a"), str(tmp_path / "b")])
        assert ended.value.code == 2
        return capsys.readouterr().err

    def runs_of(folder, *words):
        shutil.rmtree(folder, ignore_errors=True)
        for word in words:
            with pytest.raises(SystemExit):
                main(
                    [
                        "run",
                        "problem=sensor_zero",
                        *word.split(),
                        "seeds=1",
                        f"results={tmp_path}",
                        f"study={folder.name}",
                    ]
                )

    one = "optimizer=de budget=20"
    assert "optimizer is de in A and pso in B" in compared([one], ["optimizer=pso budget=20"])
    assert "budget is 20 in A and 30 in B" in compared([one], ["optimizer=de budget=30"])
    two = [f"{one} optimizer.population={n}" for n in (5, 6)]
    assert "options differ, and a side has several settings" in compared([one], two)


def test_the_command_compares_two_settings_by_the_names_that_tables_give_them(tmp_path, capsys):
    made = ResultStore(tmp_path / "s")
    made.open()
    for name, population in (("de", 10), ("de", 30), ("pso", 10), ("pso", 30)):
        for seed in range(8):
            own = optimizers.make(name, population=population)
            made.write(bench.execute(problems.make("sensor_zero"), own, budget=300, seed=seed, start="random"))
    assert _bench("compare", tmp_path / "s", "--methods", "de", "pso") == 2
    err = capsys.readouterr().err
    assert "several settings" in err
    assert "'de (population=10)', 'de (population=30)', 'pso (population=10)', 'pso (population=30)'" in err
    assert _bench("compare", tmp_path / "s", "--methods", "de (population=10)", "de (population=30)", "--json") in (
        0,
        1,
    )
    first, second = (json.loads(text) for text in _cell_options(capsys.readouterr().out))
    assert (first["population"], second["population"]) == (10, 30)
    assert _bench("compare", tmp_path / "s", "--methods", "de (population=10)", "de (population=20)") == 2
    assert "no run of 'de (population=20)' there; did you mean 'de (population=" in capsys.readouterr().err


def test_one_pair_is_told_as_one(tmp_path, capsys):
    made = ResultStore(tmp_path / "s")
    made.open()
    made.write(bench.execute(problems.make("sensor_zero"), optimizers.make("trf"), budget=60))
    assert _bench("compare", tmp_path / "s", tmp_path / "s") == 0
    assert " 1 pair  " in capsys.readouterr().out


def _cell_options(told):
    """Return the options of both sides of the one cell of ``compare --json``."""
    (cell,) = json.loads(told)["cells"]
    return cell["optimizer_options"], cell["other_options"].partition(" ")[2]


def _bench(*words):
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
    return ended.value.code


def test_by_charge_a_run_that_crashed_early_is_not_the_cheapest():
    """Its charge is small because it never ended; a run that ran out of time did not end either."""
    runs = rows([0.5, 0.1, 3.0, 2.0], status=["failed", "ok", "ok", "timeout"], charged=[2, 90, 70, 5])
    assert order_of(scores(runs, "charged")).tolist() == [3.5, 2, 1, 3.5]
    sound, crashed = rows([1.0] * 8, charged=500), rows([9.0] * 8, charged=2, status="failed")
    [cell] = compare(sound, crashed, "charged").cells.itertuples()
    assert cell.verdict == "worse"


def test_by_charge_equal_says_that_the_charge_is_equal_not_the_values():
    one, other = rows([1.0] * 8), rows([9.0] * 8)
    [cell] = compare(one, other, "charged").cells.itertuples()
    assert (cell.verdict, cell.why) == ("equal", "every run was charged the same")
    [cell] = compare(one, other, "value").cells.itertuples()
    assert cell.verdict == "worse"


def test_runs_that_are_equal_up_to_their_goal_are_not_said_to_give_the_same():
    one, other = rows([1e-7] * 8, hits=[60] * 8), rows([1e-5] * 8, hits=[60] * 8)
    [cell] = compare(one, other).cells.itertuples()
    assert (cell.verdict, cell.why) == ("equal", "every run is the same up to its end or goal")


def test_of_unequal_seeds_every_number_is_of_the_runs_that_were_tested():
    """Ten runs against eight are eight pairs: nothing of the two runs left out may stand beside the verdict."""
    many = rows([4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 0.1, 0.2], hits=[None] * 8 + [30, 40])
    few = rows([4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0], hits=[None] * 8)
    [cell] = compare(many, few).cells.itertuples()
    assert (cell.verdict, cell.pairs, cell.alone_a, cell.alone_b) == ("equal", 8, 2, 0)
    assert (cell.reached_a, cell.reached_b) == (0, 0)
    assert cell.best_median_a == cell.best_median_b == 7.5
    [cell] = compare(few, many).cells.itertuples()
    assert (cell.alone_a, cell.alone_b, cell.reached_b, cell.best_median_b) == (0, 2, 0, 7.5)


@pytest.mark.parametrize("by", ["goal", "value", "charged"])
def test_two_sides_that_only_failed_are_not_equal(by):
    one, other = (rows([np.nan] * 8, status="failed", charged=charge) for charge in (3, 40))
    [cell] = compare(one, other, by).cells.itertuples()
    assert cell.verdict == "undecided"
    assert cell.why.startswith("no run of either side")


def test_by_value_a_difference_below_the_goal_is_told_as_one_that_may_be_rounding():
    one, other = rows([1e-20] * 8, hits=[5] * 8), rows([1e-22] * 8, hits=[5] * 8)
    [cell] = compare(one, other, "value").cells.itertuples()
    assert cell.verdict == "better"
    assert "below the goal" in cell.why
    [cell] = compare(one.assign(hits_charged=[[None]] * 8), other, "value").cells.itertuples()
    assert "below the goal" not in cell.why
