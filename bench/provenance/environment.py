"""Where a row comes from: commit, versions, platform."""

import json
import platform
import subprocess
import sys
from contextlib import suppress
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, TypedDict

_PACKAGES = ("calibench", "numpy", "scipy", "numba", "nlopt", "pygmo", "pandas", "pyarrow", "hydra-core")
_SUITES = ("coco-experiment", "ioh")  # extras whose functions are problems: told where they are installed


class Provenance(TypedDict):
    """Where a file or row comes from; versions is JSON."""

    git_commit: str
    git_dirty: bool
    versions: str
    platform: str


@cache
def provenance() -> Provenance:
    """Return git_commit, git_dirty (of this package's checkout, else empty), versions (JSON) and platform."""
    root = Path(__file__).resolve().parents[2]
    lines: list[str] = []
    if (root / ".git").exists():
        asked = ["git", "-C", str(root), "status", "--porcelain=v2", "--branch", "--untracked-files=no"]
        with suppress(OSError, subprocess.SubprocessError):
            lines = subprocess.run(asked, capture_output=True, text=True, timeout=10, check=True).stdout.splitlines()
    commit = next((line.split()[-1] for line in lines if line.startswith("# branch.oid ")), "")
    versions = {package: library_version(package) for package in _PACKAGES}
    versions |= {package: version for package in _SUITES if (version := library_version(package))}
    return {
        "git_commit": "" if commit == "(initial)" else commit,
        "git_dirty": any(not line.startswith("#") for line in lines),
        "versions": json.dumps({"python": platform.python_version(), **versions}),
        "platform": f"{sys.platform} {platform.machine()}",
    }


def made_by(command: str) -> dict[str, Any]:
    """Return what the file of a result says of its origin: `command`, now, and `provenance`."""
    return {"command": command, "started_at": datetime.now(UTC).isoformat(timespec="seconds"), **provenance()}


@cache
def library_version(package: str) -> str:
    """Return the installed version of `package`; empty where it is none that is installed."""
    try:
        return version(package)
    except (PackageNotFoundError, ValueError):
        return ""
