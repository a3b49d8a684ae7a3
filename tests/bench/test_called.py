"""What cells are called on the terminal: as tables call them, while the manifest keeps every option as its key."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from calibench import optimizers, problems
from calibench.bench.cli import main
from calibench.bench.commands.study import lines_of
from calibench.bench.statistics.progress import sweep_progress
from calibench.bench.statistics.summary import names_of_methods
from calibench.bench.store.runs import ResultStore, merge
from calibench.bench.sweep.request import read_request
from calibench.core import user_file

MINE = """
from dataclasses import dataclass
import numpy as np

@dataclass(frozen=True)
class Bowl:
    place: tuple[float, ...] = (0.1, 0.2, 0.3)
    slope: float = 2.0
    gain: float = 1.0
    deep: int = 3

    lower = property(lambda self: np.full(3, -1.0))
    upper = property(lambda self: np.full(3, 1.0))
    start = property(lambda self: np.zeros(3))

    def __call__(self, x):
        return float(np.sum((x - np.array(self.place)) ** 2))
"""


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(user_file, "LOADED", {})
    monkeypatch.delitem(sys.modules, "mine", raising=False)
    for registry in (problems.registry, optimizers.registry):  # as in a new process
        monkeypatch.setattr(registry, "_places", {})
        monkeypatch.setattr(registry, "_by_path", {})
    Path("mine.py").write_text(MINE)


def _bench(*words: str) -> int:
    with pytest.raises(SystemExit) as ended:
        main(list(words))
    return int(ended.value.code or 0)


def test_cells_are_called_as_tables_call_them() -> None:
    many = ["problem=./mine.py:Bowl", "optimizer=de,nlopt_LN_BOBYQA", "opt.de.population=10,20", "budget=60", "seeds=2"]
    assert list(read_request(many, True).called.values()) == [
        "de (population=10) on mine.py:Bowl",
        "de (population=20) on mine.py:Bowl",
        "nlopt_LN_BOBYQA on mine.py:Bowl",
    ]
    several = ["problem=sensor_zero", "problem.n=3,9", "optimizer=de", "budget=60,80", "seeds=2"]
    told = set(read_request(several, True).called.values())
    assert told == {f"de on sensor_zero{n}, budget {b}" for n in ("", " n=3") for b in (60, 80)}


def test_variants_of_an_own_method_are_told_apart_by_what_differs() -> None:
    of = "mine.py:Climb"
    both = [(of, json.dumps({"seeded": True, "sigma": sigma})) for sigma in (0.05, 0.2)]
    assert names_of_methods(both) == [f"{of} (sigma=0.05)", f"{of} (sigma=0.2)"]
    assert names_of_methods(both[:1]) == [of]


def test_progress_and_status_say_the_names_and_the_manifest_keeps_the_labels(
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = ["problem=./mine.py:Bowl", "optimizer=de", "budget=60", "seeds=3", "study=s"]
    assert _bench("run", *words) == 0
    said = capsys.readouterr().err
    assert "last: de on mine.py:Bowl\n" in said
    store = ResultStore("results/s")
    label = next(iter(store.manifest()["planned"].values()))
    assert "slope=2.0" in label
    store.plan({"f" * 16: label}, called={label: "de on mine.py:Bowl"})
    assert "   1 left  de on mine.py:Bowl" in lines_of(store, sweep_progress(store))
    written = json.loads(Path("results/s/manifest.json").read_text())
    assert [(cell["label"], cell["called"]) for cell in written["cells"]] == [(label, "de on mine.py:Bowl")]


def test_cells_of_two_sweeps_that_would_have_one_name_are_told_by_their_labels() -> None:
    store = ResultStore("results/s")
    store.open()
    store.plan({"1" * 16: "p x de (population=10)"}, called={"p x de (population=10)": "de on p"})
    assert sweep_progress(store).left == {"de on p": 1}
    store.plan({"2" * 16: "p x de (population=20)"}, called={"p x de (population=20)": "de on p"})
    assert sweep_progress(store).left == {"p x de (population=10)": 1, "p x de (population=20)": 1}
    other = ResultStore("results/old")  # of a version that wrote no names
    other.open()
    other.plan({"3" * 16: "p x lm"})
    merge([store.folder, other.folder], Path("results/both"))
    both = ResultStore("results/both")
    assert sweep_progress(both).left["p x lm"] == 1
    assert both.manifest()["called"] == store.manifest()["called"]


def test_seeds_that_draw_nothing_are_told_as_one_problem(run_bench):
    words = "optimizer=de budget=20 --dry-run"
    _, out, _ = run_bench(f"run -m problem=sensor_zero,full11 problem.data_seed=0,1,2 problem.error=J1,J2 {words}")
    line = "sensor_zero: its 3 data seeds draw nothing (no noise, a fixed plan): they are one problem, not several"
    assert out.splitlines()[0] == line
    assert out.count("draw nothing") == 1
    _, out, _ = run_bench(f"run -m problem=sensor_zero problem.data_seed=0,1 problem.noise=1e-5 {words}")
    assert "draw nothing" not in out


def test_cells_of_several_targets_stay_apart_also_where_the_problem_cannot_be_built(run_bench, tmp_path):
    _, out, _ = run_bench("run -m problem=sensor_zero optimizer=de budget=20 seeds=2 target=1,2 --dry-run")
    assert "2 cells, 4 runs" in out
    assert "de on sensor_zero, target 2" in out
    (tmp_path / "deadly.py").write_text("import os\n\n\nclass Deadly:\n    def __init__(self):\n        os._exit(3)\n")
    assert run_bench("run -m problem=./deadly.py:Deadly optimizer=de budget=20 seeds=2 target=1,2")[0] == 1
    assert sorted(ResultStore("results/adhoc").runs()["target"]) == [1, 1, 2, 2]
