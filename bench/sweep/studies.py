"""Prepared studies: sweeps that are written in a file, in ``conf/study/`` under a name, or in a user's own file.

``study=NAME`` without such a file is only the name of a folder.
"""

import difflib
import re
from pathlib import Path
from typing import Any

from calibench.bench.sweep.composition import CONF, quoted_text
from calibench.bench.words import RequestError
from calibench.core.plain import LARGEST_YAML, check_yaml
from calibench.core.tables.data_file import read_whole, text_of


def study_preset(name: str) -> dict[str, Any] | None:
    """Return the prepared study of a name or a file, None for a mere folder. Raises `RequestError` for no study."""
    path = Path(name).expanduser() if is_study_file(name) else CONF / "study" / f"{name}.yaml"
    if not is_study_file(name) and ("/" in name or not path.is_file()):
        return None
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

    # each value as the word that a command line would have
    preset: dict[str, Any] = {}
    for key, node in root.value if root is not None and root.id == "mapping" else []:
        word = key.value
        if key.id != "scalar" or word in preset:
            raise RequestError(f"study={name}: line {key.start_mark.line + 1}: each key is one word, and stands once")
        if word in ("description", "sweeps"):
            preset[word] = _raw(node)
        elif node.id == "mapping" and "." not in word:
            first = node.value[0][0].value if node.value else "OPTION"
            raise RequestError(f"study={name}: {word}: one value is needed; write {word}.{first}: VALUE")
        elif node.id == "sequence" and word in _SINGLE:  # a list of what no list can be is a sweep
            preset[word] = ",".join(str(_raw(item)) for item in node.value)
        else:
            is_null = node.id == "scalar" and node.style is None and node.value in _NULL
            preset[word] = str(node.value) if node.id == "scalar" and not is_null else _written(node)

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
    if is_study_file(name) and path.parent != Path():
        preset |= {key: _beside(path.parent, preset[key]) for key in _CLASSES & {*preset}}
        parted = [[word.partition("=") for word in sweep] for sweep in listed]
        preset["sweeps"] = [
            [f"{key}={_beside(path.parent, value) if key in _CLASSES else value}" for key, _, value in sweep]
            for sweep in parted
        ]
    return preset


def _raw(node: Any) -> Any:
    if isinstance(node.value, str):
        return node.value
    if node.id == "sequence":
        return [_raw(item) for item in node.value]
    return {str(key.value): _raw(value) for key, value in node.value}


def _written(node: Any) -> str:
    """Return a node of YAML in Hydra's grammar: in quotes what is in quotes there, or would be something else."""
    if node.id == "mapping":
        return "{" + ",".join(f"{quoted_text(str(key.value))}:{_written(value)}" for key, value in node.value) + "}"
    if node.id == "sequence":
        return "[" + ",".join(map(_written, node.value)) + "]"
    if node.style is None and node.value in _NULL:
        return "null"
    return str(node.value) if node.style is None and _PLAIN.fullmatch(node.value) else quoted_text(node.value)


_NULL = ("", "~", "null", "Null", "NULL")
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
    return name.endswith((".yaml", ".yml"))


def study_names() -> list[str]:
    return sorted(path.stem for path in (CONF / "study").glob("*.yaml"))
