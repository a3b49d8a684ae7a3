"""Every kind of page in Chromium, made of names that would be scripts and addresses: nothing runs, nothing is fetched.

    python -m benchmarks.hostile_pages [--to FOLDER]

Names of problems, methods, options, columns, units, joints, links, files and notes, and texts of errors, go in as a
user's files and classes bring them, through the verbs where one reads them: a study, searches of three machines, a
calibration, the ledger; hand-eye calibrations have no page. Each page, and each drawing beside it, is opened in
Chromium, for which every host is a socket of ours that counts who comes. Printed are scripts that ran, requests, and
elements that the same page of plain names has not. First of all a page that trusts its names is opened, which must be
seen. Exit code 1 where a page did anything. Needs Debian's chromium.
"""

from __future__ import annotations

import argparse
import html
import io
import itertools
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import fields
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np

from calibench import bench, optimizers
from calibench.bench.cli import main as command
from calibench.bench.measured.files import read_measured, write_measured
from calibench.bench.papers import page as ledger
from calibench.bench.papers.ledger import Row
from calibench.bench.report.study.write import write_report
from calibench.bench.store.runs import ResultStore
from calibench.problems import Parameter

DEMO = Path(__file__).resolve().parents[1] / "discrepancy" / "demo"
EVIL = "http://evil.invalid"
RUN = f"document.documentElement.dataset.ran=1;fetch(`{EVIL}/ran`)"
HOSTILE = (
    f"<script>{RUN}</script>",
    f'"><img src={EVIL}/a onerror={RUN}>',
    f"'><img src=x: onerror={RUN}>",
    f"<svg onload={RUN}>",
    f"</style></title></textarea><script>{RUN}</script>",
    f"</script><script>{RUN}</script>",
    f"]]></text><script>{RUN}</script>",
    f"--><script>{RUN}</script><!--",
    f"javascript:{RUN}",
    f'" onmouseover={RUN} autofocus onfocus={RUN} x="',
    f"<iframe srcdoc='&lt;script&gt;{RUN}&lt;/script&gt;'></iframe>",
    f"<link rel=stylesheet href={EVIL}/b><base href={EVIL}/c>",
    f"<meta http-equiv=refresh content='0;url={EVIL}/d'>",
    f"}}</style><style>@import url({EVIL}/e);*{{background:url({EVIL}/f)}}",
    f"url({EVIL}/g)",
    f"&#60;script&#62;{RUN}&#60;/script&#62;",
    f"\\u003cscript\\u003e{RUN}\\u003c/script\\u003e",
    f"${{{RUN}}}{{{{7*7}}}}{{% raw %}}{{#",
    "$\\frac{$ $x^{$ %s %(x)s {0} {}",
    "\u202egnp.\u2066<script>\u200b",
    "new\nline\r\nand\ttab",
    "nul\x00bell\x07escape\x1b[31m",
    "long" * 700,
)
Words = Callable[[], str]
_NO_HEAD = r"[\x00-\x1f\[\]]"  # what no heading of a column may hold: a unit stands in brackets


def hostile(first: int) -> Words:
    """Return what gives the hostile words in turn, each time another one, beginning with that of number `first`."""
    number = itertools.count()
    turn = itertools.cycle(HOSTILE[first:] + HOSTILE[:first])
    return lambda: f"{next(turn)} {next(number)}"


def bearable(word: str, refused: str) -> str:
    """Return a word without what a door refuses in one line, and which would keep all the others out."""
    return " ".join(re.sub(refused, "", word).split())


def plain() -> Words:
    """Return what gives harmless words."""
    number = itertools.count()
    return lambda: f"word {next(number)}"


