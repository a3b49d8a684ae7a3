"""Hydra's composition of conf/config.yaml with the words of a command line, and prepared studies, as plain containers.

Hydra itself, and its grammar, are loaded for what is more than plain words (`bench.sweep.words`). A prepared study is
sweeps in a file, in ``conf/study/`` under a name or one's own; without one ``study=NAME`` is the name of a folder.
"""

import difflib
import math
import os
import re
from collections.abc import Sequence
from dataclasses import replace
from decimal import Decimal
from functools import cache
from hashlib import blake2b
from pathlib import Path
from typing import Any, get_args
from unicodedata import normalize

from calibench import conf, optimizers, problems
from calibench.bench.sweep.words import PlainOverride, check_execution, compose_plainly, plain_override
from calibench.bench.words import RequestError
from calibench.core import options as opt
from calibench.core.kept import kept
from calibench.core.options import FilePath, is_text, parts_of, suggest, unquoted
from calibench.core.plain import LARGEST_YAML, check_yaml
from calibench.core.registry import Registry
from calibench.core.tables.data_file import read_whole, text_of
from calibench.core.user_file import is_file_path
from calibench.core.words import check_word, shortened

CONF = Path(conf.__file__).resolve().parent
REGISTERED = "registered-name"  # the key of a member's name in its node: no option of Python is called so
NOT_GIVEN = "???"  # Hydra's mark of an option without a default that nobody gave


def compose(overrides: list[str]) -> Any:
    """Return the composition of conf/config.yaml with `overrides`, as plain containers."""
    given = dict(override.partition("=")[::2] for override in overrides)
    names = [given[key] for key in ("execution", "execution.name") if key in given]
    for name in names:
        check_execution(name)
    options = [key.partition(".")[2] for key in given if key.startswith("execution.") and key != "execution.name"]
    check_execution(names[-1] if names else "serial", options)
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
        typed = [re.sub(r"\\(.)", r"\1", text) for text in overrides]
        named = [text for text in typed if text.partition("=")[0] == getattr(error, "full_key", None)]
        about = named or [text for text in typed if "${" in text]  # the argument that the error is about
        cause = error.__cause__ if error.__cause__ is not None else error
        where = f"{about[0]}: " if about else ""
        raise RequestError(f"{where}{str(cause).strip().splitlines()[0]}") from None


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
    from hydra import __version__, initialize_config_dir
    from hydra.core.global_hydra import GlobalHydra

    GlobalHydra.instance().clear()
    base = {"version_base": "1.3"} if __version__.startswith("1.3.") else {}  # at which 1.4 warns
    initialize_config_dir(str(CONF), job_name="bench", **base)
    for kind in ("problem", "optimizer"):
        for name in registry_of(kind).names():
            _enter(kind, name, _node(name, registry_of(kind)))


def enter(kind: str, name: str, registry: Registry[Any]) -> None:
    """Let ``kind=name`` be composed, with the options that `registry` declares of `name`."""
    _ENTERED[kind, entered(name)] = _node(name, registry)


_ENTERED: dict[tuple[str, str], dict[str, Any]] = {}  # what is not in Hydra's groups from the start


def _enter(kind: str, name: str, node: dict[str, Any]) -> None:
    from hydra import __version__
    from hydra.core.config_store import ConfigStore

    again: dict[str, Any] = {} if __version__.startswith("1.3.") else {"replace": True}  # 1.4 asks for what 1.3 does
    ConfigStore.instance().store(group=kind, name=name, node={in_ascii(k): v for k, v in node.items()}, **again)


def _node(name: str, registry: Registry[Any]) -> dict[str, Any]:
    """Return a registered name with its options and their defaults, as Hydra's node."""
    declared = registry.options(name)
    return {REGISTERED: name, **{k: NOT_GIVEN if o.required else plain(o.default) for k, o in declared.items()}}


def entered(name: str) -> str:
    """Return what Hydra's group calls a registered name: of a file, whose path is no name in a group, a digest."""
    return f"file_{blake2b(name.encode(), digest_size=8).hexdigest()}" if is_file_path(name) else name


def plain(value: Any) -> Any:
    """Return a default as Hydra's node: null for a mapping, whose keys Hydra would otherwise close, and for objects."""
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value if isinstance(value, str | int | float | bool) else None


def registry_of(kind: str) -> Registry[Any]:
    return problems.registry if kind == "problem" else optimizers.registry


ONCE = ("execution", "results", "time_limit", "shard", "stop_after", "replay")  # of the whole sweep
KEYS = ("problem", "optimizer", "budget", "seeds", "start", "target", "study", *ONCE)
MOST_VALUES = 10_000  # of one list or range: each is composed and built, in a hundredth of a second
_LONGEST_PARSED = 20_000  # characters: Hydra's parser takes up to two seconds for them
_AS_TEXT = ("seeds", "results", "study", "shard", "execution.address")  # 0:10 and paths are no Hydra grammar
_CHOICE = re.compile(r"\s*choice\s*\((.*)\)\s*", re.DOTALL)  # a list, whose quotes Hydra takes away
_BARE = re.compile(  # what its grammar can take for a number, a truth value or null
    r"[+-]?[.\d][\w.+-]*|[+-]?(?:inf|nan)|true|false|null", re.ASCII | re.IGNORECASE
)
_FOREIGN = re.compile(
    r"""'(?:\\.|[^'\\])*'|"(?:\\.|[^"\\])*"|[^,\[\]{}()'"\\]*[^\x00-\x7f][^,\[\]{}()'"\\]*"""
)  # what stands in quotes, or text with a sign beyond ASCII


