"""Names that look like HTML are text on every kind of page, wherever they come from."""

import json
import re
from dataclasses import fields
from html.parser import HTMLParser

import pandas as pd
import pytest
from jinja2 import UndefinedError

from calibench import bench, optimizers, problems
from calibench.bench.discovery.page.page import Page
from calibench.bench.papers import page as ledger_page
from calibench.bench.papers.ledger import Row
from calibench.bench.report.shared.drawing import axes_in, figure_of, save
from calibench.bench.report.shared.page import Head, Table, inline_svg, macros, render
from calibench.bench.report.study.explored import scripts
from calibench.bench.report.study.page import StudyPage
from calibench.bench.store.runs import ResultStore
from calibench.core.notes import Code, Note
from calibench.discrepancy.report import Report

EVIL = """<script>alert("1")</script> & 'co' </td></style><b onclick=x>"""


class Read(HTMLParser):
    """Collects elements, attributes' values and text of a page."""

    def __init__(self, html):
        super().__init__()
        self.tags, self.values, self.text = set(), [], ""
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        self.tags |= {tag, *(name for name, _ in attrs if name.startswith("on"))}
        self.values += [value or "" for _, value in attrs]

    def handle_data(self, data):
        self.text += data


def sound(html):
    """Return a page that has been read, in which no name has become an element or an attribute."""
    for script in scripts():
        html = html.replace(f"<script>{script}</script>", "", 1)
    html = re.sub(r'<script type="application/json" id=numbers>[^<>&]*</script>', "", html, count=1)
    page = Read(html)
    assert not {"script", "onclick"} & page.tags
    assert html.count("</style>") == 1
    assert "&amp;amp;" not in html  # nothing is escaped twice
    assert "&amp;lt;" not in html
    return page


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    store = ResultStore(tmp_path_factory.mktemp("results") / "mine")
    store.open()
    for method in ("lm", "trf"):
        store.write(bench.execute(problems.make("sensor_zero"), optimizers.make(method), budget=30))
    return store.runs()


def test_a_studys_page_trusts_no_name(runs, tmp_path):
    evil = runs.assign(problem=EVIL, start=EVIL, git_commit=EVIL, platform=EVIL, problem_options="{}")
    evil.loc[evil["optimizer"] == "trf", ["optimizer", "optimizer_options"]] = [EVIL, json.dumps({EVIL: EVIL})]
    evil.loc[evil["optimizer"] == "lm", ["status", "error_type", "error"]] = ["failed", EVIL, EVIL]
    evil["versions"] = json.dumps({EVIL: EVIL})
    drawing = tmp_path / "overview.svg"
    drawing.write_text('<svg width="9pt"><g id="a"/></svg>')
    manifest = {"commands": [f"bench run problem={EVIL}"], "planned": {EVIL: EVIL}}
    html = StudyPage(
        folder=tmp_path / EVIL.replace("/", "∕"), runs=evil, manifest=manifest, about=EVIL,
        drawings=lambda: {"overview": [drawing]},
        beside={EVIL: f"{EVIL}.html"},
    ).html()  # fmt: skip
    page = sound(html)
    assert page.text.count(EVIL) >= 12
    numbers = json.loads(re.search(r"id=numbers>([^<]*)<", html)[1])
    assert EVIL in {word for method in numbers["methods"] for word in method.values()}  # whole, and only data
    assert f"{EVIL}={EVIL}" in page.values  # the options of an optimiser, as a hint
    assert f"{EVIL}.html" in page.values  # a link


def test_a_discoverys_page_trusts_no_name():
    rival = {"effect": EVIL, "family": EVIL, "target": EVIL, "weight": 1.0}
    finding = {"effect": EVIL, "family": EVIL, "target": EVIL, "gain": 7.0, "set": [rival], "separated_by": EVIL,
               "amplitude": {"value": 1.0, "unit": EVIL, "ci95": [0.5, 1.5]}}  # fmt: skip
    report = Report.from_dict(
        {"case": EVIL, "machine": "gpm2002", "verdict": "named", "findings": [finding], "gap": {}, "seconds": 1.0,
         "where": [{"target": EVIL, "covariate": EVIL, "p": 1e-9}],
         "not_testable": [{"family": EVIL, "target": EVIL, "reason": EVIL, "columns": [EVIL], "missing": True}],
         "invisible": [{"effect": EVIL, "family": EVIL, "target": EVIL, "visible_fraction": 0.0}],
         "parameters": {EVIL: {"before": 1.0, "after": 9.0, "sd": 1.0}}}
    )  # fmt: skip
    html = Page(
        report, notes=[Note(Code.FILE, EVIL)], units={EVIL: EVIL}, causes={EVIL: (EVIL, EVIL)},
        provenance={EVIL: EVIL}, noise=EVIL,
        about_data={EVIL: EVIL}, drawings={"gap": '<svg width="9pt"/>', EVIL: '<svg width="9pt"/>'},
    ).html()  # fmt: skip
    assert sound(html).text.count(EVIL) >= 20


def test_the_ledgers_page_trusts_no_word():
    row = Row(**{f.name: EVIL if f.type == "str" else 1.0 for f in fields(Row)} | {
        "paper": "cong2008", "key": "table2.a", "kind": "claim", "verdict": "not reproduced", "rule": "near", "n": 3,
    })  # fmt: skip
    page = sound(ledger_page.page([row], EVIL))
    assert page.text.count(EVIL) >= 9


def test_a_table_and_a_drawing_trust_no_name():
    parts = macros("report/shared/templates/parts.html.j2")
    table = Table([Head(EVIL, EVIL), Head(EVIL)], [[EVIL], [EVIL, parts.told(EVIL)]], blocks=True)
    drawn = parts.figure(inline_svg('<svg width="9pt"><g id="a"/></svg>', EVIL), EVIL)
    page = Read(f"{parts.table(table)}{drawn}")
    assert not {"script", "onclick", "style"} & page.tags
    assert page.text.count(EVIL) == 6
    assert page.values.count(EVIL) == 5  # classes, heads of the cells, the drawing's label


def test_a_name_with_dollars_is_no_formula_in_a_drawing(tmp_path):
    name = r"$\frac{$ and $x^{$"
    with axes_in(None, 4, 3) as axes:
        axes.plot([1, 2], [1, 2], label=name)
        axes.set_title(name)
        axes.legend()
    svg, _, _ = save("drawn", (figure_of(axes), pd.DataFrame()), tmp_path)
    assert svg.read_text().count(f">{name}<") == 2


def test_a_value_that_a_template_misses_is_an_error():
    with pytest.raises(UndefinedError):
        render("report/study/templates/study.html.j2", title="mine")
