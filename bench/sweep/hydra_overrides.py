"""The words of a command line as Hydra's overrides, and Hydra's composition of them as plain containers."""

from __future__ import annotations

import itertools
import math
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from decimal import Decimal
from functools import cache
from hashlib import blake2b
from pathlib import Path
from typing import Any

from calibench import conf, optimizers, problems
from calibench.bench.sweep.values import RequestError
from calibench.core.registry import Registry, suggest
from calibench.core.user_file import is_file_path

CONF = Path(conf.__file__).resolve().parent
_KEYS = ("problem", "optimizer", "budget", "seeds", "start", "target", "time_limit", "study", "execution", "results")
_AS_TEXT = ("seeds", "results", "study", "problem.readings")  # 0:10 and paths are no Hydra grammar
_NOT_BUILT = {"slurm": "it comes with the back ends for clusters", "ray": "it comes with the back ends for clusters"}


def check_keys(overrides: list[Any]) -> None:
    """Raise `RequestError` at a key that no run has."""
    for o in overrides:
        head = o.key_or_group.partition(".")[0]
        if o.key_or_group in _KEYS or head in ("problem", "optimizer", "execution"):
            continue
        if head in ("prob", "opt") and o.key_or_group.count(".") >= 2:
            continue
        raise RequestError(f"unknown argument {o.key_or_group!r}; {suggest(head, [*_KEYS, 'prob.NAME', 'opt.NAME'])}")


def refuse_lists(overrides: list[Any]) -> None:
    """Raise `RequestError` at a list where one value is meant."""
    for o in overrides:
        if o.is_sweep_override():
            raise RequestError(f"{o.input_line}: a list sweeps; add -m (bench run -m ...)")


def last_value(overrides: list[Any], key: str, default: str) -> str:
    """Return the value of `key` as text, or `default`."""
    from omegaconf import OmegaConf

    values = [str(OmegaConf.create({"value": o.value()})["value"]) for o in overrides if o.key_or_group == key]
    return values[-1] if values else default


def products(overrides: list[Any]) -> Iterator[list[str]]:
    """Yield every choice of one value for each override, as text."""
    for values in itertools.product(*(values_of(o) for o in overrides)):
        yield [f"{o.key_or_group}={value}" for o, value in zip(overrides, values, strict=True)]


def values_of(override: Any) -> list[Any]:
    """Return an override's values as text that Hydra reads back: one, or those of its sweep."""
    from hydra.core.override_parser.types import FloatRange, IntervalSweep, RangeSweep

    value = override.value()
    if isinstance(value, IntervalSweep):
        raise RequestError(f"{override.input_line}: an interval is no list; write range(START,STOP,STEP) or values")
    if isinstance(value, RangeSweep) and not value.step:
        raise RequestError(f"{override.input_line}: a step other than 0 is needed")
    if isinstance(value, RangeSweep) and isinstance(value.range(), FloatRange):
        first, stop, step = (Decimal(f"{number:.15g}") for number in (value.start, value.stop, value.step))
        count = max(0, math.ceil((stop - first) / step))  # in decimals: range(.3,.9,.2) is .3, .5, .7 and not .9
        return [repr(float(first + i * step)) for i in range(count)]
    if override.is_sweep_override():
        return list(override.sweep_string_iterator())
    return [override.get_value_element_as_str()]


def parse(arguments: Sequence[str]) -> list[Any]:
    """Return Hydra's overrides, one for each argument. Raises `RequestError` at what is none, or is given twice."""
    given: dict[str, str] = {}
    for argument in arguments:
        if "=" not in argument:
            raise RequestError(f"{argument!r} is no argument; write KEY=VALUE, such as problem=full12")
        if argument[0] in "+~":
            raise RequestError(f"{argument!r}: + and ~ are not used here; every option is declared (bench list)")
        key = argument.partition("=")[0]
        if not re.fullmatch(r"[\w.:/-]+", key, re.ASCII):
            raise RequestError(f"unknown argument {key!r}; {suggest(key, _KEYS)}")
        if key in given:
            raise RequestError(f"{key} is given twice ({given[key]} and {argument}); give it once")
        given[key] = _with_environment(argument)
    return [replace(_override(text), key_or_group=key, input_line=text) for key, text in given.items()]


