"""The page of one calibration: what an owner of an arm reads first, drawings inside, nothing fetched."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from math import degrees, isfinite
from pathlib import Path

from calibench.bench.calibration.figures import calibration_figures
from calibench.bench.calibration.words import headline, level_rows, rows_of_changes, sentences
from calibench.bench.provenance.environment import provenance
from calibench.bench.report.shared.drawing import save
from calibench.bench.report.shared.page import Head, Table, inline_svg, render
from calibench.bench.store.atomic_file import write_whole
from calibench.calibration.calibrate import Calibration
from calibench.calibration.result import Part, Undetermined
from calibench.core.words import plain

_TEMPLATE = "calibration/templates/calibration.html.j2"
_MOST_WILD = 50


@dataclass(frozen=True)
class _Frame:
    """Where a frame is, in words."""

    what: str
    place: str


def write_page(answer: Calibration, folder: Path) -> Path:
    """Write ``figures/`` and ``report.html`` of a calibration into `folder`; return the page's path."""
    drawings = {}
    for name, drawing in calibration_figures(answer):
        svg = save(name, drawing, folder / "figures")[0].read_text(encoding="utf-8")
        drawings[name] = inline_svg(svg, name)
    text = render(
        _TEMPLATE,
        title=f"{answer.case}: how true is the arm, and what is it off by?",
        described=answer.source,
        better=answer.chosen != "frames",
        headline=_sentence(headline(answer)),
        said=[_sentence(said) for said in sentences(answer)],
        levels=_levels(answer),
        changes=_table(("joint", "what", "changed by", "95 %"), rows_of_changes(answer), ("changed by", "95 %")),
        badly=_kept([one for one in answer.undetermined if one.needs_poses]),
        undetermined=_kept([one for one in answer.undetermined if not one.needs_poses]),
        regions=_parts(answer.regions),
        by_joint=_parts(answer.by_joint),
        wild=_table(("reading", "error [mm]"), [[w.row, plain(w.error, 3)] for w in answer.wild[:_MOST_WILD]]),
        frames=_frames(answer),
        notes=[_sentence(note.text) for note in answer.notes],
        files=answer.files,
        facts=_facts(answer),
        drawings=drawings,
    )
    return write_whole(folder / "report.html", lambda file: file.write(text.encode()))


def _kept(those: Sequence[Undetermined]) -> Table:
    return _table(("number", "why it keeps its value"), [[one.parameter, one.reason] for one in those])


def _sentence(text: str) -> str:
    """Return a remark with a full stop, and a capital where it opens with a word: a column or a file keeps its name."""
    plain = text.partition(" ")[0].isalpha()
    return f"{text[:1].upper() if plain else text[:1]}{text[1:]}."


def _levels(answer: Calibration) -> Table:
    heads = ["free in the fit", "rms [mm]", "95 %", "median", "largest"]
    if any(isfinite(one.rotation) for one in answer.levels):
        heads.append("rotation [mrad]")
    if any(isfinite(one.spans) for one in answer.levels):
        heads.append("sockets apart [mm]")
    return _table(heads, level_rows(answer), heads[1:])


def _parts(parts: tuple[Part, ...]) -> Table:
    rows = [[p.where, str(p.poses), f"{p.before:.3f}", f"{p.after:.3f}"] for p in parts]
    return _table(("where", "poses", "before [mm]", "after [mm]"), rows, ("poses", "before [mm]", "after [mm]"))


def _frames(answer: Calibration) -> list[_Frame]:
    words = {"base": "base of the arm, in the tracker's frame", "target": f"target, on {answer.tip}"}
    frames = []
    for name, values in answer.frames.items():
        place = ", ".join(f"{value:.3f}" for value in values[:3])
        turned = ", ".join(f"{degrees(value):.4f}°" for value in values[3:])
        text = f"x y z {place} mm" + (f"; roll pitch yaw {turned}" if turned and _turned(answer, name) else "")
        frames.append(_Frame(words[name], text))
    return frames


def _turned(answer: Calibration, name: str) -> bool:
    return name == "base" or answer.observed == "pose"


def _facts(answer: Calibration) -> dict[str, str]:
    origin = provenance()
    versions = json.loads(origin["versions"])
    return {
        answer.source: str(answer.arm.path),
        "chain": f"{answer.base} to {answer.tip}: {', '.join(answer.joints)}",
        "read": answer.observed,
        "scatter that is left": f"{plain(answer.scatter[0], 3)} mm a coordinate"
        + (f", {plain(1e3 * answer.scatter[1], 3)} mrad" if answer.observed == "pose" else ""),
        "commit": origin["git_commit"],
        "versions": ", ".join(f"{name} {version}" for name, version in versions.items() if version),
        "computing time": f"{answer.seconds:.2f} s",
    }


def _table(heads: tuple[str, ...] | list[str], rows: list[list[str]], right: tuple[str, ...] | list[str] = ()) -> Table:
    return Table([Head(head, "n" if head in right else "") for head in heads], rows, "fit", blocks=True)
