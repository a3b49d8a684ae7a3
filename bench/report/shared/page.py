"""What all pages share: frame, type, tables that scroll by themselves, marks that read without colour, drawings."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

_HEAVY = 450_000  # characters from which on an SVG goes in as its PNG, where that is smaller

STYLE = """
:root{color-scheme:light}
body{font:15px/1.5 system-ui,sans-serif;margin:2rem auto;max-width:78rem;padding:0 1rem;color:#1a1a1a;background:#fff}
h1{font-size:1.6rem;margin-bottom:.2rem}h2{font-size:1.15rem;margin:2.2rem 0 .5rem}h3{font-size:1rem}
table{border-collapse:collapse;width:100%;font-size:.84rem}td,th{padding:.25rem .5rem;text-align:left;
vertical-align:top;border-bottom:1px solid #ddd}th{border-bottom:2px solid #888;position:sticky;top:0;background:#fff}
td.n,th.n{text-align:right}td.n{font-variant-numeric:tabular-nums;white-space:nowrap}
.v{white-space:nowrap;padding:.05rem .45rem;border-radius:.25rem;border:1px solid #555;display:inline-block}
.ok{background:#d5ecdf;border-color:#009e73}.kind{background:#dbeaf6;border-color:#0072b2}
.misprint{background:#fbeecb;border-color:#e69f00;border-style:dashed}
.no{background:#f8dcc8;border:2px solid #d55e00;font-weight:600}.open{background:#eee;border-style:dotted}
.bar{display:flex;height:1.4rem;margin:.8rem 0;border:1px solid #555}.bar span{display:block;overflow:hidden;
text-align:center;font-size:.8rem;border-radius:0;border:0;border-right:1px solid #555}
small,.why{color:#555}ul{padding-left:1.2rem}li{margin:.3rem 0}details{margin:.4rem 0}summary{cursor:pointer}
dl{display:grid;grid-template-columns:max-content 1fr;gap:.15rem 1rem;font-size:.84rem}
dt{color:#555}dd{margin:0;overflow-wrap:anywhere}@media(max-width:48rem){dl{grid-template-columns:1fr}
dd{margin-bottom:.4rem}}.scroll{overflow-x:auto;background:linear-gradient(90deg,#fff,#fff) 0 0/1.2rem 100% local,
linear-gradient(90deg,#fff,#fff) 100% 0/1.2rem 100% local,linear-gradient(90deg,#bbb,#fff) 0 0/.7rem 100%,
linear-gradient(270deg,#bbb,#fff) 100% 0/.7rem 100%;background-repeat:no-repeat}
@media print{th{position:static}body{font-size:10pt}}
"""


def whole_page(title: str, style: str, heading: str, *parts: str) -> str:
    """Return a page that needs nothing else: `parts` are HTML, `title` and `heading` are text."""
    return "\n".join(
        [
            f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
            f'<meta name="viewport" content="width=device-width,initial-scale=1"><style>{style}</style></head>'
            f"<body><h1>{escape(heading)}</h1>",
            *(part for part in parts if part),
            "</body></html>\n",
        ]
    )


def facts(said: Mapping[str, Any]) -> str:
    """Return what is known as a list of words and values; what is empty is left out."""
    rows = "".join(f"<dt>{escape(str(k))}</dt><dd>{escape(str(v))}</dd>" for k, v in said.items() if v)
    return f"<dl>{rows}</dl>" if rows else ""


def inline_svg(svg: str, name: str) -> str:
    """Return an SVG file's element for use inside a page: no prologue, and names that no other drawing has."""
    element = svg[svg.index("<svg") :]
    element = re.sub(r"<metadata>.*?</metadata>", "", element, flags=re.DOTALL)
    element = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', element)
    element = re.sub(r'(href="#|url\(#)', rf"\g<1>{name}-", element)
    return element.replace("<svg ", '<svg role="img" ', 1)


def rounded(svg: str) -> str:
    """Return an SVG drawing with its lines to a hundredth of a point, which no eye tells apart: a third less text.

    >>> rounded('<path d="M 12.345678 7.5 "/>')
    '<path d="M 12.34 7.5 "/>'
    """
    return re.sub(r' (?:d|x|y)="[^"]*"', lambda found: re.sub(r"(\.\d\d)\d+", r"\1", found[0]), svg)


def drawing_inside(path: Path, name: str) -> tuple[str, float]:
    """Return a drawing for use inside the page, and its width in points; a heavy one as its PNG, where that is less."""
    svg = rounded(path.read_text(encoding="utf-8"))
    element = inline_svg(svg, name)
    head = element[: element.index(">")]
    width = float(head.partition('width="')[2].partition("pt")[0] or 0)
    png = path.with_suffix(".png")
    if len(element) > _HEAVY and png.exists():
        coded = base64.b64encode(png.read_bytes()).decode()
        if len(coded) < len(element):
            return f'<img alt="{escape(name)}" src="data:image/png;base64,{coded}" width="{width * 4 / 3:.0f}">', width
    return element.replace("<svg ", f'<svg aria-label="{escape(name)}" ', 1), width
