"""``bench ui``: all studies of a results folder in a browser of this machine, read-only, and sweeps as they run.

The door (`_Door`) stands before every page: it answers only under our own names (a foreign host name that leads here is
refused), only to who has opened the address with the token once, and with headers that let a page load nothing but
ours. An id in an address is looked up in the catalogue and never made part of a path. The report of a study is shown in
a frame without an origin, in which no scripts run but those of our own report. A sweep is followed by what lies in its
folder (`Follower`), so that processes, shards and Dask are seen alike; nothing there is changed.
"""

import json
import os
import secrets
import socket
import threading
import time
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from fnmatch import fnmatchcase
from functools import cache, lru_cache
from hashlib import blake2b
from hmac import compare_digest
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, cast, final
from urllib.parse import parse_qs

import anyio
import numpy as np
import pandas as pd
import uvicorn
from markupsafe import Markup, escape
from numpy.typing import NDArray
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import MutableHeaders
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, RedirectResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from calibench.bench.exchange.studies import traces_by_run
from calibench.bench.execution.in_progress import Running, hosts_at_work, read_running
from calibench.bench.report.one_run import find_run, show_run
from calibench.bench.report.shared.page import render
from calibench.bench.report.study.explored import LIBRARY, as_json, policy, read_static
from calibench.bench.report.study.page import StudyPage
from calibench.bench.report.study.write import finished_runs
from calibench.bench.statistics import tables
from calibench.bench.statistics.fixed_target import Hits
from calibench.bench.statistics.progress import sweep_progress
from calibench.bench.statistics.ranking import By
from calibench.bench.statistics.targets import levels_of
from calibench.bench.statistics.two_studies import compare
from calibench.bench.store.arrays import POINT, Array
from calibench.bench.store.journal import journals_in
from calibench.bench.store.manifest import StoreError, read_notes, write_notes
from calibench.bench.store.runs import ResultStore, locked
from calibench.bench.tracking import history
from calibench.bench.tracking.catalogue import Entry, catalogue, line_of
from calibench.bench.tracking.tables import folder_of
from calibench.core.registry import names_of_files
from calibench.core.words import plain, span

_EVERY = 1.0  # seconds between two looks at a sweep
_ROWS = 100  # of a table at a time: a browser draws five hundred in a second
_KEPT = 4  # pages of studies
_CELLS = 20  # histories on a page
_NAMED = ("problem", "optimizer")
# of what the scripts that draw read: the page of a report has more
_NO_CELLS: dict[str, Any] = {"problems": [], "cells": {"problem": [], "method": []}}
_LARGEST_FORM = 100_000  # bytes
_ORDERS: tuple[By, ...] = ("goal", "value", "charged")
_COLUMNS = ("run_id", "problem", "optimizer", "repetition", "status", "stop_reason", "best_value", "charged", "wall_s")
_SEARCHED = ["problem", "optimizer", "status", "stop_reason"]  # by a text, beside the id
_NUMBERS = ("repetition", "best_value", "charged", "wall_s")
_OURS = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "frame-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
_HEADERS = {
    "x-content-type-options": "nosniff", "referrer-policy": "no-referrer", "cache-control": "no-store",
    "cross-origin-opener-policy": "same-origin", "cross-origin-resource-policy": "same-origin",
}  # fmt: skip


def serve(results: Path, port: int, *, write: bool, tell: Callable[[str], None]) -> None:
    """Answer until Ctrl-C; `tell` gets the address. Raises `ValueError` where the port is taken."""
    token = secrets.token_urlsafe(24)
    try:
        listening = socket.create_server(("127.0.0.1", port))  # who opens the address at once waits
    except OSError as error:
        why = os.strerror(error.errno or 0)
        raise ValueError(f"ui: port={port} is taken ({why}); port=0 takes a free one") from None
    with listening:
        port = listening.getsockname()[1]
        config = uvicorn.Config(
            application(results, port, token, write=write), loop="asyncio", http="h11", ws="none", lifespan="off",
            interface="asgi3", log_config=None, log_level="critical", access_log=False, server_header=False,
            proxy_headers=False, timeout_graceful_shutdown=0,
        )  # fmt: skip
        tell(f"http://127.0.0.1:{port}/?token={token}")
        with suppress(KeyboardInterrupt):
            uvicorn.Server(config).run([listening])