def refuse_lists(overrides: list[Any]) -> None:
    for o in overrides:
        if o.is_sweep_override():
            raise RequestError(f"{o.input_line}: a list sweeps; add -m (bench run -m ...)")


def last_value(overrides: list[Any], key: str, default: str) -> str:
    last = next((o for o in reversed(overrides) if o.key_or_group == key), None)
    if last is None:
        return default
    if isinstance(last, PlainOverride):
        return str(last.value())
    from omegaconf import OmegaConf

    return str(OmegaConf.create({"value": last.value()})["value"])


def as_annotated(override: Any, kind: Any) -> Any:
    """Return an override of an option of type `kind` with its texts as they were typed: 1.10 is no number there."""
    key, _, value = override.input_line.partition("=")
    if isinstance(override, PlainOverride) and override.value() == value:
        return override
    written = in_quotes(value, kind)
    if written == value:
        return override
    plainly = plain_override(override.input_line, True) if written == f"'{value}'" else None
    return plainly or replace(_override(f"{key}={written}"), key_or_group=key, input_line=override.input_line)


def in_quotes(text: str, kind: Any) -> str:
    """Return a value of type `kind` in Hydra's grammar: in quotes what is text there, names as its mappings have them.

    >>> in_quotes("1.1,1.10", str), in_quotes("[1.10,2]", tuple[str, int]), in_quotes("1.10", float)
    ("'1.1','1.10'", "['1.10',2]", '1.10')
    """
    found = _CHOICE.fullmatch(text)
    return ",".join(_in_quotes(part, kind) for part in parts_of(found[1] if found else text)) or text


def _in_quotes(text: str, kind: Any) -> str:
    word = text.strip()
    begin, _, end = text.partition(word) if word else ("", "", "")
    if (held := opt.inside(word, "[")) is not None:
        items = [_in_quotes(part, opt.item_type(kind, i)) for i, part in enumerate(parts_of(held))]
        return f"{begin}[{','.join(items)}]{end}"
    if (held := opt.inside(word, "{")) is not None:
        pairs = [opt.pair_of(part) for part in parts_of(held)]
        named = [(unquoted(pair[0].strip()), pair[1]) for pair in pairs if pair is not None]
        # of names the signs that Hydra's grammar does not know stand by their numbers
        unknown = re.compile(r"^\d|[^\w]|^(?=(null|true|false|nan|inf)$).", re.ASCII | re.IGNORECASE)
        keys = [unknown.sub(lambda letter: f"__u{ord(letter[0]):x}__", name) for name, _ in named]
        words = [_in_quotes(value, opt.field_type(kind, name)) for name, value in named]
        items = [f"{key}:{value}" for key, value in zip(keys, words, strict=True)]
        return text if None in pairs else f"{begin}{{{','.join(items)}}}{end}"
    return f"{begin}'{word}'{end}" if _BARE.fullmatch(word) and is_text(kind, word) else text


def values_of(override: Any) -> list[Any]:
    """Return an override's values as text that Hydra reads back: one, or those of its sweep."""
    if isinstance(override, PlainOverride):
        return [override.written]
    from hydra.core.override_parser.types import ChoiceSweep, FloatRange, Glob, IntervalSweep, RangeSweep

    value = override.value()
    if any(isinstance(part, Glob) for part in (value.list if isinstance(value, ChoiceSweep) else [value])):
        raise RequestError(f"{override.input_line}: glob(...) stands for names of problems and of optimizers only")
    if isinstance(value, IntervalSweep):
        raise RequestError(f"{override.input_line}: an interval is no list; write range(START,STOP,STEP) or values")
    if isinstance(value, RangeSweep) and not value.step:
        raise RequestError(f"{override.input_line}: a step other than 0 is needed")
    if isinstance(value, RangeSweep):
        ends = (value.start, value.stop, value.step)
        first, stop, step = (Decimal(n if isinstance(n, int) else f"{n:.15g}") for n in ends)
        if not all(number.is_finite() for number in (first, stop, step)):
            raise RequestError(f"{override.input_line}: START, STOP and STEP must be finite numbers")
        count = max(0, math.ceil((stop - first) / step))  # in decimals: range(.3,.9,.2) is .3, .5, .7 and not .9
        if count > MOST_VALUES:
            raise RequestError(f"{override.input_line}: is {count} values, and a list has at most {MOST_VALUES}")
        if isinstance(value.range(), FloatRange):
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
        if not key.partition(".")[0].isascii() or not re.fullmatch(r"[\w.:/-]+", key):
            raise RequestError(f"unknown argument {key!r}; {suggest(key, KEYS)}")
        key = normalize("NFKC", key)  # as Python has names: µ of a keyboard and μ of Greek are one
        argument = f"{key}={argument.partition('=')[2]}"
        if key in given:
            raise RequestError(f"{key} is given twice ({given[key]} and {argument}); give it once")
        check_word(argument)
        given[key] = argument
    named, overrides = given.get("problem", "").partition("=")[2].split(","), []
    known = [name for name in named if ":" not in name and name in problems.registry]
    for key, argument in given.items():
        head, _, name = key.partition(".")
        declared = [problems.registry.options(p).get(name) for p in known] if head == "problem" and name else []
        is_file = any(option is not None and FilePath in get_args(option.annotation) for option in declared)
        as_text = key in _AS_TEXT or is_file
        text = _with_environment(argument, as_text)
        check_word(text)
        read = plain_override(text, as_text) or replace(_override(text, as_text), key_or_group=key, input_line=text)
        overrides.append(read)
    return overrides


