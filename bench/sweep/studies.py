"""Prepared studies: sweeps written down, in ``conf/study/`` under a name, or in a file of one's own.

``study=NAME`` without such a file is only the name of a folder.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from calibench.bench.sweep.words.composition import CONF
from calibench.bench.sweep.words.values import RequestError


def study_preset(name: str) -> dict[str, Any] | None:
    """Return the prepared study ``conf/study/<name>.yaml``, or that of a file of one's own, FILE.yaml.

    None where there is none of that name: then it is only a folder. Raises `RequestError` for a file that is missing
    or is no study.
    """
    path = Path(name).expanduser() if is_study_file(name) else CONF / "study" / f"{name}.yaml"
    if not is_study_file(name) and ("/" in name or not path.is_file()):
        return None
    from omegaconf import OmegaConf
    from yaml import YAMLError

    try:
        preset: Any = OmegaConf.to_container(OmegaConf.load(path))
    except FileNotFoundError:
        raise RequestError(f"study={name}: there is no file {path}") from None
    except (OSError, ValueError, YAMLError) as error:
        raise RequestError(f"study={name}: cannot be read: {' '.join(str(error).split())}") from None
    sweeps = preset.get("sweeps") if isinstance(preset, dict) else None
    if not isinstance(sweeps, list) or not sweeps or not all(_is_words(sweep) for sweep in sweeps):
        raise RequestError(
            f"study={name}: sweeps: a list of lists of words KEY=VALUE is needed, such as - [problem=full12, "
            'optimizer=de]; a word with a comma stands in quotes: "optimizer=lm,de"'
        )
    return dict(preset)


def is_study_file(name: str) -> bool:
    """Tell whether ``study=`` names a file."""
    return name.endswith((".yaml", ".yml"))


def study_names() -> list[str]:
    """Return the names of the prepared studies."""
    return sorted(path.stem for path in (CONF / "study").glob("*.yaml"))


def _is_words(sweep: Any) -> bool:
    return isinstance(sweep, list) and all(isinstance(word, str) and "=" in word for word in sweep)
