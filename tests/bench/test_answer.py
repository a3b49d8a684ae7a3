"""The answer: the page is what the generator makes of the table that is kept, and its numbers are those of the rows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from benchmarks.answer.compact import KNOWS, STORED, compact, joined, store, stored
from benchmarks.answer.figure import DRAWN, RANKED, draw, draw_ranks
from benchmarks.answer.page import later, page
from benchmarks.answer.standing import ert_bounds, leading, ranked, standing, winners
from calibench import bench, optimizers
from calibench.bench.cli import main
from calibench.bench.statistics.fixed_target import ert
from calibench.bench.statistics.tables import problem_of
from calibench.bench.statistics.targets import levels_of
from calibench.bench.sweep.request import study_preset

pytestmark = pytest.mark.usefixtures("one_process")

ROOT = Path(__file__).resolve().parents[2]
HANGS = "nlopt_LN_NEWUOA_BOUND"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The results of two families, two instances, a method of each kind."""
    folder = tmp_path_factory.mktemp("answer")
    words = ["problem=sensor_zero,orthoglide6", "problem.instance=1,2", "optimizer=lm,fmincon,de", "budget=100"]
    with pytest.raises(SystemExit) as ended:
        main(["run", "-m", *words, "seeds=1", "start=random", f"results={folder}"])
    assert ended.value.code == 0
    return folder


@pytest.fixture(scope="module")
def runs(folder: Path) -> pd.DataFrame:
    return bench.ResultStore(folder / "adhoc").runs()


@pytest.fixture(scope="module")
def kept() -> pd.DataFrame:
    return stored(ROOT / STORED)


def test_families_drawn_later_take_their_place_beside_those_that_are_kept(runs: pd.DataFrame) -> None:
    drawn = compact(runs)
    late = drawn[drawn["family"] == "orthoglide6"].assign(charged=1)
    both = joined(drawn, late)
    assert list(both.columns) == list(drawn.columns)
    pd.testing.assert_frame_equal(both.drop(columns="charged"), drawn.drop(columns="charged"))
    assert both.groupby("family")["charged"].max().to_dict() == {
        "orthoglide6": 1,
        "sensor_zero": drawn[drawn["family"] == "sensor_zero"]["charged"].max(),
    }


def rows(reached: dict[str, list[float]], spent: float = 100.0) -> pd.DataFrame:
    """Return a table of one family: for each method the charges at which its blocks were reached, NaN: never."""
    found = []
    for method, at in reached.items():
        for instance, charge in enumerate(at, start=1):
            found.append({
                "family": "full11", "instance": instance, "noise": 0.0, "method": method, "ends": "", "knows": "values",
                "budget": 100, "repetition": 0, "status": "ok", "inside_box": True, "reached_at": charge,
                "charged": spent, "excess": 0.5 if charge == charge else 10.0 + instance, "position_error_mm": 1.0,
                "parameter_error_mm": 2.0,
            })  # fmt: skip
    return pd.DataFrame(found)


@pytest.mark.slow  # a minute and more
def test_the_page_is_what_the_generator_makes_of_the_table_that_is_kept(kept: pd.DataFrame) -> None:
    assert (ROOT / "docs" / "answer.md").read_text(encoding="utf-8") == page(kept), "run: python -m benchmarks.answer"


def test_the_table_that_is_kept_has_every_family_instance_and_kind(kept: pd.DataFrame) -> None:
    blocks = kept[["family", "instance", "budget"]].drop_duplicates()
    assert set(blocks.groupby(["family", "budget"]).size()) == {24}
    assert set(kept["budget"]) == {200, 2000}
    assert set(kept["knows"]) == set(KNOWS)
    extras = {name for name in optimizers.names() if optimizers.make(name).traits.package not in ("", "pygmo")}
    assert {*kept["method"], *later(kept)} == set(optimizers.names()) - {HANGS} - extras


def test_the_study_is_the_whole_field_but_the_one_that_hangs() -> None:
    kinds: dict[bool, set[str]] = {False: set(), True: set()}
    for words in (study_preset("calibration24") or {})["sweeps"]:
        chosen = next(word for word in words if word.startswith("optimizer="))
        names = OverridesParser.create().parse_override(chosen).value().filter(optimizers.names())  # a glob
        kinds["optimizer.restarts=true" in words] |= set(names)
    assert kinds[False] == set(optimizers.names()) - {HANGS}
    restart = {name for name in optimizers.names() if "restarts" in optimizers.registry.options(name)}
    assert kinds[True] == restart - {HANGS}


def test_a_run_has_reached_the_noise_where_its_value_has(runs: pd.DataFrame) -> None:
    table = compact(runs)
    assert len(table) == len(runs) == 12
    np.testing.assert_array_equal(table["reached_at"].notna(), table["excess"] <= 1)
    assert (table["reached_at"].dropna() <= 100).all()
    assert set(zip(table["method"], table["knows"], strict=True)) == {
        ("lm", "residuals"), ("fmincon", "gradient"), ("de", "values"),
    }  # fmt: skip
    assert table["position_error_mm"].notna().all()


def test_the_table_comes_back_as_it_was_stored(runs: pd.DataFrame, tmp_path: Path) -> None:
    table = compact(runs)
    store(table, tmp_path / "answer.parquet")
    back = stored(tmp_path / "answer.parquet")
    np.testing.assert_array_equal(back["reached_at"], table["reached_at"])
    np.testing.assert_allclose(back["excess"], table["excess"], rtol=1e-3)
    assert page(back) == page(back.sample(frac=1, random_state=1).sort_index())