class Bowl:
    """A problem all of whose names are `words`."""

    lower, upper, start, minimum = np.full(3, -1.0), np.ones(3), np.full(3, 0.5), 0.0

    def __init__(self, words: Words):
        self.name, self.unit, self.group = words(), words()[:40], words()
        self.options = {words(): words(), words(): words()}
        self.parameters = tuple(Parameter(words(), words()[:40], 0.5, -1.0, 1.0) for _ in range(3))
        self._merits, self._error, self.data_id = (words(), words()), words(), words()

    def __call__(self, x: Any) -> float:
        return float(x @ x)

    def merit(self, _x: Any) -> dict[str, Any]:
        return {self._merits[0]: 1.5, self._merits[1]: self._error}


class Failing:
    """A method all of whose names are `words`, and which fails with them."""

    def __init__(self, words: Words):
        self.name, self.options, self._error = words(), {words(): words()}, words()

    def minimize(self, objective: Any, _rng: Any) -> None:
        objective(objective.start)
        raise ValueError(self._error)


def study(folder: Path, words: Words) -> Iterator[Path]:
    """Make the page of a study of two problems, with methods of one's own that fail."""
    store = ResultStore(folder / as_file(words()))
    store.open()
    for problem in (Bowl(words), Bowl(words)):
        for method in (optimizers.make("de"), optimizers.make("nlopt_LN_BOBYQA"), Failing(words)):
            store.write(bench.execute(problem, method, budget=200))
    write_report(store)
    yield from pages_of(store.folder)


def discover(folder: Path, words: Words) -> Iterator[Path]:
    """Make the pages of searches: the GPM2002 with notes, a table and an arm with columns, joints and links."""
    gpm = read_measured(DEMO / "gpm2002" / "demo_backlash.parquet", "gpm2002")
    about = gpm.metadata | {words(): words(), words(): [words()], "note": words(), "source": words()}
    columns = gpm.columns | {words(): np.zeros(len(gpm)) for _ in range(3)}
    said = write_measured(type(gpm)(columns, "gpm2002", about, "said", units=gpm.units), folder / "said.parquet")
    call(
        "discover", "machine=gpm2002", f"data={said.rename(folder / as_file(words(), '.parquet'))}", f"results={folder}"
    )
    rng = np.random.default_rng(0)
    rows = rng.uniform(-1, 1, (200, 4))
    y = rows[:, 0] + rows[:, 1] ** 3 + np.sin(9 * rows[:, 2]) + 1e-2 * rng.standard_normal(200)
    heads = [bearable(words(), _NO_HEAD) for _ in range(4)] + ["y"]
    (folder / "table.csv").write_text(csv(heads, np.column_stack([rows, y])), newline="")
    call("discover", "machine=table", f"data={folder}/table.csv", f"results={folder}")
    urdf, _ = arm(folder, words, "demo_play.csv")
    call("discover", "machine=arm", f"machine.urdf={urdf}", f"data={folder}/arm.csv", f"results={folder}")
    yield from pages_of(folder)


def calibrate(folder: Path, words: Words) -> Iterator[Path]:
    """Make the page of a calibration of an arm with such names of joints, links, columns and files."""
    urdf, data = arm(folder, words, "demo_sound.csv")
    call("calibrate", f"urdf={urdf}", f"data={data.rename(folder / as_file(words(), '.csv'))}", "resamples=20",
         f"results={folder}")  # fmt: skip
    yield from pages_of(folder)


def ledger_page(folder: Path, words: Words) -> Iterator[Path]:
    """Make the page of the ledger, all of whose texts are such words."""
    fixed = {"paper": "cong2008", "key": "table2.a", "verdict": "not reproduced", "rule": "near", "n": 3}
    rows = [
        Row(**{f.name: words() if f.type == "str" else 1.0 for f in fields(Row)} | fixed | {"kind": kind})
        for kind in ("claim", "result", "input")
    ]
    path = folder / "ledger.html"
    path.write_text(ledger.page(rows, words()), encoding="utf-8", errors="surrogatepass")
    yield path


KINDS = {"study": study, "discover": discover, "calibrate": calibrate, "ledger": ledger_page}


