"""What the data of a search could not tell, as a section of its page: what went untested or unseen."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from math import isfinite
from typing import Any

from bench.discovery.page.quantity import amount, share
from bench.discovery.page.tables import table_of
from bench.discovery.page.words import effect_words
from discrepancy.report import Candidate

_HARDLY = 0.05  # visible share below which an effect is all but invisible
_BEYOND = {"rad": (1.0, "none below 1 rad"), "1": (1.0, "none below 100 %")}  # sizes that no machine has
_LIMITS = ("effect", "visible share", "smallest size seen")


def limits(report: Mapping[str, Any], candidates: Sequence[Candidate]) -> str:
    """Return the section of the page: not testable, invisible, and the smallest size seen of all candidates."""
    untested = "".join(f"<li>{escape(line)}</li>" for line in _untested(report.get("not_testable", [])))
    hidden = _invisible(report.get("invisible", []), candidates)
    seen = [c for c in candidates if isfinite(c.minimum_detectable)]
    parts = [
        f"<h3>Could not be tested</h3><ul>{untested}</ul>"
        if untested
        else "<p>Every effect of the catalogue could be tested.</p>",
        "<h3>Invisible, or nearly</h3><p>Calibration absorbs these: the parameters move a little and the "
        "residual shows next to nothing. The visible share is what is left of the effect's trace; an effect "
        f"smaller than the last column would have gone unseen.</p>{hidden}"
        if hidden
        else f"<p>Nothing was invisible: calibration leaves {100 * _HARDLY:.0f} % and more of every trace.</p>",
    ]
    if seen:
        shown = " open" if report["verdict"] == "none" else ""  # there, this table is the result
        parts.append(
            f"<details{shown}><summary>The smallest size that would have been seen, for all {len(seen)} candidates"
            f"</summary>{_detectable(seen)}</details>"
        )
    return f"<h2>What these data could not tell</h2>{''.join(parts)}"


def _invisible(invisible: Sequence[Mapping[str, Any]], candidates: Iterable[Candidate]) -> str:
    """Return what calibration absorbs, or all but; empty where everything shows."""
    hidden = {(str(item["family"]), str(item["target"])) for item in invisible}
    rows = [_limit(item["family"], item["target"], item.get("visible_fraction"), *_least(item)) for item in invisible]
    rows += [
        _limit(c.family, c.target, c.visible_fraction, c.minimum_detectable, c.unit)
        for c in sorted(candidates, key=lambda c: (c.family, c.target))
        if c.visible_fraction < _HARDLY and (c.family, c.target) not in hidden
    ]
    return table_of(_LIMITS, rows, "fit", right=_LIMITS[1:])


def _detectable(candidates: Iterable[Candidate]) -> str:
    """Return the smallest size that would have been seen, of all candidates."""
    ranked = sorted(candidates, key=lambda c: (c.family, c.target))
    rows = [_limit(c.family, c.target, c.visible_fraction, c.minimum_detectable, c.unit) for c in ranked]
    return table_of(_LIMITS, rows, "fit", right=_LIMITS[1:])


def _untested(items: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return what could not be tested, a line a reason; reasons that differ by the target's number are one.

    >>> _untested([
    ...     {"family": "backlash", "target": f"joint {i}", "reason": f"needs column dir_{i}"} for i in (1, 2)
    ... ])
    ['backlash of joint 1, 2: needs column dir_i']
    """
    by_reason: dict[str, dict[str, list[str]]] = {}
    for item in items:
        target = str(item["target"])
        reason = re.sub(rf"_{target[-1:]}\b", "_i", str(item["reason"])) if target[-1:].isdigit() else item["reason"]
        by_reason.setdefault(str(reason), {}).setdefault(str(item["family"]), []).append(target)
    return [
        f"{', '.join(_of_targets(family, targets) for family, targets in families.items())}: {reason}"
        for reason, families in by_reason.items()
    ]


def _of_targets(family: str, targets: Sequence[str]) -> str:
    """Return a family with its targets in words, their kind said once."""
    kinds: dict[str, list[str]] = {}
    alone = []
    for target in targets:
        kind, _, which = target.rpartition(" ")
        if kind:
            kinds.setdefault(kind, []).append(which)
        else:
            alone.append(effect_words(family, target))
    said = [effect_words(family, f"{kind} {', '.join(which)}") for kind, which in kinds.items()]
    return ", ".join([*said, *alone])


def _limit(family: str, target: str, fraction: float | None, least: float | None, unit: str) -> list[str]:
    return [
        escape(effect_words(str(family), str(target))),
        "–" if fraction is None else share(float(fraction)),
        escape(_smallest(least, unit)),
    ]


def _smallest(value: float | None, unit: str) -> str:
    """Return the smallest size that would have been seen; one that is no machine's is none."""
    if value is None or not isfinite(value):
        return "none: no size shows"
    most, told = _BEYOND.get(unit, (float("inf"), ""))
    return told if value > most else amount(value, unit)


def _least(item: Mapping[str, Any]) -> tuple[float | None, str]:
    value = item.get("minimum_detectable")
    if isinstance(value, Mapping):
        return float(value["value"]), str(value.get("unit", ""))
    return (None if value is None else float(value)), str(item.get("unit", ""))
