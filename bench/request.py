"""From the command line to a list of runs: Hydra composes, the registries check, and nothing runs before all is right.

A problem and an optimiser are composed once each, not once a pair: composing takes a tenth of a second.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, final

import conf
import optimizers
import problems
from bedrock.registry import Registry, coerce, suggest
from bench.identity import canonical
from bench.run import (
    Spec,
    Start,
    check_request,
    key_of_optimizer,
    key_of_problem,
    preferred_start,
    repetitions_of,
    run_id,
)
from bench.watch import text_of

CONF = Path(conf.__file__).resolve().parent
_KEYS = ("problem", "optimizer", "budget", "seeds", "start", "target", "time_limit", "study", "execution", "results")
_AS_TEXT = ("seeds", "results", "study", "problem.readings")  # 0:10 and paths are no Hydra grammar
_REPETITIONS = {"ci": 5, "paper": 10}
_NOT_BUILT = {"slurm": "it comes with the back ends for clusters", "ray": "it comes with the back ends for clusters"}


class RequestError(ValueError):
    """A request that makes no sense, in one line."""


@final
@dataclass(frozen=True)
class Request:
    """What was asked for: runs by id in order, where they go, and how they are carried out."""

    specs: Mapping[str, Spec]
    labels: Mapping[str, str]
    folder: Path
    execution: Mapping[str, Any]


@final
@dataclass(frozen=True)
class _Member:
    """A problem or optimiser of the sweep: registry name, options given, the thing built, and its key."""

    name: str
    options: Mapping[str, Any]
    built: Any = field(repr=False)
    key: list[Any] = field(repr=False)

    @property
    def label(self) -> str:
        return self.name + (canonical(self.key[1]) if self.key[1] else "")


def read_request(arguments: Sequence[str], multirun: bool) -> Request:
    """Return the runs that `arguments` (Hydra overrides) ask for. Raises `RequestError` or `ValueError`."""
    overrides = _parse(arguments)
    study = _last_value(overrides, "study", "adhoc")
    if study in ("", ".", "..") or "/" in study or "\0" in study or len(study.encode()) > 200:
        raise RequestError(f"study={study:.40}: the name of one folder inside results= is needed")
    preset = study_preset(study)
    if preset is None:
        sweeps = [overrides]
        if not multirun:
            _refuse_lists(overrides)
    else:
        given = {o.key_or_group for o in overrides}
        common = [f"{key}={value}" for key, value in preset.items() if key not in {"description", "sweeps", *given}]
        sweeps = [
            [*(o for o in _parse([*common, *sweep]) if o.key_or_group not in given), *overrides]
            for sweep in preset["sweeps"]
        ]
    once = [
        o
        for o in (overrides if preset is None else sweeps[0])
        if o.key_or_group.partition(".")[0] in ("execution", "results", "time_limit")
    ]
    settings = _compose(once)
    if any(o.key_or_group == "time_limit" and o.is_sweep_override() for o in once):
        raise RequestError("time_limit: one value is needed, it is the same for all runs")
    time_limit = _read_time_limit(settings["time_limit"])
    specs: dict[str, Spec] = {}
    labels: dict[str, str] = {}
    for sweep in sweeps:
        for spec_id, spec, label in _expand(sweep):
            specs.setdefault(spec_id, replace(spec, time_limit=time_limit))
            labels.setdefault(spec_id, label)
    if not specs:
        raise RequestError("nothing to run: none of the optimizers that glob(...) matches can run these problems")
    folder = Path(str(settings["results"])) / study
    return Request(specs, labels, folder, settings["execution"])


def study_preset(name: str) -> dict[str, Any] | None:
    """Return ``conf/study/<name>.yaml``, or None where there is none: then `name` is only a folder."""
    from omegaconf import OmegaConf

    path = CONF / "study" / f"{name}.yaml"
    if "/" in name or not path.is_file():
        return None
    preset: Any = OmegaConf.to_container(OmegaConf.load(path))
    return dict(preset)


def study_names() -> list[str]:
    """Return the names of the prepared studies."""
    return sorted(path.stem for path in (CONF / "study").glob("*.yaml"))


def build_member(kind: str, arguments: Sequence[str]) -> Any:
    """Return the one problem or optimiser (`kind`) that `arguments` name, with its options."""
    overrides = _parse(arguments)
    _refuse_lists(overrides)
    members = _members(kind, overrides)
    return members[0].built


def _expand(overrides: list[Any]) -> Iterator[tuple[str, Spec, str]]:
    """Yield (run id, spec, label) of one sweep."""
    _check_keys(overrides)
    cells = list(itertools.product(_members("problem", overrides), _members("optimizer", overrides)))
    rest = [o for o in overrides if o.key_or_group in ("budget", "seeds", "start", "target")]
    globbed = any("glob(" in o.input_line for o in overrides if o.key_or_group in ("problem", "optimizer"))
    for choice in _products(rest):
        settings = _compose(choice)
        start, target = _read_start(settings["start"]), _read_target(settings["target"])
        for problem, optimizer in cells:
            budget = _read_budget(settings["budget"], problem)
            wanted = _read_seeds(settings["seeds"])
            try:
                check_request(problem.built, optimizer.built, budget, 0, target)
            except ValueError:
                if globbed:  # asked for whatever can run it
                    continue
                raise
            chosen = preferred_start(problem.built, start)
            label = f"{problem.label} x {optimizer.label}, budget {budget}, {chosen} start"
            for repetition in repetitions_of(optimizer.built, chosen, wanted):
                spec = Spec(
                    problem.name, problem.options, optimizer.name, optimizer.options, budget, repetition, chosen, target
                )
                yield run_id(problem.key, optimizer.key, budget, repetition, chosen, target), spec, label


def _members(kind: str, overrides: list[Any]) -> list[_Member]:
    """Return the problems or optimisers of a sweep, each composed with its own options and built."""
    registry = _registry(kind)
    own = {"problem": "prob", "optimizer": "opt"}[kind]
    choices = [name for o in overrides if o.key_or_group == kind for name in _choices(kind, o)]
    if not choices:
        study = _last_value(overrides, "study", "")
        prepared = f" (study={study} is not a prepared one; {suggest(study, study_names())})" if study else ""
        raise RequestError(f"{kind}=NAME is missing{prepared}; {suggest('', _group(kind))}")
    addressed = {
        o.key_or_group.partition(".")[2].rpartition(".")[0] for o in overrides if o.key_or_group.startswith(f"{own}.")
    }
    for name in addressed - set(choices):
        raise RequestError(f"{own}.{name}: {name} is not in this sweep; {suggest(name, choices)}")
    members = []
    for choice in choices:
        name = _registered_name(kind, choice)
        options = [
            (o.key_or_group.removeprefix(prefix), o)
            for o in overrides
            for prefix in (f"{kind}.", f"{own}.{choice}.")
            if o.key_or_group.startswith(prefix)
        ]
        for option, _ in options:
            registry.option(name, option)
        for values in itertools.product(*(_values(o) for _, o in options)):
            given = [f"{kind}.{option}={value}" for (option, _), value in zip(options, values, strict=True)]
            composed = dict(_compose_texts([f"{kind}={choice}", *given])[kind])
            composed.pop("name")
            declared = registry.options(name)
            chosen = {k: v for k, v in composed.items() if declared[k].required or v != _plain(declared[k].default)}
            try:
                built = registry.make(name, **chosen)
            except ValueError:
                raise
            except Exception as error:
                raise RequestError(
                    f"{kind} {name} cannot be built: {type(error).__name__}: {text_of(error)}"
                ) from error
            key = key_of_problem(built, name) if kind == "problem" else key_of_optimizer(built, name)
            members.append(_Member(name, chosen, built, key))
    return members


def _choices(kind: str, override: Any) -> list[str]:
    """Return the names an override chooses; glob(nlopt_*) stands for all that match."""
    from hydra.core.override_parser.types import Glob

    value = override.value()
    if isinstance(value, Glob):
        names: list[str] = value.filter(_registry(kind).names())
        if not names:
            raise RequestError(f"{override.input_line}: matches no {kind}; {suggest('', _group(kind))}")
        return names
    return [text.replace("\\", "") for text in _values(override)]


def _registry(kind: str) -> Registry[Any]:
    return problems.registry if kind == "problem" else optimizers.registry


def _registered_name(kind: str, choice: str) -> str:
    """Return the registry's name of a choice: itself, or what a preset of ``conf/<kind>/`` is made from."""
    registry = _registry(kind)
    if choice in registry.names() or ":" in choice:
        _store(kind, choice, registry)
        return choice
    if (CONF / kind / f"{choice}.yaml").is_file():
        return str(_compose_texts([f"{kind}={choice}"])[kind]["name"])
    try:
        registry.options(choice)
    except ValueError as error:
        if "unknown" in str(error):
            raise RequestError(f"unknown {kind} {choice!r}; {suggest(choice, _group(kind))}") from None
        raise
    raise AssertionError(choice)


