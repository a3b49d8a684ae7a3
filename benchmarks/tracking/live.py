"""A sweep watched by an automated browser: how late points of curves arrive, and whether a kill shows and going on.

``python -m benchmarks.tracking.live OUT.jsonl [WAY ...]`` writes a line a way (processes, shards, dask): seconds from
the line in a journal to the event in the page, of each run; from ``kill -9`` to the word killed, from the same command
to the word running; and what the page says at the end. Needs the extras ``browser``, ``ui`` and ``dask``, and Chromium.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from itertools import groupby
from pathlib import Path
from statistics import median
from time import monotonic, sleep, time
from typing import Any

from playwright.sync_api import Page, sync_playwright

from calibench.bench.store.journal import journals_in
from calibench.bench.store.runs import ResultStore
from calibench.bench.tracking.catalogue import catalogue
from calibench.bench.ui.server import id_of

SWEEP = ["problem=full12,sensor_zero", "optimizer=de,pso", "budget=20000", "seeds=12"]  # 48 runs
WAYS = {
    "processes": [["execution=processes", "execution.n_jobs=2"]],
    "shards": [["shard=1/2"], ["shard=2/2"]],
    "dask": [["execution=dask", "execution.n_jobs=2"]],
}
KILL_AT, LONGEST = 10, 600.0  # runs; seconds
LISTEN = """
window.heard = [];
const Inner = window.EventSource;
window.EventSource = class extends Inner {
  constructor(address) {
    super(address);
    const runs = new Map();
    this.addEventListener("message", (event) => {
      const told = JSON.parse(event.data);
      for (const one of told.curves || []) runs.set(one.problem + one.method, one.runs);
      heard.push([Date.now() / 1000, [...runs.values()].reduce((a, b) => a + b, 0), told.status || told.error]);
    });
  }
};
"""


def watch(way: str, results: Path, page: Page, address: str) -> dict[str, Any]:
    """Return what was seen of one sweep, killed once and begun again."""
    words = [[sys.executable, "-m", "calibench", "run", "-m", *SWEEP, *own, f"study={way}", f"results={results}"]
             for own in WAYS[way]]  # fmt: skip
    carriers = [_start(one) for one in words]
    folder = results / way
    _until(lambda: (folder / "manifest.json").exists() and folder.joinpath("running").exists())
    [entry] = [one for one in catalogue(results) if one.study == way]
    page.goto(f"{address}/study/{id_of(entry)}/live")
    written: dict[int, float] = {}  # when so many runs were there first
    seen: dict[str, float] = {}
    try:
        _until(lambda: _note(folder, written) >= KILL_AT, 0.1)
        for carrier in carriers:
            carrier.kill()
            carrier.wait()
        killed = time()
        _until(lambda: _badge(page) == "killed")
        seen["killed_s"] = time() - killed
        again = time()
        carriers = [_start(one) for one in words]
        _until(lambda: _badge(page) == "running")
        seen["running_again_s"] = time() - again
        while any(carrier.poll() is None for carrier in carriers):
            _note(folder, written)
            page.wait_for_timeout(100)
        ended = time()
        _until(lambda: _badge(page) == "done")
        seen["done_s"] = time() - ended
    finally:
        for carrier in carriers:
            carrier.kill()
    heard = page.evaluate("heard")
    came = {n: next(at for at, count, _ in heard if count >= n) for n in written if n <= max(h[1] for h in heard)}
    late = sorted(came[n] - written[n] for n in came)
    states = [status for status, _ in groupby(status for _, _, status in heard)]
    return {
        "way": way, "runs": len(ResultStore(folder).finished()), "points": len(late),
        "median_s": round(median(late), 2),
        "p95_s": round(late[int(0.95 * (len(late) - 1))], 2), "most_s": round(late[-1], 2), "states": states,
        "load": os.getloadavg()[0], **{name: round(value, 2) for name, value in seen.items()},
    }  # fmt: skip


def _start(words: list[str]) -> "subprocess.Popen[bytes]":
    return subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def _note(folder: Path, written: dict[int, float]) -> int:
    """Note when runs are seen first; return how many there are. Only journals are looked at: tables come at the end."""
    count = len({state.run_id for reader in journals_in(folder) for state in reader.states()})
    for n in range(max(written, default=0) + 1, count + 1):
        written[n] = time()
    return count


def _badge(page: Page) -> str:
    page.wait_for_timeout(50)  # the driver reads what the page says
    return page.locator("h1 .state").inner_text()


def _until(what: Any, every: float = 0.05) -> None:
    began = monotonic()
    while not what():
        if monotonic() - began > LONGEST:
            raise TimeoutError("it has not come in ten minutes")
        sleep(every)


def main(out: Path, ways: list[str]) -> None:
    """Watch each way in a results folder of its own, by one server."""
    with tempfile.TemporaryDirectory() as scratch, sync_playwright() as driver, out.open("a") as lines:
        results = Path(scratch)
        server = subprocess.Popen(
            [sys.executable, "-m", "calibench", "ui", str(results), "port=0"], stdout=subprocess.PIPE, text=True
        )
        try:
            assert server.stdout is not None
            address = server.stdout.readline().split()[1]
            chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))))
            browser = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
            context = browser.new_context()
            context.add_init_script(LISTEN)
            page = context.new_page()
            page.goto(address)
            for way in ways:
                line = watch(way, results, page, address.partition("/?")[0])
                print(json.dumps(line), file=lines, flush=True)
                print(json.dumps(line), flush=True)
            browser.close()
        finally:
            server.send_signal(signal.SIGINT)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:] or list(WAYS))