def _with_environment(argument: str, as_text: bool) -> str:
    """Return `argument` with ${oc.env:NAME} and ${oc.env:NAME,DEFAULT} as if their values had been typed."""

    def resolve(found: re.Match[str]) -> str:
        name, default = found["name"].strip(), found["default"]
        if name in os.environ:
            return os.environ[name]
        if default is None:
            raise RequestError(f"{argument}: the environment variable {name or '(no name)'} is not set")
        return default.strip()

    resolved = re.sub(r"(?<!\\)\$\{oc\.env:(?P<name>[^,{}]*)(?:,(?P<default>[^{}]*))?\}", resolve, argument)
    left = re.search(r"(?<!\\)\$\{oc\.[^}]*\}?", resolved)
    if left and as_text:
        raise RequestError(f"{argument}: {left[0]} cannot be resolved here; only ${{oc.env:NAME}} can")
    return resolved


def _override(argument: str, as_text: bool = False) -> Any:
    """Return what Hydra reads; with `as_text` a value that stands for itself to the letter."""
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.errors import HydraException

    key, _, value = argument.partition("=")
    if len(argument) > _LONGEST_PARSED:
        raise RequestError(f"{key}=: has {len(argument)} characters; at most {_LONGEST_PARSED} are parsed")
    if as_text:
        is_quoted = len(value) > 1 and value[0] == value[-1] and value[0] in "'\""
        written = f"{key}={quoted_text(value[1:-1] if is_quoted else value)}"
    else:  # a path of a class or file is no key of Hydra's grammar
        readable = re.sub(r"[^\w.]|[.]{2,}", "_", key, flags=re.ASCII)
        written = f"{readable}={_FOREIGN.sub(_quoted_foreign, in_quotes(value, Any) if '{' in value else value)}"
    try:
        return OverridesParser.create().parse_override(written)
    except (HydraException, ValueError):  # its words are those of a grammar; Python reads no 5000 digits
        raise RequestError(
            f"{shortened(argument)}: the value cannot be read: brackets, braces and quotes must match and commas part "
            f'something; text that holds such characters stands in quotes: "{key}={shortened(quoted_text(value))}"'
        ) from None


def _quoted_foreign(found: re.Match[str]) -> str:
    """Return text with letters beyond ASCII in quotes, as Hydra's grammar wants it; what has quotes as it is."""
    text = found[0]
    if text[0] in "'\"":
        return text
    key = re.match(r"(\s*)([^\W\d]\w*)(\s*:\s*)", text) if "{" in found.string[: found.start()] else None
    begin = f"{key[1]}{in_ascii(key[2])}{key[3]}" if key else ""
    rest = text[key.end() if key else 0 :]
    bare = rest.strip()
    return begin + (rest if bare.isascii() else rest.replace(bare, quoted_text(bare), 1))


def in_ascii(name: str) -> str:
    """Return the name of an option as Hydra's grammar takes it: letters beyond ASCII by their numbers.

    >>> in_ascii("Δt")
    '__u394__t'
    """
    return re.sub(r"[^\x00-\x7f]", lambda letter: f"__u{ord(letter[0]):x}__", normalize("NFKC", name))


def quoted_text(value: str) -> str:
    """Return `value` as Hydra's quoted text that stands for it to the letter: no escape, no interpolation."""
    value = re.sub(r"(\\*)\$\{", r"\1\1\\${", value)  # OmegaConf reads 2 n + 1 backslashes there as n and a plain ${
    return "'" + re.sub(r"(\\*)('|$)", lambda m: 2 * m[1] + ("\\'" if m[2] else ""), value) + "'"


def study_preset(name: str) -> dict[str, Any] | None:
    """Return the prepared study of a name or a file, None for a mere folder. Raises `RequestError` for no study."""
    path = Path(name).expanduser() if is_study_file(name) else CONF / "study" / f"{name}.yaml"
    if not is_study_file(name) and name not in study_names():
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