def arm(folder: Path, words: Words, readings: str) -> tuple[Path, Path]:
    """Write the demonstration's URDF and readings, with words for the names of joints, links and further columns."""
    text, table = (DEMO / "arm" / "six.urdf").read_text(), (DEMO / "arm" / readings).read_text()
    joints = re.findall(r'<joint name="([^"]+)"', text)
    for name in dict.fromkeys(re.findall(r'name="([^"]+)"', text)):
        new = bearable(words(), f"{_NO_HEAD}|[$]{{")  # which would be xacro
        text = text.replace(f'"{name}"', f'"{html.escape(new)}"')
        if name in joints:
            table = table.replace(f"{name} [rad]", quoted(f"{new} [rad]"))
    lines = [line for line in table.splitlines() if not line.startswith("#")]
    lines = [f"{line},{quoted(bearable(words(), _NO_HEAD)) if k == 0 else k}" for k, line in enumerate(lines)]
    (folder / "arm.urdf").write_text(text, newline="")
    (folder / "arm.csv").write_text("\n".join(lines) + "\n", newline="")
    return folder / "arm.urdf", folder / "arm.csv"


def csv(heads: Sequence[str], rows: Any) -> str:
    return "\n".join([",".join(map(quoted, heads)), *(",".join(f"{v:.9g}" for v in row) for row in rows)]) + "\n"


def quoted(cell: str) -> str:
    return '"' + cell.replace('"', '""') + '"'


def as_file(word: str, ending: str = "") -> str:
    """Return a name that a file system takes, with all of the word that fits."""
    return re.sub(r"[\x00/]", "∕", word)[:60] + ending


def call(*words: str) -> None:
    """Run a verb in this process; print its line where it refuses what it was given."""
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()) as said:
        try:
            command(list(words))
            code: object = 0
        except SystemExit as ended:
            code = ended.code
    if code:
        print(f"  {words[0]} {words[1][:40]}: exit code {code}: {said.getvalue().strip()[-300:]!r}", flush=True)


def pages_of(folder: Path) -> Iterator[Path]:
    """Yield the pages in a folder and, where there are drawings, a page that has all of them as documents."""
    yield from sorted(folder.rglob("*.html"))
    drawings = sorted(folder.rglob("*.svg"))
    if drawings:
        shown = folder / "all drawings.html"
        shown.write_text("".join(f'<object data="{html.escape(one.as_uri())}"></object>' for one in drawings))
        yield shown


class Read(HTMLParser):
    """The elements of a page that can act: scripts, and each attribute that runs or names an address elsewhere."""

    def __init__(self, text: str):
        super().__init__()
        self.found: Counter[str] = Counter()
        self.ran = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found[tag] += tag in ("script", "iframe", "object", "embed", "base", "link", "style", "form", "meta")
        for name, value in attrs:
            self.ran |= name == "data-ran"
            scheme = re.match(r"\s*([a-z]+):", value or "", re.I)
            if name.startswith("on") or (scheme and name in ("href", "src", "xlink:href", "action", "data", "srcset")):
                self.found[f"{tag} {name}={scheme[1].lower() if scheme else ''}"] += 1


def hosts_of(said: Sequence[bytes]) -> Counter[str]:
    """Return the hosts that were asked for, as HTTP and the first words of TLS (RFC 6066, 3) name them."""
    hosts: list[str] = []
    for one in said:
        found = re.search(rb"\nHost: ?([^\r\n]+)", one, re.I)
        named = re.finditer(rb"(?s)\x00\x00(..)(..)\x00(..)([a-z0-9.-]+)", one)
        tls = [m[4][: int.from_bytes(m[3])] for m in named if int.from_bytes(m[2]) == int.from_bytes(m[3]) + 3]
        hosts.append((found[1] if found else tls[0] if tls else b"unknown").decode())
    return Counter(hosts)


@contextmanager
def listener() -> Iterator[tuple[int, list[bytes]]]:
    """Give the port of a socket that lets nobody wait, and what was first said on each connection to it."""
    said: list[bytes] = []
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            while True:
                try:
                    one, _ = server.accept()
                except OSError:
                    return
                with one:
                    one.settimeout(1.0)
                    try:
                        said.append(one.recv(4000))
                        one.sendall(b"HTTP/1.1 204 No Content\r\nContent-Length: 0\r\nConnection: close\r\n\r\n")
                    except OSError:
                        said.append(b"")

        threading.Thread(target=serve, daemon=True).start()
        yield server.getsockname()[1], said
        server.shutdown(socket.SHUT_RDWR)


