"""`bench ui`: who is let in, what an address can reach, what is written, and how a sweep is told while it runs."""

import http.client
import json
import os
import platform
import shutil
import socket
import threading
import time
from contextlib import closing, contextmanager
from urllib.parse import urlencode

import pytest

from calibench import bench, optimizers, problems
from calibench.bench.cli import main
from calibench.bench.store.manifest import read_notes
from calibench.bench.store.runs import ResultStore
from calibench.bench.tracking import catalogue as of
from calibench.bench.tracking.catalogue import catalogue
from tests.bench.conftest import empty_drawings
from tests.bench.tracked import run_of, study, version

uvicorn = pytest.importorskip("uvicorn", reason="uvicorn is not here: pip install calibench[ui]")
server = pytest.importorskip("calibench.bench.ui.server")
live = pytest.importorskip("calibench.bench.ui.server")

HOSTILE = '<img src=x onerror=alert(1)>"&'
TOKEN = "the-token"
GONE = 2**22 + 1  # no process has this number


class Client:
    """A browser without scripts: its answers, and the cookie that it was given."""

    def __init__(self, port):
        self.port, self.cookie = port, None

    def ask(self, path, method="GET", body=None, **headers):
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=20)
        given = {"cookie": self.cookie} if self.cookie else {}
        form = {"content-type": "application/x-www-form-urlencoded"} if body else {}
        with closing(connection):
            connection.request(method, path, urlencode(body) if body else None, {**given, **form, **headers})
            answer = connection.getresponse()
            answer.text = answer.read().decode()
        return answer

    def enter(self):
        answer = self.ask(f"/?token={TOKEN}")
        self.cookie = answer.headers["set-cookie"].split(";")[0]
        return answer


@contextmanager
def serving(results, write=False):
    listening = socket.socket()
    listening.bind(("127.0.0.1", 0))
    listening.listen()
    port = listening.getsockname()[1]
    app = server.application(results, port, TOKEN, write=write)
    config = uvicorn.Config(
        app, loop="asyncio", http="h11", ws="none", lifespan="off", interface="asgi3", log_config=None,
        timeout_graceful_shutdown=0,
    )  # fmt: skip
    running = uvicorn.Server(config)
    thread = threading.Thread(target=running.run, args=([listening],))
    thread.start()
    try:
        yield Client(port)
    finally:
        running.should_exit = True
        thread.join()
        listening.close()


@pytest.fixture(autouse=True)
def settled(own_cache, monkeypatch):
    monkeypatch.setattr(of, "_FRESH", -5.0)


@pytest.fixture
def results(tmp_path):
    folder = tmp_path / "results"
    study(folder / "one", day=1)
    study(folder / "deeper" / "two", "link_length", "de", day=8)
    return folder


@pytest.fixture
def client(results):
    with serving(results) as found:
        found.enter()
        yield found


def ids(results):
    return {entry.study: server.id_of(entry) for entry in catalogue(results)}


def test_each_set_of_a_discovery_has_its_page(results, at_one_noise):
    with pytest.raises(SystemExit), empty_drawings():
        main(["discover", "machine=gpm2002", "data=demo_backlash", f"results={results}", "study=searched"])
    [entry] = catalogue(results, ["kind=discovery"])
    assert entry.command.startswith("bench discover machine=gpm2002 data=demo_backlash")
    with serving(results) as client:
        client.enter()
        place = f"/study/{ids(results)['searched']}"
        assert "The report of demo_backlash." in client.ask(place).text
        assert "Missing from the model" in client.ask(f"{place}/page/0").text


def test_only_who_has_the_token_is_let_in(results):
    with serving(results) as client:
        assert client.ask("/").status == 403
        assert client.ask("/?token=another").status == 403
        assert client.ask("/static/app.js").status == 403
        answer = client.enter()
        assert answer.status == 303
        assert answer.headers["location"] == "/"
        assert {"HttpOnly", "SameSite=strict"} <= {*answer.headers["set-cookie"].split("; ")}
        assert TOKEN not in answer.headers["set-cookie"]
        assert client.ask("/").status == 200
        assert Client(client.port).ask("/", cookie=client.cookie + "x").status == 403


def test_another_host_name_that_leads_here_is_refused(client):
    for host in ("evil.example", f"evil.example:{client.port}", "127.0.0.1", f"127.0.0.1.evil.example:{client.port}"):
        assert client.ask("/", host=host).status == 421
        assert client.ask(f"/?token={TOKEN}", host=host).status == 421
    assert client.ask("/", host=f"localhost:{client.port}").status == 200


