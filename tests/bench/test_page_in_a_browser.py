"""The page of a study in a real browser: all that can be clicked is clicked, nothing is fetched, nothing complains.

Needs playwright (the extra ``browser``) and Chromium as the system has it; nothing is downloaded.
"""

import json
import re
import shutil
from importlib.resources import files

import numpy as np
import pytest
from markupsafe import Markup

from calibench import bench, optimizers, problems
from calibench.bench.report.shared.page import macros
from calibench.bench.report.study.write import write_report
from calibench.bench.statistics.fixed_target import ert
from calibench.bench.statistics.targets import levels_of
from calibench.bench.store.runs import ResultStore

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not here: pip install calibench[browser]")
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
if CHROMIUM is None:
    pytest.skip("no Chromium is on the PATH: apt-get install chromium", allow_module_level=True)

METHODS = ("lm", "de", "nlopt_LN_BOBYQA")


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    store = ResultStore(tmp_path_factory.mktemp("results") / "mine")
    store.open()
    for problem, options in (("sensor_zero", {}), ("link_length", {"error": "J2"}), ("link_length", {"error": "J3"})):
        for method in METHODS:
            for seed in range(1 if method == "lm" else 3):
                store.write(
                    bench.execute(problems.make(problem, **options), optimizers.make(method), budget=300, seed=seed)
                )
    write_report(store)
    return store


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as driver:
        found = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield found
        found.close()


class Opened:
    """A page, what it said on the console, and what it asked the network for."""

    def __init__(self, browser, store, width=1300, **options):
        self.context = browser.new_context(viewport={"width": width, "height": 900}, **options)
        self.page, self.scripts = self.context.new_page(), options.get("java_script_enabled", True)
        self.said, self.asked = [], []
        self.page.on("console", lambda message: self.said.append(message.text))
        self.page.on("pageerror", lambda error: self.said.append(str(error)))
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.address = (store.folder / "report.html").as_uri()
        self.page.goto(self.address)

    def settle(self):
        """Wait until what was changed is drawn."""
        if self.scripts:
            self.page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def open_all(self):
        for summary in self.page.locator("summary").all():
            if summary.is_visible() and not summary.evaluate("summary => summary.parentElement.open"):
                summary.click()
        self.settle()

    def table(self):
        """Return the table of costs of all problems: (problem, method) -> text."""
        return self.page.evaluate(
            """() => {
              const table = document.querySelector("table.costs");
              const heads = [...table.querySelectorAll("thead th")].map(th => th.textContent.trim());
              return [...table.tBodies[0].rows].flatMap(row => [...row.cells].slice(1).map(
                (td, i) => [row.cells[0].firstChild.textContent.trim(), heads[i + 1], td.firstChild.textContent]));
            }"""
        )


@pytest.fixture
def opened(browser, store):
    found = []

    def open_it(**options):
        found.append(Opened(browser, store, **options))
        return found[-1]

    yield open_it
    for one in found:
        assert one.said == []
        assert one.asked == [one.address]
        one.context.close()


def test_a_table_that_is_cut_at_the_edge_has_a_shade_there(opened):
    """On a usual screen the table of problems is whole; on a narrow one its edge tells that it goes on."""
    table = "document.querySelector('#contents + .scroll')"
    hidden = f"{table}.scrollWidth - {table}.clientWidth"
    assert opened().page.evaluate(hidden) == 0
    narrow = opened(width=400).page
    assert narrow.evaluate(hidden) > 0
    assert narrow.evaluate(f"getComputedStyle({table}).backgroundImage").count("linear-gradient") == 4


def test_the_goal_is_said_with_its_value_and_its_line_fits_a_phone(opened):
    one = opened(width=400)
    one.open_all()
    captions = one.page.locator("details.problem caption").all_text_contents()
    assert captions == [f"To the goal {error} ≤ 1e-18 mm⁴, the rounding floor" for error in ("J2", "J2", "J3")]
    ends = "[...document.querySelectorAll('tr.part span')].map(span => span.getBoundingClientRect().right)"
    assert max(one.page.evaluate(ends)) < 400
    success = "document.querySelector('#suite .scroll')"
    assert one.page.evaluate(f"{success}.scrollWidth - {success}.clientWidth") == 0


class Noisy:
    """A bowl under noise, without a goal."""

    stochastic = True
    lower, upper, start = np.full(2, -1.0), np.full(2, 1.0), np.full(2, 0.5)

    def __call__(self, x):
        return float(x @ x) + 0.1 * self.rng.standard_normal()