def _group(kind: str) -> list[str]:
    registry = _registry(kind)
    return [*registry.names(), *sorted(path.stem for path in (CONF / kind).glob("*.yaml"))]


def _read_budget(value: Any, problem: _Member) -> int:
    if isinstance(value, str):
        numbers: Mapping[str, int] = getattr(problem.built, "budgets", {})
        if value not in ("ci", "paper"):
            raise RequestError(f"budget={value}: a whole number of evaluations, or the word ci or paper, is needed")
        if value not in numbers:
            raise RequestError(f"budget={value}: problem {problem.name} does not say what {value} means; give a number")
        return numbers[value]
    try:
        budget: int = coerce("budget", value, int)
    except ValueError:
        raise RequestError(
            f"budget={value}: a whole number of evaluations, or the word ci or paper, is needed"
        ) from None
    if budget < 1:
        raise RequestError(f"budget={value}: must be 1 or more")
    return budget


def _read_seeds(value: Any) -> range:
    text = str(value)
    if text in _REPETITIONS:
        return range(_REPETITIONS[text])
    first, colon, last = text.partition(":")
    try:
        wanted = range(int(first), int(last)) if colon else range(int(first))
    except ValueError:
        raise RequestError(f"seeds={text}: N, A:B, ci or paper is needed, such as seeds=10 or seeds=10:20") from None
    if not wanted or wanted.start < 0:
        raise RequestError(f"seeds={text}: holds no repetition from 0 on; write N >= 1, or A:B with 0 <= A < B")
    return wanted