def opened(page: Path, port: int, profile: Path) -> Read:
    """Open a page in Chromium, for which all hosts are our socket, and read what it has become."""
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
    if browser is None:
        raise SystemExit("chromium is not on the PATH: apt-get install chromium")
    flags = (
        "headless", "no-sandbox", "disable-gpu", "disable-quic", "no-first-run", "disable-background-networking",
        "disable-component-update", "disable-sync", "disable-dev-shm-usage", f"user-data-dir={profile}",
        f"host-resolver-rules=MAP * 127.0.0.1:{port}", "virtual-time-budget=3000", "dump-dom",
    )  # fmt: skip
    done = subprocess.run(
        [browser, *(f"--{flag}" for flag in flags), page.as_uri()], capture_output=True, timeout=300, check=True
    )
    return Read(done.stdout.decode("utf-8", "replace"))


def look(pages: Sequence[Path], port: int, said: list[bytes], home: Path) -> tuple[int, Counter[str], Counter[str]]:
    """Return of pages how many ran a script of a name, the hosts that were asked, and all elements that can act."""
    ran, before, found = 0, len(said), Counter[str]()
    for page in pages:
        read = opened(page, port, Path(tempfile.mkdtemp(dir=home)))
        ran += read.ran
        found += read.found
    return ran, hosts_of(said[before:]), found


def main(argv: Sequence[str] | None = None) -> int:
    """Open all kinds of pages; 1 where one did anything that the page of plain names does not."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.hostile_pages", description=__doc__)
    parser.add_argument("--to", type=Path, default=Path("results/benchmarks/hostile_pages"))
    parser.add_argument("--only", choices=tuple(KINDS), action="append")
    given = parser.parse_args(argv)
    bad = 0
    with tempfile.TemporaryDirectory() as home, listener() as (port, said):
        control = Path(home) / "control.html"
        control.write_text("<title>nothing</title>")
        own = look([control] * 3, port, said, Path(home))[1].keys()  # hosts of Chromium's own
        print(f"an empty page: Chromium itself asks for {', '.join(sorted(own)) or 'nothing'}")
        for k, word in enumerate(HOSTILE[:2]):
            control.write_text(f"<title>trusts</title><p>{word}</p>")
            ran, hosts, _ = look([control], port, said, Path(home))
            print(f"a page that trusts word {k}: {ran} script ran, requests: {_asked(hosts, own)}")
            if not (ran and _asked(hosts, own)):
                raise SystemExit("what such a page does is not seen here: nothing below would mean anything")
        for kind in given.only or KINDS:
            found: list[Counter[str]] = []
            for name, words in (("plain", plain()), *((f"hostile {k}", hostile(k)) for k in range(0, len(HOSTILE), 8))):
                folder = given.to.resolve() / kind / name
                shutil.rmtree(folder, ignore_errors=True)
                folder.mkdir(parents=True)
                pages = list(KINDS[kind](folder, words))
                ran, hosts, acts = look(pages, port, said, Path(home))
                asked = _asked(hosts, own)
                found.append(acts)
                more = {what: n - found[0][what] for what, n in acts.items() if n > found[0][what]}
                print(
                    f"{kind}, {name}: {len(pages)} pages, {ran} scripts ran, {sum(asked.values())} requests, "
                    f"{sum(more.values())} more elements", *filter(None, (asked, more)), flush=True,
                )  # fmt: skip
                bad += ran + sum(asked.values()) + len(more)
    return 1 if bad else 0


def _asked(hosts: Counter[str], own: Collection[str]) -> dict[str, int]:
    return {host: n for host, n in hosts.items() if host not in own}


if __name__ == "__main__":
    sys.exit(main())
