"""The scripts of the page: the plotting library and our own, inside the page, and the policy that lets only these run.

The library is uPlot (MIT, see ``static/uPlot-LICENSE.txt``); ours are the files of `_OURS`, in this order.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from functools import cache
from importlib.resources import files

from markupsafe import Markup

LIBRARY = "uPlot.iife.min.js"
_OURS = ("state.js", "style.js", "chart.js", "draw.js", "sort.js", "controls.js", "page.js")


@cache
def scripts() -> Sequence[Markup]:
    """Return the texts of the page's scripts: the library, then ours as one."""
    ours = "\n".join(_read(name) for name in _OURS)
    return Markup(_read(LIBRARY)), Markup(f'(function () {{\n"use strict";\n{ours}}})();\n')


@cache
def policy() -> str:
    """Return the content security policy of the page: nothing is fetched, and no script runs but `scripts`."""
    hashes = " ".join(f"'sha256-{_digest(text)}'" for text in scripts())
    return (
        f"default-src 'none'; script-src {hashes}; style-src 'unsafe-inline'; img-src data:; "
        "base-uri 'none'; form-action 'none'"
    )


def licence() -> str:
    """Return the licence of the library."""
    return _read("uPlot-LICENSE.txt").strip()


def _digest(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _read(name: str) -> str:
    return files("calibench.bench").joinpath("report", "study", "explored", "static", name).read_text(encoding="utf-8")