def test_a_noisy_problem_says_where_its_hits_stand_and_one_without_a_goal_that_it_has_none(browser, tmp_path):
    store = ResultStore(tmp_path / "noisy")
    store.open()
    for problem in (Noisy(), problems.make("sensor_zero")):
        for seed in range(3):
            store.write(bench.execute(problem, optimizers.make("de"), budget=60, seed=seed))
    write_report(store)
    one = Opened(browser, store)
    one.open_all()
    captions = one.page.locator("figcaption").all_text_contents()
    assert sum("a hit stands where the answer was proposed" in caption for caption in captions) == 2
    assert "Where values are noisy, a hit stands" in one.page.locator("#suite > .why").text_content()
    assert one.page.get_by_text("This problem has no such target").count() == 1


def test_an_interval_that_begins_at_one_evaluation_has_no_lower_end(browser, store, tmp_path):
    page = (store.folder / "report.html").read_text(encoding="utf-8")
    before, begin, rest = page.partition('<script type="application/json" id=numbers>')
    text, end, after = rest.partition("</script>")
    numbers = json.loads(text)
    goal = numbers["quantities"][0]
    for cell, kept in enumerate(goal["reached"]):
        if kept:
            goal["reached"][cell], goal["ert"][cell], goal["low"][cell], goal["high"][cell] = [2], [9], [1], [99]
    other = ResultStore(tmp_path)
    (tmp_path / "report.html").write_text(before + begin + json.dumps(numbers) + end + after, encoding="utf-8")
    assert "9 [at most 99]" in Opened(browser, other).page.locator("table.costs").text_content()


@pytest.mark.parametrize("sheet", ["papers", "calibration", "discovery/page", "report/study", "history"])
def test_a_wide_drawing_scrolls_by_itself_on_a_phone(browser, sheet):
    context = browser.new_context(viewport={"width": 400, "height": 900})
    page = context.new_page()
    folder = files("calibench.bench")
    sheets = [folder / "report/shared/templates/page.css", *(folder / sheet / "templates").glob("*.css")]
    style = "".join(one.read_text(encoding="utf-8") for one in sheets)
    drawing = Markup("<svg width=950pt height=90pt></svg>")
    content = f"<style>{style}</style><figure class=broad>{drawing}</figure>"
    if sheet == "history":
        content = macros("tracking/templates/history.html.j2").page([("t", "s", drawing)])
    page.set_content(content)
    assert page.evaluate("document.documentElement.scrollWidth") <= 400
    assert page.evaluate("document.querySelector('svg').getBoundingClientRect().width") > 500
    context.close()


def test_all_that_can_be_clicked_is_clicked_and_nothing_complains(opened):
    one = opened()
    page = one.page
    one.open_all()
    clicked = 0
    for selector in ("input[type=checkbox]", "input[type=radio]", "button:not(.sort)"):
        for control in page.locator(f"#controls {selector}").all():
            for _ in range(3 if "button" in selector else 2):
                control.click()
                one.settle()
                clicked += 1
    for button in page.locator("#controls button", has_text="all").all():
        button.click()
    for select in page.locator("select").all():
        for value in select.locator("option").evaluate_all("found => found.map(option => option.value)"):
            select.select_option(value)
            one.settle()
            slider = page.locator("input[type=range]")
            if slider.is_visible():
                for key in ("Home", "ArrowRight", "ArrowRight", "End"):
                    slider.press(key)
                    one.settle()
        select.select_option(index=0)
    one.settle()
    sorts = page.locator("th .sort:visible")
    count = sorts.count()
    for i in range(count):
        for _ in range(3):
            sorts.nth(i).click()
    for frame in page.locator(".frame:visible").all():
        frame.hover()
    assert clicked > 25
    assert count > 20


def test_a_method_and_a_problem_that_are_switched_off_are_gone(opened):
    one = opened()
    page = one.page
    assert {method for _, method, _ in one.table()} == set(METHODS)
    page.get_by_role("checkbox", name="de", exact=True).uncheck()
    page.get_by_role("checkbox", name="sensor_zero").uncheck()
    one.settle()
    assert {method for _, method, _ in one.table()} == set(METHODS) - {"de"}
    assert {problem for problem, _, _ in one.table()} == {"link_length J2", "link_length J3"}
    assert not page.locator("details.problem", has=page.locator("#problem-sensor_zero")).is_visible()
    one.open_all()
    rows = page.locator("details.problem[open] > .scroll tbody tr:not(.part)")
    assert {row.locator("td").first.inner_text() for row in rows.all() if row.is_visible()} == set(METHODS) - {"de"}


