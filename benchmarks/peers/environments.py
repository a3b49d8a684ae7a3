"""An environment for each peer, made from its pinned requirements; where that fails, the installer's word on it.

They stand below the results, outside the sources, and are made anew when their requirements change. Packages come from
PyPI by pip as it is set up here.
"""

from __future__ import annotations

import re
import subprocess
import sys
import venv
from dataclasses import dataclass
from hashlib import blake2b
from importlib.metadata import version as installed_version
from pathlib import Path

TOOLS = Path(__file__).with_name("tools")
_OURS = "# what all are given"  # below this line stand packages that are not the peer's


@dataclass(frozen=True)
class Environment:
    """Where a tool runs, and its version; `error` is the installer's where there is no such place."""

    tool: str
    version: str
    python: Path
    script: Path
    error: str = ""


def ours() -> Environment:
    """Return the environment this process runs in."""
    return Environment(
        "ours", f"calibench {installed_version('calibench')}", Path(sys.executable), TOOLS / "ours_peer.py"
    )


def peers() -> list[str]:
    """Return the names of all peers: those with a file of requirements."""
    return sorted(path.stem for path in TOOLS.glob("*.txt"))


def build(tool: str, folder: Path, tools: Path = TOOLS) -> Environment:
    """Return the environment of a peer in `folder`, made where it is not there or its requirements have changed."""
    requirements = tools / f"{tool}.txt"
    place, ready = folder / tool, folder / f"{tool}.ready"
    python = place / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    digest = blake2b(requirements.read_bytes(), digest_size=8).hexdigest()
    made = Environment(tool, wanted(requirements), python, tools / f"{tool}_peer.py")
    if ready.exists() and ready.read_text() == digest:
        return made
    venv.create(place, with_pip=True, clear=True)
    if error := install(python, requirements):
        return Environment(tool, made.version, python, made.script, error)
    frozen = subprocess.run([python, "-m", "pip", "freeze"], capture_output=True, text=True, check=True).stdout
    (folder / f"{tool}.installed.txt").write_text(frozen)
    ready.write_text(digest)
    return made


def wanted(requirements: Path) -> str:
    """Return the peer's own packages and versions, as its requirements pin them."""
    lines = requirements.read_text().partition(_OURS)[0].splitlines()
    return ", ".join(line.replace("==", " ") for line in lines if line and not line.startswith("#"))


def install(python: Path, requirements: Path) -> str:
    """Install what is required; return what pip says went wrong, and nothing where nothing did."""
    command = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "-r", requirements]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode == 0:
        return ""
    said = [line for line in done.stderr.splitlines() if line.lower().lstrip().startswith("error")] or [
        "pip says nothing"
    ]
    return _without_places(f"{said[-1].strip()} (exit code {done.returncode})")


def _without_places(text: str) -> str:
    """Return what pip said without addresses and paths: they are of one machine."""
    return re.sub(r"(\w+://|(?<!\w)/)[^\s,;)]+", "...", text)