def test_every_answer_lets_a_page_load_nothing_but_ours(client, results):
    for path in ("/", "/nothing", "/static/app.js", f"/study/{ids(results)['one']}?page"):
        answer = client.ask(path)
        assert answer.headers["content-security-policy"].startswith("default-src 'none'; script-src 'self';")
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert "http://" not in answer.text.replace("http://www.w3.org/2000/svg", "")
        assert "https://" not in answer.text


def test_no_address_leaves_the_results_folder(client, results):
    (results.parent / "secret.html").write_text("secret")
    one = ids(results)["one"]
    for name in ("..", "..%2f..", "%2e%2e/secret.html", "one", "deeper%2Ftwo", "/etc/passwd"):
        for path in (f"/study/{name}", f"/study/{name}/page/0", f"/study/{name}/events", f"/study/{one}/page/{name}",
                     f"/study/{one}/run/{name}", f"/static/{name}", f"/compare?a={name}&b={name}"):  # fmt: skip
            answer = client.ask(path)
            assert answer.status == 404, path
            assert "secret" not in answer.text


def test_a_link_that_takes_the_place_of_a_study_is_not_followed(client, results, tmp_path):
    one = ids(results)["one"]
    assert client.ask(f"/study/{one}?page").status == 200
    (results / "one").rename(tmp_path / "elsewhere")
    (results / "one").symlink_to(tmp_path / "elsewhere")
    assert client.ask(f"/study/{one}?page").status == 404
    assert client.ask(f"/study/{one}/page/0").status == 404


def test_names_are_text_on_every_screen(results):
    study(results / HOSTILE, day=2)
    (results / HOSTILE / "<b>.html").write_text("x")
    with serving(results, write=True) as client:
        client.enter()
        one = f"/study/{ids(results)[HOSTILE]}"
        run = ResultStore(results / HOSTILE).runs()["run_id"].iloc[0]
        assert client.ask("/").text.count("&lt;img src=x") >= 2
        asked = urlencode({"q": "<script>", "problem": "<script>", "optimizer": "<script>"})
        for path in ("/", f"{one}?page", f"{one}/runs", f"{one}/live", f"{one}/run/{run}", f"/?{asked}",
                     f"/history?{asked}", f"{one}/runs?{asked}"):  # fmt: skip
            text = client.ask(path).text
            assert "<img" not in text
            assert "<b>.html" not in text
            assert "<script>" not in text


def test_the_catalogue_is_searched_in_the_words_of_its_columns(client):
    def found(query):
        text = client.ask(f"/?{urlencode({'q': query, 'part': ''})}").text
        return [name for name in ("one", "deeper/two") if f">{name}</a>" in text], text

    assert found("")[0] == ["one", "deeper/two"]
    assert found("optimizer=de")[0] == ["deeper/two"]
    assert found("TWO link")[0] == ["deeper/two"]
    assert found("optimizr=de")[0] == []
    assert "there is no column" in found("optimizr=de")[1]


def test_many_studies_are_shown_a_page_at_a_time(client, results, monkeypatch):
    monkeypatch.setattr(server, "_ROWS", 1)
    assert '/?q=kind%3Druns&amp;from=1"' in client.ask("/?q=kind%3Druns").text
    text = client.ask("/?q=kind%3Druns&from=1").text
    assert (">one</a>" in text, ">deeper/two</a>" in text, "2 studies, 2 to 2" in text) == (True, False, True)


def test_a_run_has_its_story_and_runs_are_searched(client, results):
    one = f"/study/{ids(results)['deeper/two']}"
    run_id = run_of("link_length", "de").row["run_id"]
    assert f"/run/{run_id}" in client.ask(f"{one}/runs?q=optimizer=d*").text
    assert f"/run/{run_id}" not in client.ask(f"{one}/runs?q=optimizer!=d*").text
    assert client.ask(f"{one}/runs?q=colour=red").status == 422
    story = client.ask(f"{one}/run/{run_id}").text
    assert "bench run problem=link_length" in story
    assert client.ask(f"{one}/run/{'0' * 16}").status == 404