def test_the_slider_tells_the_expected_running_time_of_the_statistics(opened, store):
    one = opened()
    runs = store.runs()
    table = ert(store.hits(levels_of(runs)), runs)
    table = table[(table["quantity"] == "gap") & (table["problem"] == "sensor_zero")]
    targets = sorted(table["target"].unique(), reverse=True)
    one.page.get_by_label("What the targets are in").select_option(label="distance to the best value")
    slider = one.page.locator("input[type=range]")
    seen = set()
    for i in range(0, len(targets), 5):
        slider.evaluate("(slider, i) => { slider.value = i; slider.dispatchEvent(new Event('input')); }", i)
        one.settle()
        told = {method: text for problem, method, text in one.table() if problem == "sensor_zero J2"}
        for row in table[table["target"] == targets[i]].itertuples():
            said = told[row.optimizer].replace("\u202f", "")
            bound = said.startswith("> ")
            value = float(said.removeprefix("> "))
            assert bound == (row.reached == 0)
            assert value == pytest.approx(row.at_least if bound else row.ert, rel=6e-3)
            seen.add(bound)
    assert seen == {True, False}


def test_a_click_on_a_head_sorts_and_the_third_brings_the_first_order_back(opened):
    one = opened()
    heads = one.page.locator("table.costs thead th")
    first = [problem for problem, _, _ in one.table()]
    one.page.locator("table.costs .sort").first.click()
    assert heads.first.get_attribute("aria-sort") == "ascending"
    rising = [problem for problem, _, _ in one.table()]
    one.page.locator("table.costs .sort").first.press("Enter")
    falling = [problem for problem, _, _ in one.table()]
    one.page.locator("table.costs .sort").first.press("Enter")
    assert rising == sorted(first)
    assert falling == rising[::-1]
    assert [problem for problem, _, _ in one.table()] == first
    assert heads.first.get_attribute("aria-sort") is None


def test_all_controls_are_reached_by_the_keyboard_and_seen_there(opened):
    one = opened()
    wanted = one.page.evaluate(
        """() => {
          const all = [...document.querySelectorAll("button, select, input, summary, .frame, a")];
          const seen = all.filter(one => one.checkVisibility() && !(one.type === "radio" && !one.checked));
          seen.forEach((one, i) => one.dataset.reach = i);
          return seen.length;
        }"""
    )
    reached = set()
    for _ in range(wanted + 5):
        one.page.keyboard.press("Tab")
        at, outline = one.page.evaluate(
            "() => [document.activeElement.dataset.reach, getComputedStyle(document.activeElement).outlineStyle]"
        )
        if at is not None:
            reached.add(at)
            assert outline != "none"
    assert len(reached) == wanted
    names = one.page.evaluate(
        """() => [...document.querySelectorAll("button, select, input")]
          .filter(one => one.checkVisibility())
          .map(one => [one.getAttribute("aria-label"), one.textContent, one.closest("label")?.textContent])
          .map(words => words.join("").trim())"""
    )
    assert all(names)


def test_a_chart_is_read_by_arrow_keys(opened):
    one = opened()
    frame = one.page.locator(".frame").first
    frame.focus()
    for _ in range(4):
        frame.press("ArrowRight")
    told = frame.locator(".tip")
    assert told.is_visible()
    first = told.inner_text()
    assert re.search(r"de: \d+ %|de: <1 %", first)
    frame.press("End")
    assert told.inner_text() != first
    frame.press("Escape")
    assert not told.is_visible()


@pytest.mark.parametrize("width", [400, 800, 1300])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_page_fits_its_window_in_light_and_dark(opened, width, scheme):
    one = opened(width=width, color_scheme=scheme)
    page = one.page
    one.open_all()
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    light = page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    assert light == (scheme == "light")
    drawn = page.locator("details.problem[open] .plot canvas")
    assert drawn.count() >= 6
    assert page.evaluate(
        "[...document.querySelectorAll('canvas')].every(one => one.getBoundingClientRect().width > 200)"
    )