def _read_start(value: Any) -> Start | None:
    if value not in (None, "nominal", "random"):
        raise RequestError(f"start={value}: {suggest(str(value), ['nominal', 'random'])}")
    start: Start | None = value
    return start


def _read_target(value: Any) -> float | None:
    if value is None:
        return None
    try:
        target: float = coerce("target", value, float)
    except ValueError:
        raise RequestError(f"target={value}: a number is needed") from None
    return target


def _read_time_limit(value: Any) -> float | None:
    if value is None:
        return None
    try:
        limit: float = coerce("time_limit", value, float)
    except ValueError:
        limit = 0.0
    if limit <= 0:
        raise RequestError(f"time_limit={value}: seconds above 0 are needed, or null for no limit")
    return limit


def _check_keys(overrides: list[Any]) -> None:
    for o in overrides:
        head = o.key_or_group.partition(".")[0]
        if o.key_or_group in _KEYS or head in ("problem", "optimizer", "execution"):
            continue
        if head in ("prob", "opt") and o.key_or_group.count(".") >= 2:
            continue
        raise RequestError(f"unknown argument {o.key_or_group!r}; {suggest(head, [*_KEYS, 'prob.NAME', 'opt.NAME'])}")


def _refuse_lists(overrides: list[Any]) -> None:
    for o in overrides:
        if o.is_sweep_override():
            raise RequestError(f"{o.input_line}: a list sweeps; add -m (bench run -m ...)")


