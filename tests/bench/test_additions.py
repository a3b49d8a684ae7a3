"""The report of a study knows no paper: what a paper shows beside the runs, it adds."""

import json
import re
from pathlib import Path

import pandas as pd
import pytest
from matplotlib.figure import Figure

from calibench import bench, optimizers, problems
from calibench.bench.cli import main
from calibench.bench.papers import ADDITIONS
from calibench.bench.papers.rerun import PAPERS
from calibench.bench.report.shared.kept import RECORD
from calibench.bench.report.study.additions import AddedFigure, Addition, Mark, PrintedTable, TableSection
from calibench.bench.report.study.figures import drawable, target_chart
from calibench.bench.report.study.write import write_report
from calibench.bench.store.runs import ResultStore
from tests.bench.conftest import empty_drawings

pytestmark = pytest.mark.usefixtures("one_process")

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("bench/report", "bench/statistics")
PAPER_WORDS = {word for paper in PAPERS for word in (paper.KEY, paper.KEY.rstrip("0123456789"))}


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    store = ResultStore(tmp_path_factory.mktemp("results") / "mine")
    store.open()
    for method in ("lm", "trf"):
        store.write(
            bench.execute(problems.make("full12", gauge="ya2", error="J3"), optimizers.make(method), budget=120)
        )
    return store


def told(runs):
    """Return a printed table of one cell for each run that found a value."""
    return pd.DataFrame(
        {
            "table": "t.first_column", "method": row["optimizer"], "options": row["optimizer_options"],
            "start": row["start"], "target": row["target"], "budget": row["budget"], "quantity": "height as mm^2",
            "unit": "mm^2", "true": 3.0, "printed": 2.0, "read": 3.0, "why": "a <slip> of l^2", "median": 3.0,
            "q1": 3.0, "q3": 3.0, "n": 1,
        }
        for _, row in runs.iterrows()
    )  # fmt: skip


MINE = Addition(
    sections=(
        TableSection(
            "elsewhere", "tables from elsewhere", "Tables & notes", "A <note> on them.",
            (
                PrintedTable("heights", "Heights", told, lambda key: key.partition(".")[2].replace("_", " ")),
                PrintedTable("nothing", "Nothing", lambda runs: told(runs.iloc[:0])),
            ),
        ),
    ),
    figures=(
        AddedFigure("square", "A square", lambda runs: True, lambda runs, traces: (Figure(), runs[["run_id"]])),
        AddedFigure("never", "Never", lambda runs: False, lambda runs, traces: (Figure(), runs)),
    ),
    marks=lambda runs: (Mark(50, "where others stopped"),),
    links=lambda folder: {"another page": f"../{folder.name}.html"},
)  # fmt: skip


def test_neither_report_nor_statistics_name_a_paper_or_a_problem():
    words = PAPER_WORDS | set(problems.registry.names())
    assert {"cong2008", "pashkevich", "full12", "orthoglide6"} <= words
    named = re.compile(rf"\b({'|'.join(map(re.escape, sorted(words)))})", re.IGNORECASE)
    files = [path for room in ROOMS for path in sorted((ROOT / room).rglob("*")) if path.is_file()]
    read = {path: path.read_text(encoding="utf-8") for path in files if path.suffix != ".pyc"}
    assert len(read) > 20
    assert {f"{path.relative_to(ROOT)}: {word}" for path, text in read.items() for word in named.findall(text)} == set()


def test_an_addition_is_seen_where_it_belongs(store):
    write_report(store, (MINE,))
    page = (store.folder / "report.html").read_text(encoding="utf-8")
    section = page[page.index('<h2 id="elsewhere">') :].partition("<h2 id=beside>")[0]
    assert section.startswith('<h2 id="elsewhere">Tables &amp; notes</h2>\n<p>A &lt;note&gt; on them.</p>')
    for said in ("Heights", "first column", "height [mm²]", "<s>2</s> 3", "a &lt;slip&gt; of l²"):
        assert said in section
    assert "Nothing" not in section
    assert "tables from elsewhere</a>" in page
    assert "../mine.html" in page
    assert "A square" in page
    assert "where others stopped" in page
    assert (store.folder / "tables" / "heights.csv").exists()
    assert not (store.folder / "tables" / "nothing.csv").exists()
    assert (store.folder / "figures" / "square.png").exists()
    assert not (store.folder / "figures" / "never.png").exists()


@pytest.mark.parametrize("code", ["same", "another"])
def test_what_a_report_has_no_more_goes_and_a_file_of_ones_own_stays(store, code):
    with empty_drawings():
        write_report(store, (MINE,))
    if code == "another":
        record = json.loads((store.folder / RECORD).read_text())
        (store.folder / RECORD).write_text(json.dumps(record | {"code": code}))
    own = store.folder / "figures" / "square_mine.png"
    own.touch()
    with empty_drawings():
        write_report(store)
    left = {path.stem for path in store.folder.glob("*/*")}
    assert "convergence_full12" in {name.partition("_gauge")[0] for name in left}
    assert own.exists()
    assert not {"square", "heights"} & left


def test_without_additions_a_report_shows_the_runs_alone(store):
    runs, traces = store.runs(), store.traces()
    assert {name.partition("_")[0] for name, _ in drawable(runs, traces)} == {"convergence", "target"}
    for marks in ((), (Mark(7, "a stop"),)):
        lines = target_chart(runs, marks=marks)[0].axes[0].get_lines()
        assert ([7, 7] in [list(line.get_xdata()) for line in lines]) is bool(marks)


def test_the_paper_says_where_it_stopped_only_of_runs_that_went_as_far(store):
    runs = store.runs()
    (cong,) = (addition for addition in ADDITIONS if addition.sections)
    unmoved = runs.assign(problem_options=json.dumps(problems.make("full12").options))
    assert not cong.marks(unmoved)
    assert [mark.at for mark in cong.marks(unmoved.assign(budget=10**9))] == [50_000_000]
    assert not cong.marks(runs.assign(budget=10**9))  # section 3's gauge, where nothing was searched


def test_every_figure_that_a_paper_adds_is_listed(capsys):
    with pytest.raises(SystemExit):
        main(["list", "figures", "--json"])
    listed = {row["name"] for row in json.loads(capsys.readouterr().out)}
    added = {figure.name for addition in ADDITIONS for figure in addition.figures}
    assert added
    assert added <= listed
