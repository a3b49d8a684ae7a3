"""Paragraphs, lists and tables of a page in Markdown, filled to the width of the documents."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence

_WIDTH = 118


def text(paragraph: str) -> str:
    """Return a paragraph, its white space made even."""
    return textwrap.fill(" ".join(paragraph.split()), _WIDTH, break_long_words=False, break_on_hyphens=False)


def bullets(*items: str) -> str:
    """Return a list, an item an argument."""
    return "\n".join(
        textwrap.fill(
            " ".join(item.split()),
            _WIDTH,
            initial_indent="- ",
            subsequent_indent="  ",
            break_long_words=False,
            break_on_hyphens=False,
        )
        for item in items
    )


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of cells that are Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