def test_without_scripts_tables_and_drawings_stand_there(opened):
    one = opened(java_script_enabled=False)
    page = one.page
    assert not page.locator("#controls").is_visible()
    assert page.locator("section.answer").is_visible()
    one.open_all()
    assert page.locator("details.problem").first.locator(".scroll table").is_visible()
    assert page.locator("svg[aria-label=convergence_sensor_zero]").is_visible()
    assert page.locator("svg[aria-label=ecdf]").is_visible()


def test_print_has_no_controls_and_dark_ink(opened):
    one = opened(color_scheme="dark")
    one.page.emulate_media(media="print", color_scheme="dark")
    assert not one.page.locator("#controls").is_visible()
    assert one.page.evaluate("getComputedStyle(document.body).color") == "rgb(26, 26, 26)"
    assert len(one.page.pdf()) > 10_000


class Cliff:
    """A problem whose values fall from 1e299 to 1e-9, one a call."""

    lower, upper, start = [-1.0, -1.0], [1.0, 1.0], [0.0, 0.0]

    def __init__(self):
        self.left = [1e299, 1e150, 1e20, 1.0, 1e-9]
        self.options = {}

    def __call__(self, x):
        return self.left.pop(0) if len(self.left) > 1 else self.left[0]


def test_a_value_axis_up_to_1e299_has_labels(browser, tmp_path):
    wide = ResultStore(tmp_path / "wide")
    wide.open()
    wide.write(bench.execute(Cliff(), optimizers.make("nlopt_LN_COBYLA"), budget=12))
    write_report(wide)
    context = browser.new_context()
    page = context.new_page()
    page.add_init_script(
        "window.written = []; const write = CanvasRenderingContext2D.prototype.fillText;"
        "CanvasRenderingContext2D.prototype.fillText = function (text, ...more) {"
        " window.written.push(text); return write.call(this, text, ...more); };"
    )
    page.goto((wide.folder / "report.html").as_uri())
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    written = page.evaluate("window.written")
    context.close()
    assert sum(re.fullmatch("10[⁰¹²³⁴⁵⁶⁷⁸⁹]{2,3}", text) is not None for text in written) >= 4


class Bowl:
    """A problem with the name that it is given."""

    lower, upper, start = np.full(2, -1.0), np.full(2, 1.0), np.full(2, 0.5)

    def __init__(self, name: str):
        self.name = name

    def __call__(self, x):
        return float(x @ x)


@pytest.mark.parametrize("width", [400, 1300])
def test_a_name_without_a_space_is_broken_before_it_pushes_a_number_out_of_sight(browser, tmp_path, width):
    store = ResultStore(tmp_path / "long")
    store.open()
    for name in ("short", "some words " * 9, "x" * 150):
        for method in ("de", "nlopt_LN_BOBYQA"):
            store.write(bench.execute(Bowl(name), optimizers.make(method), budget=50))
    write_report(store)
    page = Opened(browser, store, width).page
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    if width < 1000:
        return  # there the table scrolls
    tables = "document.querySelectorAll('table.costs,#contents + .scroll table')"
    wide = f"[...{tables}].map(t => t.scrollWidth - t.parentElement.clientWidth)"
    assert max(page.evaluate(wide)) <= 0


@pytest.mark.parametrize("width", [400, 1300])
def test_no_name_of_a_method_is_broken_within_a_word_and_no_column_is_half_empty(browser, tmp_path, width):
    store = ResultStore(tmp_path / "names")
    store.open()
    for problem in ("first", "second"):
        for method in ("de", "nlopt_GN_DIRECT_L_RAND_NOSCAL", "nlopt_LD_TNEWTON_PRECOND_RESTART"):
            store.write(bench.execute(Bowl(problem), optimizers.make(method), budget=50))
    write_report(store)
    page = Opened(browser, store, width).page
    parts = "[...document.querySelectorAll('.whole')].filter(e => e.offsetWidth).map(e => e.getClientRects().length)"
    assert set(page.evaluate(parts)) == {1}
    assert page.evaluate("document.querySelectorAll('table.methods wbr').length") > 0
    squeezed = "[...document.querySelectorAll('.list .mark')].filter(e => e.scrollWidth > e.clientWidth).length"
    assert page.evaluate(squeezed) == 0  # a line sample would lie on the name
    left_over = """[...document.querySelectorAll('.charts')].filter(e => e.offsetWidth).map(e =>
        e.getBoundingClientRect().right - e.lastElementChild.getBoundingClientRect().right)"""
    assert max(map(abs, page.evaluate(left_over))) < 1
