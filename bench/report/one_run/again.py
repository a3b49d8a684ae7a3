"""The command that runs one run again by hand, from its row alone."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Mapping
from typing import Any

from calibench import optimizers, problems
from calibench.bench.provenance.run_id import UNSEEN, chosen_options, given_options
from calibench.core.registry import MissingFile, NotImported, Registry, names_of_files

_PLAIN = re.compile(r"[A-Za-z_][\w./:+-]*")
_BEFORE_QUOTE = re.compile(r"\\+(?='|\Z)")  # where Hydra takes two backslashes for one; elsewhere each is itself
_WORDS = {"true", "false", "null", "nan", "inf"}


def again_command(row: Mapping[str, Any]) -> str | None:
    """Return the `bench run` command of this very run: the same run id, the same seed.

    None where no command can say it: an object made in Python, a start of one's own, or published results. Raises
    `NotImported` or `MissingFile` where a class of somebody's own would say which options it was given, and is not
    imported, or not there.
    """
    options = {of: json.loads(row[f"{of}_options"]) for of in ("problem", "optimizer")}
    if row["start"] not in ("nominal", "random") or "published" in options["optimizer"]:
        return None
    words = ["bench", "run"]
    for of, registry in (("problem", problems.registry), ("optimizer", optimizers.registry)):
        if not _is_named(row[of], registry) or any(UNSEEN in str(value) for value in options[of].values()):
            return None
        words.append(f"{of}={row[of]}")
        try:
            with names_of_files():
                registry.options(row[of])
                chosen = chosen_options(registry, row[of], given_options(registry, row[of], options[of]))
                registry.check(row[of], chosen)
        except (NotImported, MissingFile):
            raise
        except ValueError:  # a function or an object, for which the row has a word and no command has
            return None
        words += [f"{of}.{key}={value_text(value)}" for key, value in sorted(chosen.items())]
    repetition = int(row["repetition"])
    words += [f"budget={int(row['budget'])}", f"seeds={repetition}:{repetition + 1}", f"start={row['start']}"]
    if row["target"] is not None and row["target"] == row["target"]:
        words.append(f"target={float(row['target'])!r}")
    return " ".join(shlex.quote(word) for word in [*words, "study=again"])


def value_text(value: Any) -> str:
    """Return an option's value as the command line takes it, text that would be read as something else in quotes.

    >>> value_text(None), value_text(True), value_text([1, 2.5]), value_text("ya2"), value_text("12"), value_text("a b")
    ('null', 'true', '[1,2.5]', 'ya2', "'12'", "'a b'")
    """
    if value is None or isinstance(value, bool):
        return json.dumps(value)
    if isinstance(value, list | tuple):
        return f"[{','.join(map(value_text, value))}]"
    if isinstance(value, Mapping):
        return f"{{{','.join(f'{key}:{value_text(item)}' for key, item in value.items())}}}"
    if isinstance(value, str):
        is_plain = _PLAIN.fullmatch(value) and value.lower() not in _WORDS
        doubled = _BEFORE_QUOTE.sub(r"\g<0>\g<0>", value)
        return value if is_plain else "'" + doubled.replace("'", "\\'") + "'"
    return repr(value)


def _is_named(name: str, registry: Registry[Any]) -> bool:
    """Tell whether the command line finds this: by the registry, or in a file or module by its path."""
    return name in registry or (":" in name and "<" not in name and not name.startswith("__main__"))