def application(results: Path, port: int, token: str, *, write: bool = False) -> ASGIApp:
    """Return the application as an ASGI server takes it: the pages, behind their door."""
    site = _Site(results, write)
    routes = [
        Route("/", site.page(site.catalogue)), Route("/history", site.page(site.history)),
        Route("/compare", site.page(site.compare)), Route("/study/{id}", site.page(site.study)),
        Route("/study/{id}/runs", site.page(site.runs)), Route("/study/{id}/run/{run}", site.page(site.run)),
        Route("/study/{id}/page/{number:int}", site.page(site.report)), Route("/study/{id}/live", site.page(site.live)),
        Route("/study/{id}/events", site.events), Route("/study/{id}/history", site.page(site.history)),
        Route("/study/{id}/note", site.note, methods=["POST"]),
        Route("/static/{name}", site.static),
    ]  # fmt: skip
    inner = Starlette(routes=routes, exception_handlers={HTTPException: site.refuse, Exception: site.fail})
    return _Door(inner, port, token, write)


@final
class _Door:
    """What every request passes: its host, its token or cookie, its method; and the headers of every answer."""

    def __init__(self, inner: ASGIApp, port: int, token: str, write: bool) -> None:
        self.inner, self.token, self.write = inner, token, write
        self.hosts = {f"127.0.0.1:{port}", f"localhost:{port}"}
        self.cookie, self.session = f"calibench-{port}", secrets.token_urlsafe(24)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            return

        async def send_safe(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in {**_HEADERS, "content-security-policy": _OURS}.items():
                    headers.setdefault(name, value)
            await send(message)

        request = Request(scope, receive)
        answer = self._refusal(request)
        await (answer or self.inner)(scope, receive, send_safe)

    def _refusal(self, request: Request) -> Response | None:
        hosts = request.headers.getlist("host")
        if len(hosts) != 1 or hosts[0] not in self.hosts:
            return PlainTextResponse("This address is not ours: open the one that `bench ui` printed.", 421)
        given = request.query_params.get("token")
        if given is not None and request.method == "GET" and request.url.path == "/":
            if not _same(given, self.token):
                return PlainTextResponse("The token is another: open the address that `bench ui` printed.", 403)
            answer = RedirectResponse("/", 303)
            answer.set_cookie(self.cookie, self.session, httponly=True, samesite="strict", path="/")
            return answer
        if not _same(request.cookies.get(self.cookie, ""), self.session):
            return PlainTextResponse(
                "Open the address with the token that `bench ui` printed; it lets this browser in.", 403
            )
        if request.method not in ("GET", "HEAD", "POST"):
            return PlainTextResponse("This is read alone.", 405)
        if request.method == "POST":
            if not self.write:
                return PlainTextResponse("Nothing is written: start `bench ui --write` to note and tag.", 403)
            origin = request.headers.get("origin")
            if origin is not None and origin not in {f"http://{host}" for host in self.hosts}:
                return PlainTextResponse("Another site has sent this.", 403)
        return None


def _same(one: str, other: str) -> bool:
    return compare_digest(one.encode(), other.encode())


def id_of(entry: Entry) -> str:
    """Return the id of a study in addresses: of its name, of which nothing stands in an address."""
    return blake2b(entry.study.encode("utf-8", "surrogateescape"), digest_size=8).hexdigest()


@final
class _Site:
    """The pages of one results folder."""

    def __init__(self, results: Path, write: bool) -> None:
        self.results, self.write, self.form_token = results, write, secrets.token_urlsafe(24)
        self._listed: dict[str, Entry] = {}
        self._until = 0.0
        self._lock = threading.Lock()  # pages of studies are made one by one

    def page(self, make: Callable[[Request], Response]) -> Callable[[Request], Response]:
        """Return an endpoint, carried out by a thread: it imports no class that a file names."""

        def answer(request: Request) -> Response:
            try:
                with names_of_files():
                    return make(request)
            except ValueError as error:
                raise HTTPException(422, " ".join(str(error).split())) from None

        return answer

    def refuse(self, request: Request, error: Exception) -> Response:
        assert isinstance(error, HTTPException)
        text = {404: "There is no such page, or its study is gone."}.get(error.status_code, error.detail)
        if "part" in request.query_params:
            return HTMLResponse(Markup("<p class='answer undecided'>{}</p>").format(text))
        return self._html("message", "Not this way", code=error.status_code, text=text)

    def fail(self, request: Request, error: Exception) -> Response:
        """Return the page of what could not be read."""
        return self._html("message", "This went wrong", code=500, text=f"{type(error).__name__}: {error}")

    def _html(self, template: str, title: str, code: int = 200, **values: Any) -> Response:
        text = render(
            f"ui/templates/{template}.html.j2", title=title, results=str(self.results), write=self.write,
            token=self.form_token if self.write else "", **values,
        )  # fmt: skip
        return HTMLResponse(text, code)

    def _entries(self) -> dict[str, Entry]:
        """Return all entries by their ids, as they were a moment ago at most."""
        if time.monotonic() > self._until:
            began = time.monotonic()
            found = catalogue(self.results, ["archived=*"])
            self._listed = {id_of(entry): entry for entry in found}
            self._until = time.monotonic() + max(1.0, 3 * (time.monotonic() - began))
        return self._listed

    def _asked(self, ident: str) -> tuple[Path, Entry]:
        """Return folder and entry of an id. The folder is inside of the results, and no link on its way."""
        entry = self._entries().get(ident)
        if entry is None:
            raise HTTPException(404)
        folder, home = folder_of(self.results, entry), self.results.resolve()
        inside = home if folder == self.results else home / entry.study
        if folder.resolve() != inside or not folder.is_dir():  # somebody has put a link there since
            raise HTTPException(404)
        return folder, entry

    def catalogue(self, request: Request) -> Response:
        query = request.query_params.get("q", "")
        words = query.split()
        asked = [word for word in words if "=" in word]
        texts = [word.casefold() for word in words if "=" not in word]
        lines, error = [], ""
        try:
            for entry in catalogue(self.results, asked):
                said = " ".join(line_of(entry).values()) + " ".join((*entry.problem, *entry.optimizer, *entry.machine))
                if all(text in said.casefold() for text in texts):
                    lines.append(entry)
        except ValueError as problem:
            error = str(problem).removeprefix("studies: ")
        first = _whole(request.query_params.get("from", "0"))
        rows = [self._line(entry) for entry in lines[first : first + _ROWS]]
        template = "catalogue_rows" if "part" in request.query_params else "catalogue"
        return self._html(
            template, "Studies", rows=rows, query=query, first=first, step=_ROWS, count=len(lines), error=error
        )

    def _line(self, entry: Entry) -> dict[str, Any]:
        status: str = entry.status
        folder = folder_of(self.results, entry)
        if status in ("unfinished", "empty") and (folder / "running").is_dir() and hosts_at_work(folder):
            status = "running"  # as far as this machine can tell
        line = {name: " ".join(text.split()) for name, text in line_of(entry).items()}
        more = {"id": id_of(entry), "status": status, "archived": entry.archived, "tag": entry.tag}
        return line | more | {"notes": entry.notes}

    def _frame(self, request: Request) -> tuple[Path, Entry, dict[str, Any]]:
        folder, entry = self._asked(request.path_params["id"])
        pages = _pages_in(folder, entry)
        names = [path.relative_to(folder).as_posix() for path in pages]
        return folder, entry, {"it": self._line(entry), "entry": asdict(entry), "pages": names}

    def study(self, request: Request) -> Response:
        """Answer with a study: its facts, its notes, and its page in a frame."""
        folder, entry, values = self._frame(request)
        if values["it"]["status"] == "running" and "page" not in request.query_params:
            return RedirectResponse(f"/study/{values['it']['id']}/live", 303)
        others = [(id_of(one), one.study) for one in self._entries().values() if one.kind == "runs" and one != entry]
        noted = read_notes(folder)
        return self._html("study", entry.study, **values, noted=noted, others=others[:500], tab="page")

    def report(self, request: Request) -> Response:
        """Answer with a page of the study for the frame: as it was written, or made now where the runs have changed."""
        folder, entry = self._asked(request.path_params["id"])
        pages = _pages_in(folder, entry)
        number = request.path_params["number"]
        if number >= len(pages):
            raise HTTPException(404)
        if entry.kind == "runs" and number == 0:
            with self._lock:
                text = _report(folder, state_of(folder))
        else:
            text = pages[number].read_text("utf-8", "replace")
        ours = f"{policy()}; frame-ancestors 'self'; sandbox allow-scripts"
        return HTMLResponse(text, headers={"content-security-policy": ours})

    def runs(self, request: Request) -> Response:
        """Answer with the runs of a study, those that keep to the words, in the order of a column."""
        folder, entry, values = self._frame(request)
        query, order = request.query_params.get("q", ""), request.query_params.get("by", "")
        down = order.startswith("-")
        table = ResultStore(folder).runs(list(_COLUMNS))
        # each word is COLUMN=VALUE with globs, or a text that some column holds
        keep = pd.Series(True, index=table.index)
        for word in query.split():
            column, equals, value = word.partition("=")
            differs, column = column.endswith("!"), column.removesuffix("!")
            if equals:
                if column not in _COLUMNS:
                    raise ValueError(f"there is no column {column!r} here: {', '.join(_COLUMNS)}")
                known = [v for v in table[column].unique() if any(fnmatchcase(str(v), one) for one in value.split(","))]
                keep &= table[column].isin(known) != differs
            else:
                said = table["run_id"].str.cat(table[_SEARCHED].astype(str), sep="\n").str.casefold()
                keep &= said.str.contains(word.casefold(), regex=False)
        found = table[keep]
        if order.lstrip("-") in _COLUMNS:
            found = found.sort_values(order.lstrip("-"), ascending=not down, kind="stable")
        first = _whole(request.query_params.get("from", "0"))
        rows = [
            {name: plain(row[name]) if name in _NUMBERS and row[name] == row[name] else row[name] for name in _COLUMNS}
            for row in found.iloc[first : first + _ROWS].to_dict("records")
        ]
        template = "runs_rows" if "part" in request.query_params else "runs"
        return self._html(
            template, entry.study, **values, rows=rows, columns=_COLUMNS, numbers=_NUMBERS, query=query, order=order,
            first=first, step=_ROWS, count=len(found), of=len(table), tab="runs",
        )  # fmt: skip

    def run(self, request: Request) -> Response:
        folder, _, values = self._frame(request)
        try:
            found = find_run(folder, request.path_params["run"])
        except StoreError:
            raise HTTPException(404) from None
        row, trace = found.row, found.trace
        curve = {"x": trace["charged"].tolist(), "y": [v if np.isfinite(v) else None for v in trace["best_value"]]}
        title = f"{row['optimizer']} on {row['problem']}, run {row['run_id']}"
        numbers = as_json(_NO_CELLS | {"methods": [{"name": str(row["optimizer"])}], "curve": curve})
        return self._html("run", title, **values, story=show_run(found), row=row, numbers=numbers, tab="runs")

    def live(self, request: Request) -> Response:
        _, entry, values = self._frame(request)
        if entry.kind != "runs":
            raise HTTPException(404)
        return self._html("live", entry.study, **values, numbers=as_json(_NO_CELLS | {"methods": []}), tab="live")

    async def events(self, request: Request) -> Response:
        """Answer with what changes in a sweep, as it changes."""
        folder, entry = await run_in_threadpool(self._asked, request.path_params["id"])
        if entry.kind != "runs":
            raise HTTPException(404)

        async def events() -> AsyncIterator[bytes]:
            follower = Follower(folder)
            while True:
                began = time.monotonic()
                try:
                    news = await run_in_threadpool(follower.look)
                except (ValueError, OSError) as error:  # it is being written, or is gone
                    news = {"error": " ".join(str(error).split())}
                text = ": nothing new"
                if news is not None:
                    text = f"data: {json.dumps(news, separators=(',', ':'), allow_nan=False)}"
                yield f"{text}\n\n".encode()
                await anyio.sleep(max(_EVERY, 3 * (time.monotonic() - began)))

        return StreamingResponse(events(), media_type="text/event-stream")

    async def note(self, request: Request) -> Response:
        size, body = 0, b""
        async for part in request.stream():
            size += len(part)
            if size > _LARGEST_FORM:
                raise HTTPException(413, "the form is too large")
            body += part
        form = {name: texts[0] for name, texts in parse_qs(body.decode("utf-8", "replace")).items()}
        if not _same(form.get("token", ""), self.form_token):
            raise HTTPException(403, "the form is not of this page: load it again")
        folder, _ = await run_in_threadpool(self._asked, request.path_params["id"])
        try:
            await run_in_threadpool(_write_note, folder, form)
        except ValueError as error:
            raise HTTPException(422, str(error)) from None
        self._until = 0.0
        return RedirectResponse(f"/study/{request.path_params['id']}?page", 303)

    def compare(self, request: Request) -> Response:
        given = request.query_params
        by: By = next((one for one in _ORDERS if one == given.get("by")), "goal")
        sides = [self._asked(given.get(name, "")) for name in ("a", "b")]
        entries = [entry for _, entry in sides]
        tables_of = [ResultStore(folder).runs() for folder, _ in sides]
        for entry, runs in zip(entries, tables_of, strict=True):
            if runs.empty:
                raise ValueError(f"{entry.study}: holds no finished run yet")
        compared = compare(tables_of[0], tables_of[1], by)
        cells = [{str(name): value for name, value in row.items()} for row in compared.cells.to_dict("records")]
        order = ("worse", "better", "undecided", "equal")
        cells.sort(key=lambda row: order.index(row["verdict"]))
        counts = [(verdict, sum(row["verdict"] == verdict for row in cells)) for verdict in order]
        return self._html(
            "compare", "Two studies", sides=[self._line(entry) for entry in entries], cells=cells, counts=counts, by=by,
            orders=_ORDERS, only=(compared.only_first, compared.only_second), plain=plain,
        )  # fmt: skip

    def history(self, request: Request) -> Response:
        """Answer with methods over versions of the code, as is asked, or the cells of a study, each with a drawing."""
        given = request.query_params
        problem, optimizer = given.get("problem", ""), given.get("optimizer", "")
        runs = [entry for entry in self._entries().values() if entry.kind == "runs"]
        values: dict[str, Any] = {"names": [sorted({n for one in runs for n in getattr(one, of)}) for of in _NAMED]}
        study = ""
        if "id" in request.path_params:
            _, entry, values = self._frame(request)
            study, problem, optimizer = entry.study, ",".join(entry.problem), ",".join(entry.optimizer)
        by = next((one for one in (*_ORDERS, "success") if one == given.get("by")), "goal")
        found: list[history.History] = []
        left_out: Sequence[Any] = ()
        if problem and optimizer:
            found, left_out = history.histories(self.results, history.Asked(problem, optimizer, cast(By, by)))
        found = [one for one in found if not study or any(study in version.studies for version in one.versions)]
        found.sort(key=lambda one: (one.change.p if one.change else 1.0, -len(one.versions)))
        histories = [
            {
                "title": one.called, "by": one.shown, "setting": one.setting[1:], "sentence": history.sentence(one),
                "rows": history.rows_of(one), "drawing": history.drawing(one),
            }
            for one in found[:_CELLS]
        ]  # fmt: skip
        return self._html(
            "history", f"History of {study}" if study else "History", **values, tab="history", problem=problem,
            optimizer=optimizer, by=by, orders=(*_ORDERS, "success"), found=histories,
            more=len(found) - _CELLS, left_out=[(str(one.path), one.why) for one in left_out],
        )  # fmt: skip

    def static(self, request: Request) -> Response:
        """Answer with the style or a script: made of ours once, found by name in a table."""
        found = _static().get(request.path_params["name"])
        if found is None:
            raise HTTPException(404)
        return Response(found[1], media_type=found[0])


@lru_cache(maxsize=_KEPT)
def _report(folder: Path, state: "State") -> str:
    """Return the report of a study: as it was written, where that is later than its runs and of this version."""
    store, written = ResultStore(folder), folder / "report.html"
    if written.is_file() and not written.is_symlink() and not store.has_journals():
        text = written.read_text("utf-8", "replace")
        if str(escape(policy())) in text and written.stat().st_mtime_ns >= max(changed for _, _, changed in state[:3]):
            return text
    with tables.problems_made_once():  # the page without drawings: its scripts draw
        finished = finished_runs(store)
        return StudyPage(
            folder=store.folder, runs=finished.runs, traces=finished.traces, summary=finished.summary,
            hits=Hits.of(store.hits(levels_of(finished.runs))), manifest=finished.manifest,
        ).html()  # fmt: skip


def _pages_in(folder: Path, entry: Entry) -> list[Path]:
    """Return the pages of a study, the report first: that of runs is made where nobody has written it."""
    first = folder / "report.html"
    written = [path for path in sorted(folder.glob("*.html")) if path != first]
    if entry.kind == "discovery":  # a page a case
        written += [path for path in sorted(folder.glob("*/report.html")) if not path.parent.is_symlink()]
    there = [path for path in (first, *written) if path.is_file() and not path.is_symlink()]
    return [first, *there] if entry.kind == "runs" and entry.done and first not in there else there


def _whole(text: str) -> int:
    return int(text) if text.isdecimal() and len(text) < 10 else 0


def _write_note(folder: Path, form: Mapping[str, str]) -> None:
    with locked(folder):
        noted = read_notes(folder)
        if form.get("text"):
            noted = noted.with_note(form["text"])
        if form.get("tags"):
            noted = noted.with_tags([t if t[0] in "+-" else f"+{t}" for t in form["tags"].split()])
        if "archived" in form:
            noted = replace(noted, archived=form["archived"] == "yes")
        write_notes(folder, noted)


@cache
def _static() -> dict[str, tuple[str, str]]:
    """Return what pages load, by name: type and text."""

    def text(*path: str) -> str:
        return files("calibench.bench").joinpath(*path).read_text(encoding="utf-8")

    css = [
        text("report", "shared", "templates", "page.css"), read_static("uPlot.min.css"),
        text("report", "study", "templates", "study.css"), text("report", "study", "templates", "explored.css"),
        text("ui", "static", "app.css"),
    ]  # fmt: skip
    drawn = "\n".join(read_static(name) for name in ("state.js", "style.js", "chart.js"))
    drawn = f'(function () {{\n"use strict";\n{drawn}\n{text("ui", "static", "drawn.js")}}})();\n'
    return {
        "app.css": ("text/css", "\n".join(css)), "app.js": ("text/javascript", text("ui", "static", "app.js")),
        "drawn.js": ("text/javascript", f"{read_static(LIBRARY)}\n{drawn}"),
    }  # fmt: skip


Status = Literal["running", "done", "killed", "stopped"]
_POINTS = 100  # of a curve
_AGAIN = 5.0  # seconds after which all is told again, changed or not: the pace falls while nothing ends
_DIGITS = 5
_CELLS_LEFT = 30  # that are listed
_CHARGED, _BEST = POINT.index("charged"), POINT.index("best_value")
_WORDS: dict[Status, str] = {
    "running": "running", "done": "all planned runs are done", "killed": "killed: who carried it is gone",
    "stopped": "stopped: nobody is at work on it here",
}  # fmt: skip
Cell = tuple[str, str]  # problem, optimizer
State = tuple[Any, ...]


@final
class Follower:
    """What one reader has been told of a sweep, and what is new to it.

    `look` returns what has changed since: counts, pace, what runs now, and of each cell the median of the best value
    over what was charged, which grows as runs end.
    """

    def __init__(self, folder: Path) -> None:
        self.store = ResultStore(folder)
        self._seen: set[str] = set()
        self._state: State = ()
        self._tables: State = ()
        self._at = 0.0
        self._grid: Array = np.zeros(0)
        self._runs: dict[Cell, list[Array]] = {}
        self._growing: dict[str, Array] = {}

    def look(self) -> dict[str, Any] | None:
        """Return what to tell of the sweep, as plain values; None where nothing has changed. Raises `ValueError`."""
        state = state_of(self.store.folder)
        if state == self._state and time.monotonic() - self._at < _AGAIN:
            return None
        event: dict[str, Any] = {}
        # evenly apart on a logarithmic axis up to the largest budget
        most = max([2, *(int(one) for one in (self.store.manifest().get("budgets") or {}).values())])
        grid: Array = np.unique(np.round(np.geomspace(1, most, _POINTS)))
        if not np.array_equal(grid, self._grid):  # at the first look, and where a larger budget has joined
            self._grid, self._seen, self._runs, self._growing, self._tables = grid, set(), {}, {}, ()
            event["at"] = grid.tolist()
        progress, running = sweep_progress(self.store), read_running(self.store.folder)
        changed = self._new_runs()
        self._state, self._at = state, time.monotonic()
        status: Status = "done"
        if progress.to_do and progress.hosts:
            status = "running"
        elif progress.to_do:  # who ends by itself takes its own away
            status = "killed" if any((self.store.folder / "running").glob("*")) else "stopped"
        way = f"; the same command goes on: {progress.command}" if progress.command else ""
        curves = []
        for cell in sorted(changed):  # the median over the runs of a cell; a run without a value is infinitely bad
            stack = np.array(self._runs[cell])
            middle = np.median(np.where(np.isnan(stack), np.inf, stack), axis=0)
            curves.append({"problem": cell[0], "method": cell[1], "runs": len(stack), "y": _rounded(middle)})
        return event | {
            "status": status, "words": _WORDS[status] + (way if status in ("killed", "stopped") else ""),
            "planned": max(progress.planned, progress.done), "done": progress.done, "failed": progress.failed,
            "timeouts": progress.timeouts, "left": progress.to_do,
            "pace": f"{plain(progress.pace, 3)} runs/s" if progress.pace > 0 else "–",
            "eta": span(progress.eta_s) if progress.eta_s is not None and status == "running" else "–",
            "hosts": sorted(progress.hosts),
            "reasons": [[reason.count, reason.status, reason.text, reason.run_id] for reason in progress.reasons],
            "cells": sorted(([n, label] for label, n in progress.left.items()), reverse=True)[:_CELLS_LEFT],
            "curves": curves,
            "running": [self._running(run) for run in running],
        }  # fmt: skip

    def _new_runs(self) -> set[Cell]:
        """Take the curves of runs that ended since the last look; return their cells."""
        changed = set()
        for reader in journals_in(self.store.folder):
            for record in reader:
                if record.run_id not in self._seen:
                    row = dict(record.common) | dict(zip(record.names, json.loads(record.row), strict=True))
                    points = json.loads(record.trace)
                    changed.add(self._take(row, np.array(points[_CHARGED], float), np.array(points[_BEST], float)))
        tables = tuple(_stat(self.store.folder / name) for name in ("runs.parquet", "traces.parquet"))
        if tables != self._tables:
            self._tables = tables
            rows = self.store.rows(["run_id", "problem", "optimizer"]).to_pylist()
            new = [row for row in rows if row["run_id"] not in self._seen]
            curves = traces_by_run(self.store.traces()) if new else {}
            changed |= {self._take(row, *curves.get(row["run_id"], (np.zeros(0), np.zeros(0)))) for row in new}
        return changed

    def _take(self, row: dict[str, Any], charged: Array | NDArray[np.int64], best: Array) -> Cell:
        cell = str(row["problem"]), str(row["optimizer"])
        self._seen.add(row["run_id"])
        self._growing.pop(row["run_id"], None)
        last = np.searchsorted(charged, self._grid, side="right") - 1
        values = np.where(last >= 0, best[np.maximum(last, 0)] if len(best) else np.nan, np.nan)
        self._runs.setdefault(cell, []).append(values)
        return cell

    def _running(self, run: Running) -> dict[str, Any]:
        """Return a run in progress, with its best values at the looks so far."""
        curve = self._growing.setdefault(run.run_id, np.full(len(self._grid), np.nan))
        if run.best_value is not None and len(curve):
            here = max(0, int(np.searchsorted(self._grid, run.spent, side="right")) - 1)
            before = np.flatnonzero(~np.isnan(curve[:here]))
            last = int(before[-1]) if len(before) else here
            curve[last + 1 : here] = curve[last]  # as it was at the look before
            curve[here] = run.best_value
        return {
            "run_id": run.run_id, "problem": run.problem, "method": run.optimizer, "line": run.line(),
            "y": _rounded(curve),
        }  # fmt: skip


def state_of(folder: Path) -> State:
    """Return what changes as a sweep goes on: names, sizes and times of its files, and where somebody is at work."""
    paths = [folder / name for name in ("manifest.json", "runs.parquet", "traces.parquet")]
    for name in ("journal", "running"):
        paths += sorted((folder / name).glob("*"))
    return (*map(_stat, paths), *sorted(hosts_at_work(folder)))


def _stat(path: Path) -> tuple[str, int, int]:
    try:
        found = os.stat(path)
    except OSError:
        return path.name, -1, 0
    return path.name, found.st_size, found.st_mtime_ns


def _rounded(values: Array) -> list[float | None]:
    return [float(f"{v:.{_DIGITS}g}") if np.isfinite(v) else None for v in values.tolist()]