def test_the_report_is_framed_and_runs_no_script_but_ours(client, results):
    (results / "one" / "report.html").write_text("<script>alert(1)</script>somebody's")
    answer = client.ask(f"/study/{ids(results)['one']}/page/0")
    policy = answer.headers["content-security-policy"]
    assert "sandbox allow-scripts" in policy
    assert "allow-same-origin" not in policy
    assert "script-src 'sha256-" in policy
    assert "Study one" in answer.text  # made anew: what lies there is not of this version
    assert not (results / "one" / "hits.parquet").exists()
    assert (results / "one" / "report.html").read_text().endswith("somebody's")


def test_two_studies_stand_side_by_side_and_a_history_is_drawn(tmp_path):
    results = tmp_path / "results"
    for day, (code, size) in enumerate((("a" * 8, 1.0), ("b" * 8, 90.0))):
        version(results / f"v{day}", code, [size * (1 + k / 10) for k in range(8)], day)
    with serving(results) as client:
        client.enter()
        known = ids(results)
        text = client.ask(f"/compare?a={known['v0']}&b={known['v1']}&by=value").text
        assert "B is worse in 1" in " ".join(text.split())
        for path in (
            "/history?problem=sensor_*,full12&optimizer=de&by=value",
            f"/study/{known['v0']}/history?by=value",
        ):
            text = client.ask(path).text
            assert "It became worse with bbbbbbbb" in text
            assert text.count("<circle") == 2


def test_nothing_is_written_without_write(client, results):
    one = f"/study/{ids(results)['one']}/note"
    assert client.ask(one, "POST", {"text": "x"}).status == 403
    assert client.ask(one, "DELETE").status == 405
    assert not (results / "one" / "notes.json").exists()
    assert "<textarea" not in client.ask(one.removesuffix("/note") + "?page").text


def test_notes_are_written_with_the_token_of_the_page_alone(results):
    with serving(results, write=True) as client:
        client.enter()
        one = f"/study/{ids(results)['one']}"
        page = client.ask(f"{one}?page").text
        token = page.partition('name="token" value="')[2].partition('"')[0]
        assert client.ask(f"{one}/note", "POST", {"text": "x"}).status == 403
        assert client.ask(f"{one}/note", "POST", {"text": "x", "token": TOKEN}).status == 403
        sent = {"text": "best so far", "tags": "paper", "token": token}
        assert client.ask(f"{one}/note", "POST", sent, origin="http://evil.example").status == 403
        assert read_notes(results / "one").notes == ()
        assert client.ask(f"{one}/note", "POST", sent, origin=f"http://127.0.0.1:{client.port}").status == 303
        assert [note.text for note in read_notes(results / "one").notes] == ["best so far"]
        assert read_notes(results / "one").tags == ("paper",)
        assert client.ask(f"{one}/note", "POST", {"tags": "a b c d e <f", "token": token}).status == 422
        assert client.ask(f"{one}/note", "POST", {"text": "x" * 200_000, "token": token}).status == 413


# -- a sweep that runs

RUNS = [
    bench.execute(problems.make("sensor_zero"), optimizers.make(method), budget=80, seed=seed)
    for method in ("de", "pso") for seed in range(2)
]  # fmt: skip


@pytest.fixture
def sweep(tmp_path):
    """Return the store of a sweep of which no run is done, and who carries it."""
    store = ResultStore(tmp_path / "results" / "sweep")
    store.open()
    labels = {run.row["run_id"]: f"sensor_zero x {run.row['optimizer']}" for run in RUNS}
    store.plan(labels, "bench run again", budgets=dict.fromkeys(labels.values(), 80))
    carried_by(store, os.getpid(), live_one=True)
    return store


def carried_by(store, pid, live_one=False):
    from calibench.bench.gate.processes import born

    home = store.folder / "running"
    shutil.rmtree(home, ignore_errors=True)
    home.mkdir()
    owner = {"host": platform.node(), "pid": pid, "born": born(pid) if live_one else "0"}
    (home / f"{pid}@{platform.node()}.sweep").write_text(json.dumps(owner))


def events_of(client, path):
    """Yield what is told, as it is told."""
    connection = http.client.HTTPConnection("127.0.0.1", client.port, timeout=20)
    connection.request("GET", path, headers={"cookie": client.cookie})
    answer = connection.getresponse()
    assert answer.headers["content-type"].startswith("text/event-stream")
    until = time.monotonic() + 15
    try:
        while time.monotonic() < until and (line := answer.readline()):
            if line.startswith(b"data: "):
                yield json.loads(line[6:])
    finally:
        connection.close()


