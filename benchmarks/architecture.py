"""The picture of the rooms, the list of all files and the sizes of the package, made from the code.

``python -m benchmarks.architecture`` writes docs/images/rooms.svg; the list of files is a page of the built site; with
``sizes`` it prints how large the package is and how its modules hang together.

A room is a package, or a folder inside one. `room_imports` reads the import statements of every module with `ast`. A
band is a package, a box a folder of it; each stands above all that it imports, so every line runs downwards. Rooms that
import each other in a circle stand side by side, joined in red. A line that others lead along is left out. The data of
the picture stand in the picture itself, and a test holds them to the code.
"""

from __future__ import annotations

import ast
import json
import re
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from statistics import median
from xml.sax.saxutils import escape

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs" / "images" / "rooms.svg"
PACKAGES = ("plot", "testing", "bench", "discrepancy", "problems", "optimizers", "calibration", "core")
_WIDE, _HIGH, _GAP, _DROP = 122, 30, 16, 34  # of a box, and between boxes and rows, in px
_COLOURS = ("#fbe3ef", "#f2e6ff", "#e3eefc", "#e4f5e9", "#fff3d6", "#fdeae4", "#e6f3f5", "#eeeeee")
Imports = dict[str, tuple[str, ...]]


def room_imports() -> Imports:
    """Return room -> the rooms it imports, by name; what a package holds in no folder is the room ``package``."""
    found: dict[str, set[str]] = {}
    for package in PACKAGES:
        top = _place(package)
        for path in sorted(top.rglob("*.py")):
            room = _room(f"calibench.{package}." + ".".join(path.relative_to(top).with_suffix("").parts))
            targets = {_room(name) for name in _read(path)[1]}
            found.setdefault(room, set()).update(targets - {room, ""})
    return {room: tuple(sorted(targets & set(found))) for room, targets in sorted(found.items())}


def _place(package: str) -> Path:
    """Return the folder of a package, beside calibench/ or in it; not by a link, which a clone may lack."""
    return ROOT / package if (ROOT / package).is_dir() else ROOT / "calibench" / package


@cache
def _read(path: Path) -> tuple[str | None, tuple[str, ...]]:
    """Return the docstring of a module and the full names that it imports."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return ast.get_docstring(tree), tuple(_imported(tree))


def _imported(tree: ast.AST) -> Iterator[str]:
    """Yield the full names that a module imports from this package, those of functions and classes among them."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


def _room(name: str) -> str:
    """Return the room of a module or of what it holds: ``bench.sweep`` for ``calibench.bench.sweep.costs``; or ""."""
    whole, *parts = name.split(".")
    if whole != "calibench" or not parts or parts[0] not in PACKAGES:
        return ""
    inside = len(parts) > 1 and (_place(parts[0]) / parts[1] / "__init__.py").exists()
    return ".".join(parts[: 1 + inside])


def circles(imports: Imports) -> list[tuple[str, ...]]:
    """Return the rooms that import each other, directly or through others, a tuple each."""
    reach = reached(imports)
    found = {tuple(sorted({room, *(r for r in reach[room] if room in reach[r])})) for room in imports}
    return sorted(circle for circle in found if len(circle) > 1)


def reached(imports: Imports) -> dict[str, set[str]]:
    """Return room -> all rooms that it imports, directly or through others."""
    reach = {room: set(targets) for room, targets in imports.items()}
    for _ in imports:
        for targets in reach.values():
            targets |= {far for near in targets for far in reach[near]}
    return reach


def inside(imports: Imports, package: str) -> Imports:
    """Return the part of `imports` that lies between the folders of one package."""
    own = [room for room in imports if room.startswith(f"{package}.")]
    return {room: tuple(target for target in imports[room] if target in own) for room in own}


def levels(imports: Imports) -> dict[str, int]:
    """Return room -> its level: 0 imports nothing, any other stands above all that it imports but its own circle."""
    reach = reached(imports)
    done: dict[str, int] = {}

    def level(room: str) -> int:
        if room not in done:
            below = [target for target in imports[room] if room not in reach[target]]
            ours = [r for r in reach[room] if room in reach[r]]
            below += [target for other in ours for target in imports[other] if room not in reach[target]]
            done[room] = 1 + max((level(each) for each in below), default=-1)
        return done[room]

    return {room: level(room) for room in imports}


def lines(imports: Imports) -> list[tuple[str, str]]:
    """Return the imports that no other way leads along: what has to be drawn so that the rest can be read off."""
    reach = reached(imports)
    return [
        (room, target)
        for room, targets in imports.items()
        for target in targets
        if not any(
            target in reach[other] and room not in reach[other] and other not in reach[target]
            for other in targets
            if other != target
        )
    ]


