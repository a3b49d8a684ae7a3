"""What a newcomer has: a clone, an empty home, an environment of its own, and the commands of the pages.

A step is told with its seconds as it ends, and the total at the end. Nothing of the caller's environment is handed on
but the way to the installer's index and the path of the system's programs.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

_KEPT = ("PATH", "SYSTEMROOT", "SSL_CERT_FILE", "REQUESTS_CA_BUNDLE", "HTTP_PROXY", "HTTPS_PROXY", "NO_PROXY")
_INSTALLER = ("PIP_", "UV_")  # where packages come from, where that is not the usual place


class Newcomer:
    """A folder with a clone of `repository`, ``calibench``, and an environment, ``env``; commands are given there."""

    def __init__(self, repository: Path, folder: Path) -> None:
        self.folder, self.began = folder, time.monotonic()
        home = folder / "home"
        home.mkdir()
        kept = {k: v for k, v in os.environ.items() if k.upper() in _KEPT or k.startswith(_INSTALLER)}
        settings = Path.home() / ".config" / "pip" / "pip.conf"
        if settings.exists():
            kept.setdefault("PIP_CONFIG_FILE", str(settings))
        self.environment = kept | {"HOME": str(home), "USERPROFILE": str(home), "MPLBACKEND": "Agg"}
        self.run("git", "clone", "--quiet", str(repository), "calibench")
        told = self.line_of("README.md", "git clone URL calibench && ")
        self.run(sys.executable, "-m", "venv", "env")
        programs = folder / "env" / ("Scripts" if os.name == "nt" else "bin")
        self.environment["PATH"] = f"{programs}{os.pathsep}{kept['PATH']}"
        self.run(*shlex.split(told)[5:])

    def run(self, *command: str) -> str:
        """Run a command, tell what it took, return what it printed; raise `SystemExit` with its words if it fails."""
        began = time.monotonic()
        program = _found(command[0], self.environment["PATH"])
        done = subprocess.run(
            [program, *command[1:]], cwd=self.folder, env=self.environment, capture_output=True, text=True, check=False
        )
        self.tell(began, " ".join(command))
        if done.returncode:
            raise SystemExit(f"failed ({done.returncode}): {' '.join(command)}\n{done.stdout}\n{done.stderr}")
        return done.stdout

    def line_of(self, page: str, begin: str) -> str:
        """Return the one command of a page that begins so, without its comment."""
        lines = {line.removeprefix("$ ") for line in self.page(page).splitlines()}
        found = [line.partition("  #")[0].rstrip() for line in lines if line.startswith(begin)]
        if len(found) != 1:
            raise SystemExit(f"{page}: {len(found)} commands begin with {begin!r}")
        return found[0]

    def do(self, page: str, begin: str) -> str:
        """Give the command of a page that begins so."""
        return self.run(*shlex.split(self.line_of(page, begin)))

    def tell(self, since: float, what: str) -> None:
        """Print how long something took."""
        print(f"{time.monotonic() - since:7.1f} s  {what.splitlines()[0]}", flush=True)

    def save(self, name: str, text: str) -> None:
        """Save a file in the folder, as a page says."""
        (self.folder / name).write_text(text, encoding="utf-8")

    def code(self, page: str, word: str) -> str:
        """Return the one block of Python of a page that holds `word`."""
        found = [b for b in re.findall(r"```python[^\n]*\n(.*?)```", self.page(page), re.DOTALL) if word in b]
        if len(found) != 1:
            raise SystemExit(f"{page}: {len(found)} blocks of Python hold {word!r}")
        return found[0]

    def page(self, name: str) -> str:
        """Return the text of a page: files and commands are taken from it, not told again."""
        return (self.folder / "calibench" / name).read_text(encoding="utf-8")

    def needs(self, file: str, *, least: int = 1000) -> None:
        """Raise `SystemExit` unless a file is there with at least so many bytes."""
        path = self.folder / file
        if not path.is_file() or path.stat().st_size < least:
            raise SystemExit(f"{file}: not there, or empty")


def _found(program: str, path: str) -> str:
    found = shutil.which(program, path=path)
    if found is None:
        raise SystemExit(f"{program}: not on this machine")
    return found


def story(title: str, follow: Callable[[Newcomer], None]) -> None:
    """Let a newcomer follow a story with the repository that the command line names (default: this one)."""
    repository = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parents[2]).resolve()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        newcomer = Newcomer(repository, Path(folder))
        follow(newcomer)
        newcomer.tell(newcomer.began, title)