def _last_value(overrides: list[Any], key: str, default: str) -> str:
    values = [str(o.value()) for o in overrides if o.key_or_group == key]
    return values[-1] if values else default


def _products(overrides: list[Any]) -> Iterator[list[str]]:
    for values in itertools.product(*(_values(o) for o in overrides)):
        yield [f"{o.key_or_group}={value}" for o, value in zip(overrides, values, strict=True)]


def _values(override: Any) -> list[Any]:
    """Return an override's values as text that Hydra reads back: one, or those of its sweep."""
    if override.is_sweep_override():
        return list(override.sweep_string_iterator())
    return [override.get_value_element_as_str()]


def _parse(arguments: Sequence[str]) -> list[Any]:
    """Return Hydra's overrides, the last of each key."""
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.errors import HydraException

    for argument in arguments:
        if "=" not in argument:
            raise RequestError(f"{argument!r} is no argument; write KEY=VALUE, such as problem=full12")
        if argument[0] in "+~":
            raise RequestError(f"{argument!r}: + and ~ are not used here; every option is declared (bench list)")
    try:
        parsed = OverridesParser.create().parse_overrides([_quoted(a) for a in arguments])
    except HydraException as error:
        raise RequestError(_first_line(error)) from None
    keys = [argument.partition("=")[0] for argument in arguments]
    return list({key: replace(o, key_or_group=key) for key, o in zip(keys, parsed, strict=True)}.values())


def _quoted(argument: str) -> str:
    key, _, value = argument.partition("=")
    if key not in _AS_TEXT or value[:1] in "'\"":
        return f"{key.replace(':', '_')}={value}"  # a class path is no key of Hydra's grammar
    escaped = value.replace("\\", "\\\\").replace("'", "\\'")
    return f"{key}='{escaped}'"


def _compose(overrides: Sequence[Any]) -> Any:
    return _compose_texts([o if isinstance(o, str) else f"{o.key_or_group}={_values(o)[0]}" for o in overrides])


def _compose_texts(overrides: list[str]) -> Any:
    """Return Hydra's composition of conf/config.yaml with `overrides`, as plain containers."""
    from hydra import compose
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
        return OmegaConf.to_container(compose("config", overrides=overrides), resolve=True)
    except (HydraException, OmegaConfBaseException) as error:
        raise RequestError(_first_line(error)) from None


@cache
def _initialize() -> None:
    """Tell Hydra where conf/ is and enter every registered name into its groups."""
    from hydra import initialize_config_dir
    from hydra.core.global_hydra import GlobalHydra

    GlobalHydra.instance().clear()
    initialize_config_dir(str(CONF), version_base="1.3", job_name="bench")
    for kind in ("problem", "optimizer"):
        for name in _registry(kind).names():
            _store(kind, name, _registry(kind))


def _store(kind: str, name: str, registry: Registry[Any]) -> None:
    from hydra.core.config_store import ConfigStore

    options = {
        key: "???" if option.required else _plain(option.default) for key, option in registry.options(name).items()
    }
    ConfigStore.instance().store(group=kind, name=name, node={"name": name, **options})


def _plain(value: Any) -> Any:
    """Return a default as Hydra's node: null for a mapping, whose keys Hydra would otherwise close."""
    if isinstance(value, Mapping):
        return None
    return list(value) if isinstance(value, tuple) else value


def _first_line(error: Exception) -> str:
    cause = error.__cause__ if error.__cause__ is not None else error
    return str(cause).strip().splitlines()[0]