def packages_of(imports: Imports, package: str) -> list[str]:
    """Return the other packages that a package imports."""
    own = [targets for room, targets in imports.items() if room.split(".")[0] == package]
    return [p for p in PACKAGES if p != package and any(t.split(".")[0] == p for targets in own for t in targets)]


def draw(imports: Imports) -> str:
    """Return the picture: a band a package, its folders as boxes above what they import."""
    bands, boxes, height = [], {}, 8.0
    width = max(_row_width(inside(imports, package)) for package in PACKAGES) + 40
    for package, colour in zip(PACKAGES, _COLOURS, strict=True):
        own = inside(imports, package)
        rows = _rows(levels(own))
        tall = 34 + len(rows) * (_HIGH + _DROP) - (_DROP - 12 if rows else 4)
        below = packages_of(imports, package)
        said = f"imports {', '.join(below)}" if below else "imports none of the others"
        bands.append(
            f'<rect x="4" y="{height:g}" width="{width - 8:g}" height="{tall}" rx="6" fill="{colour}" stroke="#999"/>'
            f'<text x="16" y="{height + 20:g}" font-weight="bold">{package}</text>'
            f'<text x="{width - 16:g}" y="{height + 20:g}" text-anchor="end" fill="#444">{said}</text>'
        )
        for k, row in enumerate(rows):
            left = (width - len(row) * (_WIDE + _GAP) + _GAP) / 2
            for i, room in enumerate(row):
                boxes[room] = (left + i * (_WIDE + _GAP), height + 34 + k * (_HIGH + _DROP))
        height += tall + 10
    strokes = [_line(boxes[room], boxes[target]) for p in PACKAGES for room, target in lines(inside(imports, p))]
    drawn = [
        f'<rect x="{x:g}" y="{y:g}" width="{_WIDE}" height="{_HIGH}" rx="4" fill="#fff" stroke="#444"/>'
        f'<text x="{x + _WIDE / 2:g}" y="{y + 20:g}" text-anchor="middle" class="room">{room.split(".")[1]}</text>'
        for room, (x, y) in boxes.items()
    ]
    return "\n".join([
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" width="{width:g}" '
        f'height="{height:g}" font-family="sans-serif" font-size="13">',
        "<title>The rooms, and what imports what: every line runs down to what is imported</title>",
        f"<metadata>{escape(json.dumps(imports))}</metadata>",
        '<rect width="100%" height="100%" fill="#fff"/>', *bands, *strokes, *drawn, "</svg>", "",
    ])  # fmt: skip


def read_back(picture: str) -> Imports:
    """Return the imports that a picture was made from."""
    told = json.loads(re.findall(r"<metadata>(.*?)</metadata>", picture, re.DOTALL)[0].replace("&gt;", ">"))
    return {room: tuple(targets) for room, targets in told.items()}


def _rows(level: Mapping[str, int]) -> list[list[str]]:
    """Return the rooms by level, the highest first."""
    return [[r for r in level if level[r] == k] for k in sorted(set(level.values()), reverse=True)]


def _row_width(imports: Imports) -> float:
    return max((len(row) * (_WIDE + _GAP) for row in _rows(levels(imports))), default=0)


def _line(upper: tuple[float, float], lower: tuple[float, float]) -> str:
    (x1, y1), (x2, y2) = upper, lower
    if y1 == y2:  # a circle: they stand side by side
        a, b = sorted((x1, x2))
        middle = y1 + _HIGH / 2
        return f'<path d="M{a + _WIDE:g} {middle:g} L{b:g} {middle:g}" stroke="#c33" stroke-width="2" fill="none"/>'
    a, b, half = x1 + _WIDE / 2, x2 + _WIDE / 2, _DROP / 2
    return (
        f'<path d="M{a:g} {y1 + _HIGH:g} C{a:g} {y1 + _HIGH + half:g} {b:g} {y2 - half:g} {b:g} {y2:g}" '
        'stroke="#557" stroke-width="1.3" fill="none"/>'
    )


def files_listed() -> str:
    """Return the list of all files as Markdown: a fold a folder, under what it holds, with the rooms in order."""
    tops = [*map(_place, sorted(PACKAGES)), ROOT / "benchmarks", ROOT / "conf"]
    folds = []
    for top in tops:
        every = [path for path in top.rglob("*") if path.suffix in (".py", ".yaml") and path.name != "__init__.py"]
        for folder in sorted({path.parent for path in every}):
            lines = "\n".join(f"- `{path.name}`: {_told(path)}" for path in sorted(every) if path.parent == folder)
            own = folder / "__init__.py"
            what = f": {_first_sentence(own)}" if own.exists() else ""
            head = f'<details markdown="1"><summary><code>{folder.relative_to(ROOT)}/</code>{_as_html(what)}</summary>'
            folds.append(f"{head}\n\n{lines}\n\n</details>")
    return "\n".join(folds)


