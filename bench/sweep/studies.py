"""Prepared studies: sweeps that are written in a file, in ``conf/study/`` under a name, or in a user's own file.

``study=NAME`` without such a file is only the name of a folder.
"""

from __future__ import annotations

import difflib
import re
from pathlib import Path
from typing import Any

from calibench.bench.sweep.composition import CONF, quoted_text
from calibench.bench.sweep.words import RequestError
from calibench.core.plain import LARGEST_YAML, check_yaml
from calibench.core.tables.data_file import read_whole, text_of


def study_preset(name: str) -> dict[str, Any] | None:
    """Return the prepared study ``conf/study/<name>.yaml``, or that of a file of one's own, FILE.yaml.

    None where there is none of that name: then it is only a folder. A class by its file, ``./mine.py:Class``, that
    stands beside the study is told as seen from here. Raises `RequestError` for a file that is missing or is no study.
    """
    path = Path(name).expanduser() if is_study_file(name) else CONF / "study" / f"{name}.yaml"
    if not is_study_file(name) and ("/" in name or not path.is_file()):
        return None
    preset = _read(name, path)
    sweeps = preset.get("sweeps")
    near = difflib.get_close_matches("sweeps", preset, n=1) if sweeps is None else []
    if near:
        raise RequestError(f"study={name}: {near[0]}: did you mean sweeps?")
    listed: list[Any] = sweeps if isinstance(sweeps, list) else []
    words = [word for sweep in listed for word in (sweep if isinstance(sweep, list) else [None])]
    if not listed or not all(isinstance(word, str) and "=" in word for word in words):
        raise RequestError(
            f"study={name}: sweeps: a list of lists of words KEY=VALUE is needed, such as - [problem=full12, "
            'optimizer=de]; a word with a comma stands in quotes: "optimizer=lm,de"'
        )
    found = dict(preset)
    if is_study_file(name) and path.parent != Path():
        found |= {key: _beside(path.parent, found[key]) for key in _CLASSES & {*found}}
        parted = [[word.partition("=") for word in sweep] for sweep in listed]
        found["sweeps"] = [
            [f"{key}={_beside(path.parent, value) if key in _CLASSES else value}" for key, _, value in sweep]
            for sweep in parted
        ]
    return found


def near_study(name: str) -> str:
    """Return the study file of the working folder whose name is near to `name`; "" where there is none."""
    files = {path.name: path for path in sorted(Path().glob("*.y*ml"))}
    near = difflib.get_close_matches(name, [*files, *(path.stem for path in files.values())], n=1)
    return next((file for file, path in files.items() if near and near[0] in (file, path.stem)), "")


def _read(name: str, path: Path) -> dict[str, Any]:
    """Return what stands in a YAML file, each value as the word that a command line would have."""
    from yaml import BaseLoader, YAMLError, compose

    try:
        text = text_of(read_whole(path, LARGEST_YAML))
        check_yaml(text)
        root = compose(text, BaseLoader)
    except FileNotFoundError:
        files = [file.name for file in sorted(path.parent.glob("*.y*ml")) if file.exists()]
        near = difflib.get_close_matches(path.name, files, n=1)
        hint = f"; did you mean {path.with_name(near[0])}?" if near else ""
        raise RequestError(f"study={name}: there is no file {path}{hint}") from None
    except (OSError, ValueError, YAMLError) as error:
        raise RequestError(f"study={name}: cannot be read: {' '.join(str(error).split())}") from None
    if root is None or root.id != "mapping":
        return {}
    # what stands under each key of a study: a word, and under sweeps and description as it is
    found: dict[str, Any] = {}
    for key, node in root.value:
        if key.id != "scalar" or key.value in found:
            raise RequestError(f"study={name}: line {key.start_mark.line + 1}: each key is one word, and stands once")
        found[key.value] = _raw(node) if key.value in ("description", "sweeps") else _word(name, key.value, node)
    return found


def _raw(node: Any) -> Any:
    """Return a node of YAML with its scalars as they were typed."""
    if isinstance(node.value, str):
        return node.value
    if node.id == "sequence":
        return [_raw(item) for item in node.value]
    return {str(key.value): _raw(value) for key, value in node.value}


def _word(name: str, key: str, node: Any) -> str:
    """Return what stands after ``key:`` as a word: YAML's null is null, a list of what no list can be is a sweep."""
    if node.id == "mapping" and "." not in key:
        first = node.value[0][0].value if node.value else "OPTION"
        raise RequestError(f"study={name}: {key}: one value is needed; write {key}.{first}: VALUE")
    if node.id == "sequence" and key in _SINGLE:
        return ",".join(str(_raw(item)) for item in node.value)
    return _written(node) if node.id != "scalar" or _is_null(node) else str(node.value)


def _written(node: Any) -> str:
    """Return a node of YAML in Hydra's grammar: in quotes what is in quotes there, or would be something else."""
    if node.id == "mapping":
        return "{" + ",".join(f"{quoted_text(str(key.value))}:{_written(value)}" for key, value in node.value) + "}"
    if node.id == "sequence":
        return "[" + ",".join(map(_written, node.value)) + "]"
    if _is_null(node):
        return "null"
    return str(node.value) if node.style is None and _PLAIN.fullmatch(node.value) else quoted_text(node.value)


def _is_null(node: Any) -> bool:
    return node.style is None and node.value in ("", "~", "null", "Null", "NULL")


_PLAIN = re.compile(r"[\w.+-]+", re.ASCII)
_CLASSES = {"problem", "optimizer"}
_SINGLE = {*_CLASSES, "budget", "start", "target"}
_FILE = re.compile(r"(?<![\w./~-])[\w.-][\w ./+-]*\.py(?=:)")  # relative, in a list or alone
_WRITABLE = re.compile(r"[\w ./+-]+")  # what Hydra takes without quotes, and inside them


def _beside(home: Path, value: Any) -> Any:
    """Return the choice `value` with paths from the working folder for class files that stand in `home`."""

    def seen(found: re.Match[str]) -> str:
        file = home / found[0]
        return file.as_posix() if file.is_file() and _WRITABLE.fullmatch(file.as_posix()) else found[0]

    return _FILE.sub(seen, value) if isinstance(value, str) else value


def is_study_file(name: str) -> bool:
    """Tell whether ``study=`` names a file."""
    return name.endswith((".yaml", ".yml"))


def study_names() -> list[str]:
    """Return the names of the prepared studies."""
    return sorted(path.stem for path in (CONF / "study").glob("*.yaml"))