def test_events_arrive_as_a_journal_grows_and_a_kill_shows(sweep, monkeypatch):
    monkeypatch.setattr(server, "_EVERY", 0.05)
    with serving(sweep.folder.parent) as client:
        client.enter()
        one = ids(sweep.folder.parent)["sweep"]
        assert client.ask("/").text.count("state running") == 1
        events = events_of(client, f"/study/{one}/events")
        first = next(events)
        assert (first["status"], first["done"], first["left"], first["curves"]) == ("running", 0, 4, [])
        sweep.write(RUNS[0])
        told = next(one for one in events if one["done"] == 1)
        [curve] = told["curves"]
        assert (curve["method"], curve["runs"]) == ("de", 1)
        assert curve["y"][-1] == pytest.approx(RUNS[0].row["best_value"], rel=1e-4)
        sweep.write(RUNS[2])
        told = next(one for one in events if one["done"] == 2)
        assert [curve["method"] for curve in told["curves"]] == ["pso"]  # what has not changed is not told again
        sweep.collect()  # else this process still writes to a journal
        carried_by(sweep, GONE)
        told = next(one for one in events if one["status"] != "running")
        assert told["status"] == "killed"
        assert "bench run again" in told["words"]
        carried_by(sweep, os.getpid(), live_one=True)
        assert next(one for one in events if one["status"] == "running")["left"] == 2
        events.close()


def test_curves_go_on_when_journals_become_tables(sweep):
    follower = live.Follower(sweep.folder)
    sweep.write(RUNS[0])
    [before] = follower.look()["curves"]
    sweep.collect()
    assert follower.look()["curves"] == []
    sweep.write(RUNS[1])
    sweep.collect()
    [after] = follower.look()["curves"]
    assert (before["runs"], after["runs"]) == (1, 2)
    assert live.Follower(sweep.folder).look()["curves"] == [after]
    for run in RUNS[2:]:
        sweep.write(run)
    assert follower.look()["status"] == "done"
    assert follower.look() is None


def test_a_run_in_progress_grows_in_the_curves(sweep):
    follower = live.Follower(sweep.folder)
    row = RUNS[0].row

    def at(spent, best):
        told = {
            "run_id": row["run_id"], "problem": "sensor_zero", "optimizer": "de", "repetition": 0, "pid": os.getpid(),
            "host": platform.node(), "born": "", "began_at": 0.0, "updated_at": 0.0, "evaluations": spent,
            "spent": spent, "budget": 80, "best_value": best, "rate": 1.0, "eta_s": None, "silent_s": 0.0,
            "ended": False,
        }  # fmt: skip
        (sweep.folder / "running" / f"{row['run_id']}-1@x.json").write_text(json.dumps(told))
        [found] = follower.look()["running"]
        return [v for v in found["y"] if v is not None]

    assert at(3, 9.0) == [9.0]
    values = at(40, 2.0)
    assert values[0] == 9.0
    assert values[-1] == 2.0
    assert len(values) > 5


def test_a_sweep_is_followed_in_a_browser_and_keys_go_through_the_list(sweep):
    playwright = pytest.importorskip("playwright.sync_api", reason="pip install calibench[browser]")
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if chromium is None:
        pytest.skip("no Chromium is on the PATH: apt-get install chromium")
    with serving(sweep.folder.parent) as client, playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 400, "height": 800}, color_scheme="dark")
        said, asked = [], []
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(f"http://127.0.0.1:{client.port}/?token={TOKEN}")
        page.keyboard.press("/")
        assert page.evaluate("document.activeElement.type") == "search"
        page.keyboard.press("Escape")
        page.keyboard.press("j")
        page.keyboard.press("Enter")
        page.wait_for_url("**/live")
        page.locator("[data-what=done] b", has_text="0").wait_for()
        sweep.write(RUNS[0])
        page.locator("[data-what=done] b", has_text="1").wait_for(timeout=10_000)
        page.locator("#curves canvas").wait_for()
        assert page.evaluate("document.documentElement.scrollWidth") <= 400
        page.goto(page.url.replace("/live", "?page"))
        page.frame_locator("iframe").get_by_role("heading", name="All runs together").wait_for(timeout=10_000)
        browser.close()
        assert said == []
        assert all(url.startswith((f"http://127.0.0.1:{client.port}/", "data:")) for url in asked)
