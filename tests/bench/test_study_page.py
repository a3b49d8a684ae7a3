"""The page of a study: it needs nothing else, keeps every problem and every failure, and trusts no text as HTML."""

import base64
import hashlib
import html
import json
import re
import sys
from html.parser import HTMLParser

import pytest

from calibench import bench, optimizers, problems
from calibench.bench.cli import main
from calibench.bench.papers import ADDITIONS
from calibench.bench.report.shared.page import drawing_inside
from calibench.bench.report.study.html_tables import by_error, count, number, ranked
from calibench.bench.report.study.page import StudyPage
from calibench.bench.report.study.write import write_report
from calibench.bench.statistics import summary
from calibench.bench.store.runs import ResultStore
from tests.bench.conftest import empty_drawings

pytestmark = pytest.mark.usefixtures("one_process")

OWN = """
import numpy as np
class Bowl:
    "A bowl."
    lower, upper, start = -np.ones(2), np.ones(2), np.ones(2) / 2
    def __call__(self, x): return float(x @ x) - 1.0
class Breaks(Bowl):
    def __call__(self, x):
        if x[0] < 0.4: raise RuntimeError("the <controller> & its link are lost")
        return float(x @ x)
class Never(Bowl):
    def __call__(self, x): raise ValueError("never a value")
"""


VOID = {"meta", "br", "img"}


class Tags(HTMLParser):
    """Collects what a page would fetch, where its links go, and whether its tags close."""

    def __init__(self):
        super().__init__()
        self.fetched, self.links, self.ids, self.open, self.unclosed = [], [], [], [], []

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.fetched += [given[key] for key in ("src", "xlink:href", "data") if key in given]
        self.ids += [given["id"]] if "id" in given else []
        if tag in ("a", "link") and "href" in given:
            self.links.append(given["href"])
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        before = list(self.open)
        self.handle_starttag(tag, attrs)
        self.open = before

    def handle_endtag(self, tag):
        if self.open and self.open[-1] == tag:
            self.open.pop()
        else:
            self.unclosed.append(tag)


def policy_of(page):
    return html.unescape(re.search(r'<meta http-equiv="Content-Security-Policy" content="([^"]*)">', page)[1])


def scripts_of(page):
    """Return the scripts of a page, each of which its policy names; and nothing else in it runs."""
    scripts = re.findall(r"<script>(.*?)</script>", page, flags=re.DOTALL)
    digests = [base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in scripts]
    assert re.findall("'sha256-([^']*)'", policy_of(page)) == digests
    assert len(re.findall("<script", page)) == len(scripts) + 1  # and the numbers, which do not run
    return scripts


def numbers_of(page):
    return json.loads(re.search(r'<script type="application/json" id=numbers>(.*?)</script>', page, re.DOTALL)[1])


def read(page):
    tags = Tags()
    tags.feed(page)
    return tags


@pytest.fixture(scope="module")
def paper(tmp_path_factory):
    store = ResultStore(tmp_path_factory.mktemp("results") / "mine")
    store.open()
    for problem, options in (("sensor_zero", {}), ("full12", {"gauge": "ya2", "error": "J3"})):
        for method in ("lm", "fmincon"):
            store.write(bench.execute(problems.make(problem, **options), optimizers.make(method), budget=120))
    written = write_report(store, ADDITIONS)
    assert written[-1] == store.folder / "report.html"
    return store, written[-1].read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    folder, path = tmp_path_factory.mktemp("own"), [*sys.path]
    (folder / "own_page.py").write_text(OWN)
    sys.path.insert(0, str(folder))
    words = "-m problem=own_page:Bowl,own_page:Breaks,own_page:Never optimizer=de,nlopt_LN_BOBYQA budget=60 seeds=2"
    with pytest.raises(SystemExit) as ended:
        main(["run", *words.split(), f"results={folder}", "study=bad"])
    assert ended.value.code == 1
    with empty_drawings():  # those of `paper` are looked at
        write_report(ResultStore(folder / "bad"), ADDITIONS)
    sys.path[:] = path
    return ResultStore(folder / "bad"), (folder / "bad" / "report.html").read_text(encoding="utf-8")


def test_a_page_fetches_nothing_and_its_links_arrive(paper, own):
    for _, page in (paper, own):
        tags = read(page)
        assert all(address.startswith(("#", "data:")) for address in tags.fetched)
        assert "connect-src" not in policy_of(page)  # what is not named falls back to default-src 'none'
        assert policy_of(page).startswith("default-src 'none'; script-src 'sha256-")
        assert scripts_of(page)
        assert not re.search(r"url\((?!#)", page)
        assert tags.links
        assert len(tags.ids) == len(set(tags.ids))
        assert {link[1:] for link in tags.links if link.startswith("#")} <= set(tags.ids)
        assert not tags.unclosed
        assert not set(tags.open) - {"li", "p"}