def _with_environment(argument: str) -> str:
    """Return `argument` with ${oc.env:NAME} and ${oc.env:NAME,DEFAULT} as if their values had been typed.

    After a backslash it stays as it is. Raises `RequestError` where the variable is not set and has no default.
    """

    def resolve(found: re.Match[str]) -> str:
        name, default = found["name"].strip(), found["default"]
        if name in os.environ:
            return os.environ[name]
        if default is None:
            raise RequestError(f"{argument}: the environment variable {name or '(no name)'} is not set")
        return default.strip()

    resolved = re.sub(r"(?<!\\)\$\{oc\.env:(?P<name>[^,{}]*)(?:,(?P<default>[^{}]*))?\}", resolve, argument)
    left = re.search(r"(?<!\\)\$\{oc\.[^}]*\}?", resolved)
    if left and argument.partition("=")[0] in _AS_TEXT:
        raise RequestError(f"{argument}: {left[0]} cannot be resolved here; only ${{oc.env:NAME}} can")
    return resolved


def _override(argument: str) -> Any:
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.errors import HydraException

    try:
        return OverridesParser.create().parse_override(_quoted(argument))
    except HydraException:  # its words are those of a grammar
        key, _, value = argument.partition("=")
        raise RequestError(
            f"{argument}: the value cannot be read: brackets, braces and quotes must match and commas part something; "
            f'text that holds such characters stands in quotes: "{key}={_text(value)}"'
        ) from None


def _quoted(argument: str) -> str:
    key, _, value = argument.partition("=")
    if key not in _AS_TEXT:
        readable = re.sub(r"[^\w.]|[.]{2,}", "_", key)  # a path of a class or file is no key of Hydra's grammar
        return f"{readable}={value}"
    if len(value) > 1 and value[0] == value[-1] and value[0] in "'\"":
        value = value[1:-1]
    return f"{key}={_text(value)}"


def _text(value: str) -> str:
    """Return `value` as Hydra's quoted text that stands for it to the letter: no escape, no interpolation."""
    value = re.sub(r"(\\*)\$\{", r"\1\1\\${", value)  # OmegaConf reads 2 n + 1 backslashes there as n and a plain ${
    return "'" + re.sub(r"(\\*)('|$)", lambda m: 2 * m[1] + ("\\'" if m[2] else ""), value) + "'"


def compose(overrides: Sequence[Any]) -> Any:
    """Return the composition of overrides, parsed or text; of a list its first value."""
    return compose_texts([o if isinstance(o, str) else f"{o.key_or_group}={values_of(o)[0]}" for o in overrides])


def compose_texts(overrides: list[str]) -> Any:
    """Return Hydra's composition of conf/config.yaml with `overrides`, as plain containers."""
    import hydra
    from hydra.errors import HydraException
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    _initialize()
    for override in overrides:
        key, _, value = override.partition("=")
        if key == "execution":
            choices = sorted(path.stem for path in (CONF / "execution").glob("*.yaml"))
            if value in _NOT_BUILT:
                raise RequestError(f"execution={value} is not built yet: {_NOT_BUILT[value]}")
            if value not in choices:
                raise RequestError(f"execution={value}: {suggest(value, choices)}")
    try:
        return OmegaConf.to_container(hydra.compose("config", overrides=overrides), resolve=True)
    except (HydraException, OmegaConfBaseException) as error:
        raise RequestError(f"{_at_fault(error, overrides)}{_first_line(error)}") from None


@cache
def _initialize() -> None:
    """Tell Hydra where conf/ is and enter every registered name into its groups."""
    from hydra import initialize_config_dir
    from hydra.core.global_hydra import GlobalHydra

    GlobalHydra.instance().clear()
    initialize_config_dir(str(CONF), job_name="bench", **({"version_base": "1.3"} if _is_1_3() else {}))  # 1.4 warns
    for kind in ("problem", "optimizer"):
        for name in registry_of(kind).names():
            enter(kind, name, registry_of(kind))


def enter(kind: str, name: str, registry: Registry[Any]) -> None:
    """Enter a registered name with its declared options into Hydra's group `kind`."""
    from hydra.core.config_store import ConfigStore

    options = {
        key: "???" if option.required else plain(option.default) for key, option in registry.options(name).items()
    }
    again: dict[str, Any] = {} if _is_1_3() else {"replace": True}  # 1.4 asks for what 1.3 does
    ConfigStore.instance().store(group=kind, name=entered(name), node={"name": name, **options}, **again)


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
