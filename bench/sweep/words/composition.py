"""Hydra's composition of conf/config.yaml with overrides, as plain containers.

Hydra itself is loaded for what is more than plain words (`bench.sweep.words.plain_words`).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cache
from hashlib import blake2b
from pathlib import Path
from typing import Any

from calibench import conf, optimizers, problems
from calibench.bench.sweep.execution import check_name, check_option
from calibench.bench.sweep.words.hydra_overrides import in_ascii, values_of
from calibench.bench.sweep.words.plain_words import compose_plainly
from calibench.bench.sweep.words.values import RequestError
from calibench.core.kept import kept
from calibench.core.registry import Registry
from calibench.core.user_file import is_file_path

CONF = Path(conf.__file__).resolve().parent
REGISTERED = "registered-name"  # the key of a member's name in its node: no option of Python is called so
NOT_GIVEN = "???"  # Hydra's mark of an option without a default that nobody gave


def compose(overrides: Sequence[Any]) -> Any:
    """Return the composition of overrides, parsed or text; of a list its first value."""
    return compose_texts([o if isinstance(o, str) else f"{o.key_or_group}={values_of(o)[0]}" for o in overrides])


def compose_texts(overrides: list[str]) -> Any:
    """Return the composition of conf/config.yaml with `overrides`, as plain containers."""
    given = dict(override.partition("=")[::2] for override in overrides)
    for key in ("execution", "execution.name"):
        if key in given:
            check_name(given[key])
    for key in given:
        if key.startswith("execution.") and key != "execution.name":
            check_option(given.get("execution.name", given.get("execution", "serial")), key.partition(".")[2])
    plainly = compose_plainly(overrides, _settings, _member)
    return compose_by_hydra(overrides) if plainly is None else plainly


def compose_by_hydra(overrides: list[str]) -> Any:
    """Return likewise what Hydra makes of `overrides`, whatever they are. Raises `RequestError` in one line."""
    import hydra
    from hydra.errors import HydraException
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    _initialize()
    for (kind, name), node in _ENTERED.items():
        if any(o.startswith(f"{kind}=") and name in o for o in overrides):  # Hydra copies all that it knows each time
            _enter(kind, name, node)
    try:
        texts = ["=".join((in_ascii(key), value)) for key, _, value in (o.partition("=") for o in overrides)]
        return _as_named(OmegaConf.to_container(hydra.compose("config", overrides=texts), resolve=True))
    except (HydraException, OmegaConfBaseException) as error:
        raise RequestError(f"{_at_fault(error, overrides)}{_first_line(error)}") from None


def _settings(execution: str) -> Any:
    """Return Hydra's composition of conf/config.yaml with one of conf/execution/, kept between processes."""
    sources = (CONF / "config.yaml", CONF / "execution" / f"{execution}.yaml")
    about = tuple(path.read_bytes() for path in sources)
    return kept("settings", about, lambda: compose_by_hydra([f"execution={execution}"]))


def _member(kind: str, name: str) -> dict[str, Any] | None:
    """Return the node of a registered name, with its options; None for a preset, or what no registry has."""
    if (CONF / kind / f"{name}.yaml").exists():
        return None
    if (kind, name) in _ENTERED:
        return _ENTERED[kind, name]
    registry = registry_of(kind)
    return _node(name, registry) if name in registry else None


def _as_named(composed: Any) -> Any:
    """Return what Hydra composed, with the names of options as they are."""
    if isinstance(composed, list):
        return [_as_named(item) for item in composed]
    if not isinstance(composed, dict):
        return composed
    named = {re.sub(r"__u([0-9a-f]+)__", lambda found: chr(int(found[1], 16)), str(k)): v for k, v in composed.items()}
    return {key: _as_named(value) for key, value in named.items()}


@cache
def _initialize() -> None:
    """Tell Hydra where conf/ is and enter every registered name into its groups."""
    from hydra import initialize_config_dir
    from hydra.core.global_hydra import GlobalHydra

    GlobalHydra.instance().clear()
    initialize_config_dir(str(CONF), job_name="bench", **({"version_base": "1.3"} if _is_1_3() else {}))  # 1.4 warns
    for kind in ("problem", "optimizer"):
        for name in registry_of(kind).names():
            _enter(kind, name, _node(name, registry_of(kind)))


def enter(kind: str, name: str, registry: Registry[Any]) -> None:
    """Let ``kind=name`` be composed, with the options that `registry` declares of `name`."""
    _ENTERED[kind, entered(name)] = _node(name, registry)


_ENTERED: dict[tuple[str, str], dict[str, Any]] = {}  # what is not in Hydra's groups from the start


def _enter(kind: str, name: str, node: dict[str, Any]) -> None:
    """Enter a node into Hydra's group `kind`."""
    from hydra.core.config_store import ConfigStore

    again: dict[str, Any] = {} if _is_1_3() else {"replace": True}  # 1.4 asks for what 1.3 does
    ConfigStore.instance().store(group=kind, name=name, node={in_ascii(k): v for k, v in node.items()}, **again)


def _node(name: str, registry: Registry[Any]) -> dict[str, Any]:
    """Return a registered name with its options and their defaults, as Hydra's node."""
    declared = registry.options(name)
    return {REGISTERED: name, **{k: NOT_GIVEN if o.required else plain(o.default) for k, o in declared.items()}}


def _is_1_3() -> bool:
    """Tell whether this is Hydra 1.3; 1.4 takes the same requests, some by other arguments."""
    from hydra import __version__

    return __version__.startswith("1.3.")


def entered(name: str) -> str:
    """Return what Hydra's group calls a registered name: of a file, whose path is no name in a group, a digest."""
    return f"file_{blake2b(name.encode(), digest_size=8).hexdigest()}" if is_file_path(name) else name


def plain(value: Any) -> Any:
    """Return a default as Hydra's node: null for a mapping, whose keys Hydra would otherwise close, and for objects."""
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value if isinstance(value, str | int | float | bool) else None


def registry_of(kind: str) -> Registry[Any]:
    """Return the registry of problems or of optimizers."""
    return problems.registry if kind == "problem" else optimizers.registry


def _at_fault(error: Exception, overrides: Sequence[str]) -> str:
    """Return the argument that an error is about, before a colon; '' where none is known."""
    key = getattr(error, "full_key", None)
    typed = [re.sub(r"\\(.)", r"\1", text) for text in overrides]
    named = [text for text in typed if text.partition("=")[0] == key]
    found = named or [text for text in typed if "${" in text]
    return f"{found[0]}: " if found else ""


def _first_line(error: Exception) -> str:
    cause = error.__cause__ if error.__cause__ is not None else error
    return str(cause).strip().splitlines()[0]