def test_the_answer_of_problems_without_instances_is_refused(runs: pd.DataFrame) -> None:
    without = runs.assign(problem_options="{}", problem="sensor_zero")
    with pytest.raises(ValueError, match="has no instance"):
        compact(without)


def test_a_run_that_never_arrives_pays_all_it_spent() -> None:
    found = standing(rows({"one": [10, 20, np.nan, np.nan]})).iloc[0]
    assert found["reached"] == 2
    assert found["ert"] == (10 + 20 + 100 + 100) / 2
    assert np.isinf(standing(rows({"none": [np.nan, np.nan]}))["ert"].iloc[0])


def test_what_a_method_pays_is_what_the_statistics_say(runs: pd.DataFrame, folder: Path) -> None:
    table, found = compact(runs), levels_of(runs, {"noise": [1.0]})
    theirs = ert(bench.ResultStore(folder / "adhoc").hits(found), runs, instances=("instance",))
    for row in theirs.to_dict("records"):
        mine = standing(table[(table["family"] == row["problem"])]).set_index("method").loc[row["optimizer"]]
        assert mine["reached"] == row["reached"]
        assert mine["ert"] == pytest.approx(row["ert"], rel=1e-9)
    assert len(theirs) == 6


def test_the_interval_of_what_is_paid_holds_it(kept: pd.DataFrame) -> None:
    largest = kept[kept["budget"] == 2000]
    for row in leading(largest, 1).to_dict("records"):
        low, high = ert_bounds(largest, row["name"])
        assert low < row["ert"] < high


def test_who_reaches_more_stands_first_then_who_pays_less() -> None:
    table = rows({"dear": [90, 90, 90], "cheap": [10, 10, 10], "often": [5, 5, np.nan]})
    assert standing(table)["name"].tolist() == ["cheap", "dear", "often"]
    assert winners(table) == {"values": "cheap"}


def test_a_method_that_cannot_run_everywhere_does_not_win_by_it() -> None:
    found = standing(rows({"whole": [50, 50, 50, np.nan], "part": [5, 5]}))
    assert found["name"].tolist() == ["whole", "part"]
    assert found["share"].tolist() == [0.75, 0.5]


def test_repetitions_are_no_blocks() -> None:
    table = rows({"a": [10, np.nan]})
    again = table.assign(repetition=1, reached_at=[20.0, np.nan])
    found = standing(pd.concat([table, again.assign(reached_at=np.nan)])).iloc[0]
    assert (found["blocks"], found["reached"], found["share"]) == (2, 0.5, 0.25)


def test_methods_that_came_to_the_same_everywhere_are_one_line() -> None:
    table = rows({"inner": [5, 7], "wrapped": [5, 7], "other": [9, 9]})
    found = leading(table, 5).set_index("name")
    assert found["alike"].to_dict() == {"inner": "wrapped", "other": ""}
    assert "¹ Alike in every run: `inner, stops`: `wrapped`." in page(table.assign(ends="stops"))


def test_the_test_ranks_who_arrived_by_when_and_the_others_by_how_near() -> None:
    one = {"first": [1.0] * 12, "second": [2.0] * 12, "never": [np.nan] * 12}
    table = rows(one)
    far = rows({"far": [np.nan] * 12}).assign(excess=1e6)
    test, lacking = ranked(pd.concat([table, far]))
    assert test.methods == ("first", "second", "never", "far")
    assert test.mean_ranks.tolist() == [1, 2, 3, 4]
    assert test.blocks == 12
    assert lacking == []
    assert test.statistic == pytest.approx(36)  # blocks x (methods - 1): the largest there is


def test_a_method_that_lacks_a_block_is_left_out_and_named() -> None:
    table = rows({"a": [1.0] * 12, "b": [2.0] * 12, "c": [3.0] * 12, "short": [1.0] * 6})
    test, lacking = ranked(table)
    assert lacking == ["short"]
    assert "short" not in test.methods


def test_under_ten_blocks_there_is_no_test_and_the_page_says_why(runs: pd.DataFrame) -> None:
    assert "Friedman's test needs 10 blocks" in " ".join(page(compact(runs)).split())


@pytest.mark.slow
def test_the_picture_shows_the_share_that_has_arrived(kept: pd.DataFrame) -> None:
    figure, numbers = draw(kept)
    largest = kept[kept["budget"] == 2000]
    shares = standing(largest).set_index("name")["share"]
    assert set(numbers["name"]) == set(leading(largest, DRAWN)["name"])
    for name, mine in numbers.groupby("name"):
        assert mine["share"].max() == pytest.approx(shares[name])
        assert mine["charged"].is_monotonic_increasing
    assert figure.axes[0].get_xlabel() == "charged evaluations"


def test_the_ranks_that_are_drawn_are_those_of_the_leading_methods(kept: pd.DataFrame) -> None:
    _, numbers = draw_ranks(kept)
    assert set(numbers["method"]) == set(leading(kept[kept["budget"] == 2000], RANKED)["name"])
    assert numbers["mean_rank"].is_monotonic_increasing
    assert numbers["mean_rank"].mean() == pytest.approx((len(numbers) + 1) / 2)  # of ranks within blocks


def test_the_noise_that_statistics_take_is_that_of_the_instance(runs: pd.DataFrame) -> None:
    for _, row in runs.iterrows():
        (level,) = levels_of(row.to_frame().T, {"noise": [1.0]})["level"]
        assert level == problem_of(row).as_good_as_noise
