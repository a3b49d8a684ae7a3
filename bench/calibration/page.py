"""The page of one calibration: what an owner of an arm reads first, drawings inside, nothing fetched."""

import json
from math import degrees, isfinite
from pathlib import Path

from calibench.bench.calibration.figures import calibration_figures
from calibench.bench.calibration.words import headline, level_rows, rows_of_changes, rows_of_frame, sentences
from calibench.bench.provenance.environment import provenance
from calibench.bench.report.shared.drawing import save
from calibench.bench.report.shared.page import Head, Table, inline_svg, render
from calibench.bench.store.atomic_file import write_whole
from calibench.calibration.calibrate import Calibration, Part
from calibench.core.words import plain

_TEMPLATE = "calibration/templates/calibration.html.j2"
_MOST_WILD = 50


def write_page(answer: Calibration, folder: Path) -> Path:
    """Write ``figures/`` and ``report.html`` of a calibration into `folder`; return the page's path."""
    drawings = {}
    for name, drawing in calibration_figures(answer):
        svg = save(name, drawing, folder / "figures")[0].read_text(encoding="utf-8")
        drawings[name] = inline_svg(svg, name)

    heads = ["free in the fit", "rms [mm]", "95 %", "median", "largest"]
    heads += ["rotation [mrad]"] if any(isfinite(one.rotation) for one in answer.levels) else []
    heads += ["sockets apart [mm]"] if any(isfinite(one.spans) for one in answer.levels) else []
    words = {"base": "base of the arm, in the tracker's frame", "target": f"target, on {answer.tip}"}
    frames: list[dict[str, str | Table]] = []
    for name, values in answer.frames.items():
        text = f"x y z {', '.join(f'{value:.3f}' for value in values[:3])} mm"
        if values[3:] and (name == "base" or answer.observed == "pose"):
            text += f"; roll pitch yaw {', '.join(f'{degrees(value):.4f}°' for value in values[3:])}"
        frames.append({"what": words.get(name, f"{name}, on {answer.tip}"), "place": text})
    for frame in (one for one in (answer.camera, answer.board) if one is not None):
        frames.append({"what": f"{frame.child} in {frame.parent}", "table": _table(
            ("number", "value", "standard error", "95 %"), rows_of_frame(frame), ("value", "standard error", "95 %")
        )})  # fmt: skip
    why = ("number", "why")
    badly, undetermined = (
        _table(why, [[one.parameter, one.reason] for one in answer.undetermined if isfinite(one.known_to) == finite])
        for finite in (True, False)
    )
    origin = provenance()
    versions = json.loads(origin["versions"])
    turned = f", {plain(1e3 * answer.scatter[1], 3)} mrad" if answer.observed == "pose" else ""
    page = render(
        _TEMPLATE, title=f"{answer.case}: how true is the arm, and what is it off by?", described=answer.source,
        better=answer.chosen != "frames", headline=_sentence(headline(answer)),
        said=[_sentence(said) for said in sentences(answer)], levels=_table(heads, level_rows(answer), heads[1:]),
        changes=_table(("joint", "what", "changed by", "95 %"), rows_of_changes(answer), ("changed by", "95 %")),
        badly=badly, tolerance=plain(answer.tolerance, 2), undetermined=undetermined,
        regions=_parts(answer.regions), by_joint=_parts(answer.by_joint),
        wild=_table(("reading", "error [mm]"), [[w.row, plain(w.error, 3)] for w in answer.wild[:_MOST_WILD]]),
        frames=frames, notes=[_sentence(note.text) for note in answer.notes], files=answer.files,
        facts={
            answer.source: str(answer.arm.path), "chain": f"{answer.base} to {answer.tip}: {', '.join(answer.joints)}",
            "read": answer.observed if answer.camera is None else "the board's pose in the camera",
            "scatter that is left": f"{plain(answer.scatter[0], 3)} mm a coordinate{turned}",
            "commit": origin["git_commit"],
            "versions": ", ".join(f"{name} {version}" for name, version in versions.items() if version),
            "computing time": f"{answer.seconds:.2f} s",
        },
        drawings=drawings,
    )  # fmt: skip
    return write_whole(folder / "report.html", lambda file: file.write(page.encode()))


def _sentence(text: str) -> str:
    """Return a remark with a full stop, and a capital where it opens with a word: a column or a file keeps its name."""
    plain = text.partition(" ")[0].isalpha()
    return f"{text[:1].upper() if plain else text[:1]}{text[1:]}."


def _parts(parts: tuple[Part, ...]) -> Table:
    rows = [[p.where, str(p.poses), f"{p.before:.3f}", f"{p.after:.3f}"] for p in parts]
    return _table(("where", "poses", "before [mm]", "after [mm]"), rows, ("poses", "before [mm]", "after [mm]"))


def _table(heads: tuple[str, ...] | list[str], rows: list[list[str]], right: tuple[str, ...] | list[str] = ()) -> Table:
    return Table([Head(head, "n" if head in right else "") for head in heads], rows, "fit", blocks=True)
