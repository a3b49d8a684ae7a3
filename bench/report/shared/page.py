"""What goes into a page of any kind: tables that scroll by themselves, and drawings that stand inside it.

`bench.report.shared.templating` sets them, by the macros of ``templates/parts.html.j2``.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import final

from markupsafe import Markup

_HEAVY = 450_000  # characters from which on an SVG goes in as its PNG, where that is smaller


@final
@dataclass(frozen=True)
class Head:
    """The head of a column: its title, and the class of its cells (`n` numbers, `w` words in one line, `why`)."""

    title: str
    kind: str = ""


@final
@dataclass(frozen=True)
class Table:
    """A table: a cell is text, or `Markup` that a macro made. A row of one cell is a heading across all columns.

    `kind` is the class of the table. With `blocks` a row becomes a block of lines on a small screen; a `tall` table
    scrolls in a box of its own height.
    """

    heads: Sequence[Head]
    rows: Sequence[Sequence[str]]
    kind: str = ""
    blocks: bool = False
    tall: bool = False


@final
@dataclass(frozen=True)
class Inline:
    """A drawing inside a page: `svg` is its element from the attributes on, or `png` its coded bytes.

    `width` is in points.
    """

    name: str
    width: float
    svg: Markup | None = None
    png: str = ""

    @property
    def pixels(self) -> int:
        """Return the width in pixels."""
        return round(self.width * 4 / 3)


def inline_svg(svg: str, name: str) -> Inline:
    """Return an SVG file's drawing for use inside a page: no prologue, and ids that no other drawing has."""
    mark = re.sub(r"[^\w.-]", "-", name)
    element = svg[svg.index("<svg") :]
    element = re.sub(r"<metadata>.*?</metadata>", "", element, flags=re.DOTALL)
    element = re.sub(r'\bid="([^"]+)"', rf'id="{mark}-\1"', element)
    element = re.sub(r'(href="#|url\(#)', rf"\g<1>{mark}-", element)
    width = float(element[: element.index(">")].partition('width="')[2].partition("pt")[0] or 0)
    return Inline(name, width, Markup(element.removeprefix("<svg").lstrip()))  # a file that matplotlib wrote


def rounded(svg: str) -> str:
    """Return an SVG drawing with its lines to a hundredth of a point, which no eye tells apart: a third less text.

    >>> rounded('<path d="M 12.345678 7.5 "/>')
    '<path d="M 12.34 7.5 "/>'
    """
    return re.sub(r' (?:d|x|y)="[^"]*"', lambda found: re.sub(r"(\.\d\d)\d+", r"\1", found[0]), svg)


def drawing_inside(path: Path, name: str) -> Inline:
    """Return the drawing of an SVG file for use inside a page; a heavy one as the PNG beside it, where that is less."""
    drawing = inline_svg(rounded(path.read_text(encoding="utf-8")), name)
    png, size = path.with_suffix(".png"), len(drawing.svg or "")
    if size > _HEAVY and png.exists():
        coded = base64.b64encode(png.read_bytes()).decode()
        if len(coded) < size:
            return Inline(name, drawing.width, png=coded)
    return drawing
