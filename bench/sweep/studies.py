"""Prepared studies: sweeps that are written in a file, in ``conf/study/`` under a name, or in a user's own file.

``study=NAME`` without such a file is only the name of a folder.
"""

from __future__ import annotations

import difflib
import re
from pathlib import Path
from typing import Any

from calibench.bench.sweep.words.composition import CONF
from calibench.bench.sweep.words.values import RequestError


def study_preset(name: str) -> dict[str, Any] | None:
    """Return the prepared study ``conf/study/<name>.yaml``, or that of a file of one's own, FILE.yaml.

    None where there is none of that name: then it is only a folder. A class by its file, ``./mine.py:Class``, that
    stands beside the study is told as seen from here. Raises `RequestError` for a file that is missing or is no study.
    """
    path = Path(name).expanduser() if is_study_file(name) else CONF / "study" / f"{name}.yaml"
    if not is_study_file(name) and ("/" in name or not path.is_file()):
        return None
    from omegaconf import OmegaConf
    from yaml import YAMLError

    try:
        preset: Any = OmegaConf.to_container(OmegaConf.load(path))
    except FileNotFoundError:
        raise RequestError(f"study={name}: there is no file {path}{_near_file(path)}") from None
    except (OSError, ValueError, YAMLError) as error:
        raise RequestError(f"study={name}: cannot be read: {' '.join(str(error).split())}") from None
    sweeps = preset.get("sweeps") if isinstance(preset, dict) else None
    near = difflib.get_close_matches("sweeps", preset, n=1) if sweeps is None and isinstance(preset, dict) else []
    if near:
        raise RequestError(f"study={name}: {near[0]}: did you mean sweeps?")
    if not isinstance(sweeps, list) or not sweeps or not all(_is_words(sweep) for sweep in sweeps):
        raise RequestError(
            f"study={name}: sweeps: a list of lists of words KEY=VALUE is needed, such as - [problem=full12, "
            'optimizer=de]; a word with a comma stands in quotes: "optimizer=lm,de"'
        )
    found = {
        key: value if key in ("description", "sweeps") else _word(name, key, value) for key, value in preset.items()
    }
    if is_study_file(name) and path.parent != Path():
        found |= {key: _beside(path.parent, found[key]) for key in _CLASSES & {*found}}
        found["sweeps"] = [[_word_beside(path.parent, word) for word in sweep] for sweep in sweeps]
    return found


def near_study(name: str) -> str:
    """Return the study file of the working folder whose name is near to `name`; "" where there is none."""
    files = {path.name: path for path in sorted(Path().glob("*.y*ml"))}
    near = difflib.get_close_matches(name, [*files, *(path.stem for path in files.values())], n=1)
    return next((file for file, path in files.items() if near and near[0] in (file, path.stem)), "")


def _near_file(path: Path) -> str:
    near = difflib.get_close_matches(path.name, [p.name for p in sorted(path.parent.glob("*.y*ml"))], n=1)
    return f"; did you mean {path.with_name(near[0])}?" if near else ""


def _word(name: str, key: str, value: Any) -> Any:
    """Return what stands after ``key:`` as a word: YAML's null is null, a list of what no list can be is a sweep."""
    if isinstance(value, dict):
        raise RequestError(
            f"study={name}: {key}: one value is needed; write {key}.{next(iter(value), 'OPTION')}: VALUE"
        )
    if isinstance(value, list) and key in _SINGLE:
        return ",".join(map(str, value))
    return "null" if value is None else value


_CLASSES = {"problem", "optimizer"}
_SINGLE = {*_CLASSES, "budget", "start", "target"}
_FILE = re.compile(r"(?<![\w./~-])[\w.-][\w ./+-]*\.py(?=:)")  # relative, in a list or alone
_WRITABLE = re.compile(r"[\w ./+-]+")  # what Hydra takes without quotes, and inside them


def _word_beside(home: Path, word: str) -> str:
    key, _, value = word.partition("=")
    return f"{key}={_beside(home, value)}" if key in _CLASSES else word


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


def _is_words(sweep: Any) -> bool:
    return isinstance(sweep, list) and all(isinstance(word, str) and "=" in word for word in sweep)
