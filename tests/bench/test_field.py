"""The field: both kinds of every local method, told apart in the picture and on the page."""

from __future__ import annotations

import pandas as pd
import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from benchmarks.field.__main__ import counted, page
from calibench import bench, optimizers
from calibench.bench.cli import main
from calibench.bench.report.study import figures
from calibench.bench.statistics.summary import endings
from calibench.bench.sweep.composition import study_preset


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> pd.DataFrame:
    """Two local methods in both kinds, and one that spends its budget, on a problem of three unknowns."""
    folder = tmp_path_factory.mktemp("field")
    words = ["run", "-m", "problem=sensor_zero", "budget=200", "seeds=2", "start=random", f"results={folder}"]
    for more in (["optimizer=lm,trf,nlopt_GN_ESCH"], ["optimizer=lm,trf", "optimizer.restarts=true"]):
        with pytest.raises(SystemExit) as ended:
            main([*words, *more])
        assert ended.value.code == 0
    return bench.ResultStore(folder / "adhoc").runs()


def test_the_study_has_every_local_method_in_both_kinds() -> None:
    kinds: dict[bool, set[str]] = {False: set(), True: set()}
    for words in (study_preset("field") or {})["sweeps"]:
        chosen = next(word for word in words if word.startswith("optimizer="))
        names = OverridesParser.create().parse_override(chosen).value().filter(optimizers.names())  # a glob
        kinds["optimizer.restarts=true" in words] |= set(names)
    assert kinds[False] == set(optimizers.names())
    assert kinds[True] == {name for name in optimizers.names() if "restarts" in optimizers.registry.options(name)}


def test_each_kind_is_called_by_its_name(runs: pd.DataFrame) -> None:
    assert set(zip(runs["optimizer"], endings(runs), strict=True)) == {
        ("lm", "stops"), ("lm", "restarts"), ("trf", "stops"), ("trf", "restarts"), ("nlopt_GN_ESCH", ""),
    }  # fmt: skip


def test_what_is_not_known_here_has_no_kind() -> None:
    table = pd.DataFrame({"optimizer": ["mine:Own", "lm"], "optimizer_options": ["{}", '{"gone": 3}']})
    assert endings(table).tolist() == ["", ""]


def test_the_picture_says_which_method_stops_and_which_restarts(runs: pd.DataFrame) -> None:
    figure, numbers = figures.overview(runs)
    labels = {text.get_text() for axes in figure.axes[:1] for text in axes.get_yticklabels()}
    assert labels == {"lm · stops", "lm · restarts", "trf · stops", "trf · restarts", "nlopt_GN_ESCH"}
    assert set(zip(numbers["label"], numbers["ends"], strict=True)) == {
        (label, label.partition(" · ")[2]) for label in labels
    }


def test_the_page_has_a_row_for_each_kind_and_counts_the_runs_at_the_goal(runs: pd.DataFrame) -> None:
    never = runs.copy()
    never["hits_charged"] = [
        [None] * len(hits) if optimizer == "trf" else hits
        for optimizer, hits in zip(never["optimizer"], never["hits_charged"], strict=True)
    ]  # as if it had never got there
    cells = counted(never).set_index(["method", "ends"])
    assert cells.loc["trf", "reached"].tolist() == [0, 0]
    assert cells.loc["lm", "reached"].tolist() == [2, 2]
    rows = [line.split(" | ")[:3] for line in page(runs).splitlines() if line.startswith("| `")]
    assert ["| `lm`, `trf`", "stops, restarts", "2/2 |"] in rows
    assert {(names, ends) for names, ends, _ in rows} >= {("| `nlopt_GN_ESCH`", "spends it")}
