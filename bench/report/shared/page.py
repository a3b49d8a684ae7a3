"""The parts of pages of any kind: tables that scroll by themselves, drawings that stand inside, and Markdown.

One Jinja2 environment makes all pages: text is escaped, and a value that is missing is an error. A template is named by
its path below ``calibench.bench``; `macros` gives its macros to who builds the cells of a table.
"""

import base64
import re
import textwrap
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Protocol, cast, final

from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup

_HEAVY = 450_000  # characters from which on an SVG goes in as its PNG, where that is smaller
_WIDTH = 118


@final
@dataclass(frozen=True)
class Head:
    """The head of a column: its title, and the class of its cells (`n` numbers, `w` words in one line, `why`)."""

    title: str
    kind: str = ""


@final
@dataclass(frozen=True)
class Table:
    """A table: a cell is text or a macro's `Markup`, a row of one cell a heading; `kind` is its class. With `blocks` a
    row becomes a block of lines on a small screen; a `tall` table scrolls in a box of its own height."""

    heads: Sequence[Head]
    rows: Sequence[Sequence[str]]
    kind: str = ""
    blocks: bool = False
    tall: bool = False


@final
@dataclass(frozen=True)
class Inline:
    """A drawing inside a page, `width` points wide: `svg` is its element from the attributes on, or `png` bytes."""

    name: str
    width: float
    svg: Markup | None = None
    png: str = ""


def inline_svg(svg: str, name: str) -> Inline:
    """Return an SVG file's drawing for use inside a page: no prologue, and ids that no other drawing has."""
    mark = re.sub(r"[^\w.-]", "-", name)
    element = svg[svg.index("<svg") :]
    element = re.sub(r"<metadata>.*?</metadata>", "", element, flags=re.DOTALL)
    element = re.sub(r'\bid="([^"]+)"', rf'id="{mark}-\1"', element)
    element = re.sub(r'(href="#|url\(#)', rf"\g<1>{mark}-", element)
    width = float(element[: element.index(">")].partition('width="')[2].partition("pt")[0] or 0)
    return Inline(name, width, Markup(element.removeprefix("<svg").lstrip()))  # a file that matplotlib wrote


def drawing_inside(path: Path, name: str) -> Inline:
    """Return the drawing of an SVG file for use inside a page; a heavy one as the PNG beside it, where that is less."""
    svg = path.read_text(encoding="utf-8")  # its lines to a hundredth of a point are a third less text
    svg = re.sub(r' (?:d|x|y)="[^"]*"', lambda found: re.sub(r"(?<=\.\d\d)\d+", "", found[0]), svg)
    drawing = inline_svg(svg, name)
    png, size = path.with_suffix(".png"), len(drawing.svg or "")
    coded = base64.b64encode(png.read_bytes()).decode() if size > _HEAVY and png.exists() else ""
    return Inline(name, drawing.width, png=coded) if coded and len(coded) < size else drawing


def render(template: str, **values: Any) -> str:
    """Return the page that `template` makes of `values`. Raises `jinja2.UndefinedError` for a value that is missing."""
    return _environment().get_template(template).render(values)


class Macros(Protocol):
    """The macros of a template as functions: text in, safe `Markup` out."""

    def __getattr__(self, name: str) -> Callable[..., str]: ...


@cache
def macros(template: str) -> Macros:
    return cast(Macros, _environment().get_template(template).module)


@cache
def _environment() -> Environment:
    def source(name: str) -> str:
        return files("calibench.bench").joinpath(*name.split("/")).read_text(encoding="utf-8")

    environment = Environment(
        loader=FunctionLoader(source), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.globals["css"] = lambda name: Markup(source(name))  # a style sheet of ours as it is
    return environment


def text(paragraph: str, first: str = "", rest: str = "") -> str:
    """Return a paragraph, its white space made even, with these words before its first line and each other one."""
    return textwrap.fill(
        " ".join(paragraph.split()), _WIDTH, initial_indent=first, subsequent_indent=rest, break_long_words=False,
        break_on_hyphens=False,
    )  # fmt: skip


def bullets(*items: str) -> str:
    """Return a list, an item an argument."""
    return "\n".join(text(item, "- ", "  ") for item in items)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of cells that are Markdown."""
    return "\n".join("| " + " | ".join(line) + " |" for line in [head, ["---"] * len(head), *rows])