def test_each_problem_has_its_section_table_and_drawings(paper):
    store, page = paper
    for title, best in (("sensor_zero", "sensor_zero"), ("full12 gauge=ya2", "full12_gaugeya2")):
        section = page[page.index(f'<h2 id="problem-{best}">{title}</h2>') :].partition("<h2")[2].partition("<h2")[0]
        assert re.search(r"<div class=drawn data-problem=\"\d+\">", section)
        assert "fmincon" in section
        for name in (f"convergence_{best}", f"target_{best}"):
            assert f'aria-label="{name}"' in section
    assert 'aria-label="gauge"' in page
    assert 'aria-label="plans"' not in page  # there is one plan
    assert "Table 4 of Cong et al. 2008" in page
    assert "<s>247.1998</s> 247.3005" in page
    assert "No run failed." in page
    assert store.runs()["git_commit"].iloc[0][:10] in page
    assert len(page) < 3_000_000


def test_what_failed_stays_in_the_tables_and_is_explained_at_the_end(own):
    store, page = own
    runs = store.runs()
    failed = int((runs["status"] != "ok").sum())
    assert 0 < failed < len(runs)
    assert f"{failed} of {len(runs)} runs failed" in page
    assert "the &lt;controller&gt; &amp; its link are lost" in page
    assert "<controller>" not in page
    marks = re.findall(r"<td class=\"n\"><span class=\"v no\">✗ (\d+)</span></td>", page)
    assert sum(map(int, marks)) == failed  # in the table of problems, set as a mark
    assert "&lt;span" not in page
    reasons = page[page.index("<h2 id=failures>") :]
    assert "never a value" in reasons
    for method in set(runs["optimizer"]):
        assert page.count(f">{method}</span>") == 3  # a row in each problem's table
    assert page.index("<h2 id=failures>") > page.index("own_page:Never</h2>")


def test_the_table_of_problems_says_where_every_run_failed_and_of_which_error_function_a_row_is(own, paper):
    store, page = own
    lowest = store.runs().groupby("problem")["best_value"].min()
    assert sorted(lowest.index[lowest == float("inf")]) == ["own_page:Never"]
    assert page.count("none: every run failed") == 1
    heads = [re.findall(r"<th[^>]*>(.*?)</th>", text[text.index("<h2 id=contents>") :]) for text in (page, paper[1])]
    assert [any(head.startswith("error") for head in found[:3]) for found in heads] == [False, True]


def test_the_page_tells_the_command_that_made_its_runs(own):
    store, page = own
    (command,) = store.manifest()["commands"]
    assert command.startswith("bench run -m problem=own_page:Bowl,")
    assert command in page
    assert f"bench report {store.folder}" in page


def test_what_is_planned_and_not_done_is_said(paper):
    store, page = paper
    assert "not done yet" not in page
    manifest = {"planned": {"none": "a run", "of": "these"}}
    assert (
        "<b>2</b><span>planned, not done yet"
        in StudyPage(folder=store.folder, runs=store.runs(), manifest=manifest).html()
    )


def test_methods_are_ranked_by_success_then_cost_and_the_failed_come_last(paper, own):
    for store, _ in (paper, own):
        runs = store.runs()
        names = summary.method_names(runs)
        for _, problem in runs.groupby(["problem", "problem_options"]):
            for _, mine in by_error(problem):
                cells = ranked(mine, names)
                assert cells["success"].fillna(0.0).is_monotonic_decreasing
                assert cells.loc[cells["success"] > 0, "charged_to_target"].is_monotonic_increasing
                assert cells["runs"].sum() == len(mine)


def test_numbers_are_short_and_counts_are_apart():
    assert (number(1.234e-9), count(1234567.0), count(float("inf"))) == ("1.2e-09", "1\u202f234\u202f567", "–")


def test_drawings_lose_digits_that_no_eye_sees_and_no_word_of_theirs(tmp_path):
    svg = '<svg x="1"><path id="a" d="M 1.23456 2"/><text x="9.87654">scale 0.999593</text></svg>'
    (tmp_path / "drawing.svg").write_text(svg)
    element = drawing_inside(tmp_path / "drawing.svg", "n").svg
    assert element == 'x="1"><path id="n-a" d="M 1.23 2"/><text x="9.87">scale 0.999593</text></svg>'
