"""From a calibration to its drawings and its page."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from math import degrees, isfinite
from pathlib import Path

from calibench.bench.calibration.report.page.figures import calibration_figures
from calibench.bench.calibration.report.result import Calibration, Part, Undetermined
from calibench.bench.calibration.report.words import headline, level_rows, rows_of_changes, sentences
from calibench.bench.provenance.environment import provenance
from calibench.bench.report.shared.drawing import save
from calibench.bench.report.shared.page import Head, Table, inline_svg, render
from calibench.bench.store.atomic_file import write_whole
from calibench.core.words import plain

_TEMPLATE = "calibration/report/page/templates/calibration.html.j2"
_MOST_WILD = 50


@dataclass(frozen=True)
class _Frame:
    """Where a frame is, in words."""

    what: str
    place: str


def write_page(found: Calibration, folder: Path) -> Path:
    """Write ``figures/`` and ``report.html`` of a calibration into `folder`; return the page's path."""
    drawings = {}
    for name, drawing in calibration_figures(found):
        svg = save(name, drawing, folder / "figures")[0].read_text(encoding="utf-8")
        drawings[name] = inline_svg(svg, name)
    text = render(
        _TEMPLATE,
        title=f"{found.case}: how true is the arm, and what is it off by?",
        described=found.described,
        better=found.chosen != "frames",
        headline=_sentence(headline(found)),
        said=[_sentence(said) for said in sentences(found)],
        levels=_levels(found),
        changes=_table(("joint", "what", "changed by", "95 %"), rows_of_changes(found), ("changed by", "95 %")),
        badly=_kept([one for one in found.undetermined if one.told_by_more_poses]),
        undetermined=_kept([one for one in found.undetermined if not one.told_by_more_poses]),
        regions=_parts(found.regions),
        by_joint=_parts(found.by_joint),
        wild=_table(("reading", "error [mm]"), [[w.row, plain(w.error, 3)] for w in found.wild[:_MOST_WILD]]),
        frames=_frames(found),
        notes=[_sentence(note) for note in found.notes],
        files=found.files,
        facts=_facts(found),
        drawings=drawings,
    )
    return write_whole(folder / "report.html", lambda file: file.write(text.encode()))


def _kept(those: Sequence[Undetermined]) -> Table:
    return _table(("number", "why it keeps its value"), [[one.parameter, one.reason] for one in those])


def _sentence(said: str) -> str:
    """Return a remark with a full stop, and a capital where it opens with a word: a column or a file keeps its name."""
    plain = said.partition(" ")[0].isalpha()
    return f"{said[:1].upper() if plain else said[:1]}{said[1:]}."


def _levels(found: Calibration) -> Table:
    heads = ["free in the fit", "rms [mm]", "95 %", "median", "largest"]
    if any(isfinite(one.rotation) for one in found.levels):
        heads.append("rotation [mrad]")
    if any(isfinite(one.spans) for one in found.levels):
        heads.append("sockets apart [mm]")
    return _table(heads, level_rows(found), heads[1:])


def _parts(parts: tuple[Part, ...]) -> Table:
    rows = [[p.where, str(p.poses), f"{p.before:.3f}", f"{p.after:.3f}"] for p in parts]
    return _table(("where", "poses", "before [mm]", "after [mm]"), rows, ("poses", "before [mm]", "after [mm]"))


def _frames(found: Calibration) -> list[_Frame]:
    words = {"base": "base of the arm, in the tracker's frame", "target": f"target, on {found.tip}"}
    said = []
    for name, values in found.frames.items():
        place = ", ".join(f"{value:.3f}" for value in values[:3])
        turned = ", ".join(f"{degrees(value):.4f}°" for value in values[3:])
        told = f"x y z {place} mm" + (f"; roll pitch yaw {turned}" if turned and _turned(found, name) else "")
        said.append(_Frame(words[name], told))
    return said


def _turned(found: Calibration, name: str) -> bool:
    return name == "base" or found.observed == "pose"


def _facts(found: Calibration) -> dict[str, str]:
    origin = provenance()
    versions = json.loads(origin["versions"])
    return {
        found.described: found.path,
        "chain": f"{found.base} to {found.tip}: {', '.join(found.joints)}",
        "read": found.observed,
        "scatter that is left": f"{plain(found.scatter[0], 3)} mm a coordinate"
        + (f", {plain(1e3 * found.scatter[1], 3)} mrad" if found.observed == "pose" else ""),
        "commit": origin["git_commit"],
        "versions": ", ".join(f"{name} {version}" for name, version in versions.items() if version),
        "computing time": f"{found.seconds:.2f} s",
    }


def _table(heads: tuple[str, ...] | list[str], rows: list[list[str]], right: tuple[str, ...] | list[str] = ()) -> Table:
    return Table([Head(head, "n" if head in right else "") for head in heads], rows, "fit", blocks=True)