def _told(path: Path) -> str:
    """Return what a file says first of itself: a module its first sentence, a study its description or first remark."""
    if path.suffix == ".py":
        return _first_sentence(path)
    text = path.read_text(encoding="utf-8")
    [said] = re.findall(r"^(?:description: |# )(.*(?:\n# .*)*)", text, re.MULTILINE)[:1]
    return _first_of(said.replace("\n#", "").strip('"'))


def _first_sentence(path: Path) -> str:
    """Return the first sentence of a module's docstring, in one line; raise `ValueError` for a module without one."""
    said, _ = _read(path)
    if not said:
        raise ValueError(f"{path}: a docstring is needed; its first sentence stands in the list of files")
    return _first_of(" ".join(said.split("\n\n")[0].split())).replace("``", "`")


def _first_of(text: str) -> str:
    return re.split(r"(?<!al)\.\s(?=[A-Z`])", text)[0].rstrip(":.")


def _as_html(text: str) -> str:
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", escape(text))


FOLDERS = ("bench", "calibration", "core", "discrepancy", "optimizers", "problems", "conf", "calibench")
_SHORT = 100  # lines, below which a module with one importer is counted
_FEW_ARGUMENTS = 7


def sizes() -> dict[str, float]:
    """Return the sizes of the package: its files are those of `FOLDERS`, none of them through a link."""
    texts = {path: path.read_text(encoding="utf-8") for folder in FOLDERS for path in _sources(ROOT / folder)}
    trees = {path: ast.parse(text) for path, text in texts.items()}
    lines = {path: text.count("\n") for path, text in texts.items()}
    nodes = [node for tree in trees.values() for node in ast.walk(tree)]
    functions = [n.end_lineno - n.lineno + 1 for n in nodes if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)]  # type: ignore[operator]
    imports = sum(n.end_lineno - n.lineno + 1 for n in nodes if isinstance(n, ast.Import | ast.ImportFrom))  # type: ignore[operator]
    total = sum(lines.values())
    importers = _importers(trees)
    single = [path for path, by in importers.items() if len(by) == 1]
    docs = [*(ROOT / "docs").glob("*.md"), ROOT / "README.md"]
    return {
        "lines": total,
        "files": len(texts),
        "folders": len({path.parent for path in texts}),
        "median file": median(lines.values()),
        "longest file": max(lines.values()),
        "functions per 1000 lines": round(1000 * len(functions) / total, 1),
        "median function": median(functions),
        "imports %": round(100 * imports / total, 2),
        "calls with 8 positional arguments": sum(
            isinstance(n, ast.Call) and len(n.args) > _FEW_ARGUMENTS for n in nodes
        ),
        "modules with one importer": len(single),
        "of them below 100 lines": sum(lines[path] < _SHORT for path in single),
        "`told` as a name": sum(_is_told(node) for node in nodes),
        "lines of tests": sum(path.read_text(encoding="utf-8").count("\n") for path in (ROOT / "tests").rglob("*.py")),
        "words of docs": sum(len(path.read_text(encoding="utf-8").split()) for path in docs),
    }


def _sources(folder: Path) -> list[Path]:
    """Return the Python files below a folder, but those behind links."""
    found: list[Path] = []
    for path in sorted(folder.iterdir()) if folder.is_dir() else ():
        if not path.is_symlink():
            found += _sources(path) if path.is_dir() else [path] * (path.suffix == ".py")
    return found


def _importers(trees: Mapping[Path, ast.AST]) -> dict[Path, set[Path]]:
    """Return file -> the files of the package that import it, in functions too."""
    names = {}
    for path in trees:
        parts = path.relative_to(ROOT).with_suffix("").parts
        whole = parts if parts[0] == "calibench" else ("calibench", *parts)
        names[".".join(whole).removesuffix(".__init__")] = path
    by: dict[Path, set[Path]] = {path: set() for path in trees}
    for path, tree in trees.items():
        for name in _imported(tree):
            target = names.get(name) or names.get(name.rpartition(".")[0])
            if target and target != path:
                by[target].add(path)
    return by


def _is_told(node: ast.AST) -> bool:
    names = {ast.Name: "id", ast.arg: "arg", ast.FunctionDef: "name", ast.Attribute: "attr"}
    return any(isinstance(node, kind) and getattr(node, name) == "told" for kind, name in names.items())


if __name__ == "__main__":
    if sys.argv[1:] == ["sizes"]:
        for name, size in sizes().items():
            print(f"{name:<34}{size:>8g}")
    else:
        PICTURE.write_text(draw(room_imports()), encoding="utf-8")
        print(f"{PICTURE}; circles: {circles(room_imports()) or 'none'}")
