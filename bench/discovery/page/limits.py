"""What the data of a search could not show, as a section of its page: what went untested or unseen."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import final

from calibench.bench.discovery.page.quantity import amount, share
from calibench.bench.discovery.page.tables import table_of
from calibench.bench.discovery.page.words import shortest_words
from calibench.bench.report.shared.page import Table
from calibench.discrepancy.labels import effect_label
from calibench.discrepancy.model.description import last_word
from calibench.discrepancy.model.effect import Untestable
from calibench.discrepancy.registries import family_of
from calibench.discrepancy.report import Candidate, Invisible, Report

_HARDLY = 0.05  # visible share below which an effect is all but invisible
_BEYOND = {  # sizes that no machine has
    "rad": (1.0, "none below 1 rad"),
    "1": (1.0, "none below 100 %"),
    "arcsec": (206265.0, "none below 1 rad"),
}
_ANY = "each of them"  # the subject of a reason that is the same for several targets
_LIMITS = ("effect", "visible share", "smallest size seen")


@final
@dataclass(frozen=True)
class Limits:
    """What went untested, a line a reason; what is `hidden` from any calibration; the smallest size `seen` of all.

    `shortest` tells the shortest waves that were looked for.
    """

    untested: Sequence[str]
    hidden: Table
    seen: Table
    shortest: str = ""
    hardly: str = f"{100 * _HARDLY:.0f} %"


def limits(report: Report) -> Limits:
    """Return the section of the page: not testable, invisible, and the smallest size seen of all candidates."""
    return Limits(
        untested_lines(report.machine, report.not_testable),
        _hidden(report),
        _table(report.machine, _ordered(c for c in report.candidates if isfinite(c.minimum_detectable))),
        shortest_words(report),
    )


def _hidden(report: Report) -> Table:
    """Return the candidates that calibration absorbs fully or nearly; no row where there are none."""
    hidden = {(item.family, item.target) for item in report.invisible}
    hardly = [c for c in report.candidates if c.visible_fraction < _HARDLY and (c.family, c.target) not in hidden]
    return _table(report.machine, [*report.invisible, *_ordered(hardly)])


def _ordered(candidates: Iterable[Candidate]) -> list[Candidate]:
    return sorted(candidates, key=lambda c: (c.family, c.target))


def _table(machine: str, items: Sequence[Candidate | Invisible]) -> Table:
    """Return the smallest size that would have been seen of each item."""
    rows = [
        [
            effect_label(machine, item.family, item.target),
            share(item.visible_fraction) if isfinite(item.visible_fraction) else "–",
            smallest(item.minimum_detectable, item.unit),
        ]
        for item in items
    ]
    return table_of(_LIMITS, rows, "fit", right=_LIMITS[1:])


def untested_lines(machine: str, items: Sequence[Untestable]) -> list[str]:
    """Return what could not be tested, one line for each reason.

    Reasons that differ only by the target's number are one.

    >>> untested_lines("gpm2002", [
    ...     Untestable("backlash", f"joint {i}", f"needs column dir_{i}", (f"dir_{i}",), True) for i in (1, 2)
    ... ])
    ['backlash of joint 1, 2: needs column dir_i']
    """
    by_reason: dict[str, list[Untestable]] = {}
    for item in items:
        by_reason.setdefault(_reason_for_any(machine, item), []).append(item)
    lines = []
    for reason, alike in by_reason.items():
        targets: dict[str, list[str]] = {}
        for item in alike:
            targets.setdefault(item.family, []).append(item.target)
        which = ", ".join(_of_targets(machine, family, of) for family, of in targets.items())
        one = len({item.target for item in alike}) == 1 and reason.startswith(_ANY)
        lines.append(f"{which}: {alike[0].reason if one else reason}")
    return lines


def _reason_for_any(machine: str, item: Untestable) -> str:
    """Return the reason as it is for every target of the family: its own columns under the names of their kind.

    A target that is the subject of its reason is told as each of them.
    """
    family = family_of(machine, item.family)
    kinds = (
        {pattern.format(i=last_word(item.target)): pattern.format(i="i") for pattern in family.columns}
        if family
        else {}
    )
    general = [kinds.get(column, column) for column in item.columns]
    reason = item.reason.replace(", ".join(item.columns), ", ".join(general)) if general else item.reason
    return f"{_ANY} {reason.removeprefix(f'{item.target} ')}" if reason.startswith(f"{item.target} ") else reason


def _of_targets(machine: str, family: str, targets: Sequence[str]) -> str:
    """Return a family with its targets in words; the kind of targets stands once."""
    kinds: dict[str, list[str]] = {}
    alone = []
    for target in targets:
        kind, _, which = target.rpartition(" ")
        if kind:
            kinds.setdefault(kind, []).append(which)
        else:
            alone.append(effect_label(machine, family, target))
    said = [effect_label(machine, family, f"{kind} {', '.join(which)}") for kind, which in kinds.items()]
    return ", ".join([*said, *alone])


def smallest(value: float, unit: str) -> str:
    """Return the smallest size that would have been seen; "" for one that no machine can have."""
    if not isfinite(value):
        return "none: no size shows"
    most, told = _BEYOND.get(unit, (float("inf"), ""))
    return told if value > most else amount(value, unit)
