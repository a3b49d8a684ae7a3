"""A small table in HTML: what a notebook shows of a problem, a run, a store or a report."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape


def html_table(title: str, heads: Sequence[str], rows: Iterable[Sequence[object]], most: int = 30) -> str:
    """Return a table with its title above; floats in six digits, and of many rows the first `most`.

    >>> html_table("a < b", [], [[1.0], [2.0]], most=1).partition("<tbody>")[2]
    '<tr><td>1</td></tr></tbody></table>and 1 more</div>'
    """
    listed = list(rows)
    head = "".join(f"<th>{escape(name)}</th>" for name in heads)
    body = "".join("<tr>" + "".join(f"<td>{_cell(cell)}</td>" for cell in row) + "</tr>" for row in listed[:most])
    more = f"and {len(listed) - most} more" if len(listed) > most else ""
    return f"<div><b>{escape(title)}</b><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{more}</div>"


def _cell(value: object) -> str:
    if value is None or value != value:
        return "–"
    return f"{value:.6g}" if isinstance(value, float) else escape(str(value))
