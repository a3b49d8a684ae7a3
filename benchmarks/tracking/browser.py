"""What an automated browser waits for in ``bench ui``.

``python -m benchmarks.tracking.browser RESULTS [STUDY]`` prints a line a screen: seconds from the address to the drawn
page, five times, and the processor's seconds of the server. The first one is of a server that has just begun. Needs the
extras ``browser`` and ``ui``, and Chromium; ``many large`` makes the studies.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from time import perf_counter

from playwright.sync_api import Page, sync_playwright

from calibench.bench.tracking.catalogue import find_study
from calibench.bench.ui.server import id_of

DRAWN = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"


def seconds(page: Page, address: str, sign: str) -> float:
    """Return how long a page takes to be there: until `sign` is in it, or in its frame, and is drawn."""
    began = perf_counter()
    page.goto(address)
    inside = page.frame_locator("iframe.page").locator(sign) if "?page" in address else page.locator(sign)
    inside.first.wait_for()
    page.evaluate(DRAWN)
    return round(perf_counter() - began, 2)


def main(results: Path, study: str) -> None:
    """Time each screen of a server of its own."""
    command = [sys.executable, "-m", "calibench", "ui", str(results), "port=0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server, sync_playwright() as driver:
        assert server.stdout is not None
        address = server.stdout.readline().split()[1]
        base = address.partition("/?")[0]
        chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))))
        browser = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1300, "height": 900})
        screens = {"studies": (address, "tbody tr"), "search": (f"{base}/?q=optimizer%3Dde", "tbody tr")}
        if study:
            own = f"{base}/study/{id_of(find_study(results, study)[1])}"
            screens |= {"page": (f"{own}?page", "svg, canvas"), "runs": (f"{own}/runs", "tbody tr")}
            screens |= {"live": (f"{own}/live", "#counts b")}
        for name, (where, sign) in screens.items():
            before = _cpu(server.pid)
            took = [seconds(page, where, sign) for _ in range(5)]
            cpu = round((_cpu(server.pid) - before) / 5, 2)
            line = {"screen": name, "seconds": took, "server_cpu_s": cpu, "load": os.getloadavg()[0]}
            print(json.dumps(line), flush=True)
        browser.close()
        server.send_signal(signal.SIGINT)


def _cpu(pid: int) -> float:
    found = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(found[11]) + int(found[12])) / os.sysconf("SC_CLK_TCK")


if __name__ == "__main__":
    main(Path(sys.argv[1]), (sys.argv[2:] or [""])[0])
