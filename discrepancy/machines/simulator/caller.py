"""`Caller`: a simulator as a function of a table, whatever it is: Python, a command, an FMU; its calls are kept.

A job is a part of a table: inputs (n, k) and parameters (n, p) or (p,). What a job gave is kept on disk under a digest
of the simulator's code, of its numbers and of what is asked, so that a command that was killed goes on where it was.
Jobs that wait for each other are done by processes of their own. Only what the user names is run: a function of
FILE.py:NAME, a command without a shell, an FMU.
"""

from __future__ import annotations

import inspect
import math
import multiprocessing
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stdout, suppress
from dataclasses import dataclass, field
from hashlib import blake2b
from pathlib import Path
from typing import Any, final

import numpy as np

from calibench.core import sources
from calibench.core.kept import cache_root
from calibench.core.registry import Registry
from calibench.core.words import one_line
from calibench.discrepancy.model.measured import DataError
from calibench.problems.base import Array

simulators: Registry[Any] = Registry("simulator", "calibench.simulators")
_SLOW = 0.005  # s of a job: a quicker one is done again sooner than it is read
_CHUNK = 16  # rows of a job where each row is a call
# a name, its unit in brackets, = or :, and the number
_VALUE = r"[+-]?(?:\d+\.?\d*(?:e[+-]?\d+)?|\.\d+(?:e[+-]?\d+)?|nan|inf)"
_NAMED = r"(?<!\w){}[\"']?\s*(?:\[[^\]\n]*\]|\([^)\n]*\))?\s*[=:]\s*(" + _VALUE + ")"
_SHOWN = 120  # characters of what a failed command said
Simulator = Callable[[Array, Array], Array]  # inputs (n, k), parameters (p,) or (n, p) -> (n, m)


@final
@dataclass(frozen=True)
class Names:
    """The columns that a simulator is given, its parameters, and the columns that it predicts, in this order."""

    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    outputs: tuple[str, ...]


def of_function(function: Callable[..., Any], names: Names, one: bool) -> Simulator:
    """Return a Python function as a simulator.

    One of two arguments without defaults that are no inputs gets both as mappings, name -> array, name -> number; its
    further arguments keep their defaults. Any other gets each input and parameter by its own name. It returns a mapping
    name -> array, a tuple of arrays, or an array (n, m); with `one` it is called for each row, with numbers.
    """
    arguments = inspect.signature(function).parameters.values()
    plain = [a.name for a in arguments if a.default is a.empty and a.kind is a.POSITIONAL_OR_KEYWORD]
    further, known = {a.name for a in arguments if a.default is not a.empty}, {*names.inputs, *names.parameters}
    as_mappings = len(plain) == 2 and not {*plain} <= known and not further & known

    def ask(inputs: Mapping[str, Any], parameters: Mapping[str, Any], n: int) -> Array:
        said = function(dict(inputs), dict(parameters)) if as_mappings else function(**inputs, **parameters)
        if isinstance(said, Mapping):
            if lost := [name for name in names.outputs if name not in said]:
                there = ", ".join(map(str, said))
                raise DataError(f"the simulator returned {there}; {', '.join(lost)} is needed too")
            said = tuple(said[name] for name in names.outputs)
        if isinstance(said, tuple | list):
            each = [np.asarray(one, dtype=float) for one in said]
            for name, one in zip(names.outputs, each):
                if one.shape not in ((), (1,), (n,)):
                    raise DataError(f"the simulator returned {name} of shape {one.shape}: {n} rows need as many values")
            said = np.stack([np.broadcast_to(one, n) for one in each], axis=-1)
        table, m = np.asarray(said, dtype=float), len(names.outputs)
        table = table.reshape(n, -1) if table.ndim < 2 and table.size == n * m else table
        if table.shape != (n, m):
            raise DataError(
                f"the simulator returned shape {table.shape} for {n} rows of {', '.join(names.outputs)}: a mapping "
                f"name -> array or an array ({n}, {m}) is needed"
            )
        return table

    def whole(inputs: Array, parameters: Array) -> Array:
        given = {name: inputs[:, k].copy() for k, name in enumerate(names.inputs)}
        if parameters.ndim == 1:
            return ask(given, {name: float(p) for name, p in zip(names.parameters, parameters)}, len(inputs))
        return ask(given, {name: parameters[:, k].copy() for k, name in enumerate(names.parameters)}, len(inputs))

    def row(inputs: Array, parameters: Array) -> Array:
        given = {name: float(v) for name, v in zip(names.inputs, inputs)}
        return np.asarray(ask(given, {name: float(p) for name, p in zip(names.parameters, parameters)}, 1)[0])

    return _row_by_row(row, len(names.outputs)) if one else whole


def of_command(command: str, names: Names) -> Simulator:
    """Return a command as a simulator: {args} stands for the numbers of a row, or {NAME} for each.

    It is run without a shell, once a row. Its last line of output has the numbers that it predicts and nothing else, or
    each of them stands behind its name anywhere, ``NAME = 1.2``, whatever is printed around it.
    """
    words = shlex.split(command)
    named = [re.compile(_NAMED.replace("{}", re.escape(name), 1), re.IGNORECASE) for name in names.outputs]

    def row(inputs: Array, parameters: Array) -> Array:
        numbers = {n: repr(float(v)) for n, v in zip((*names.inputs, *names.parameters), (*inputs, *parameters))}
        given: list[str] = []
        for word in words:
            for name, number in numbers.items():
                word = word.replace(f"{{{name}}}", number)
            given += numbers.values() if word == "{args}" else [word]
        text = " ".join(numbers.values()) + "\n"
        try:
            done = subprocess.run(given, input=text, capture_output=True, text=True, check=False)
        except OSError as error:
            lost = f"{given[0]}: {error.strerror}; give its path from here"
            raise DataError(f"machine.command={command}: {lost}") from None
        lines = done.stdout.strip().splitlines()
        cells = (lines[-1] if lines else "").replace(",", " ").split()
        behind = [one.findall(done.stdout) for one in named]
        cells = [said[-1] for said in behind] if all(behind) else cells
        try:
            found = [float(cell) for cell in cells]
        except ValueError:
            found = []
        if done.returncode or len(found) != len(names.outputs):
            said = one_line(done.stderr or done.stdout)[-_SHOWN:] or "nothing"
            raise DataError(
                f"machine.command={command}: exit code {done.returncode}, {said!r}; a last line of "
                f"{len(names.outputs)} numbers ({', '.join(names.outputs)}) is needed, or each behind its name, such "
                f"as {names.outputs[0]} = 1.2"
            )
        return np.array(found)

    return _row_by_row(row, len(names.outputs))


def of_fmu(file: str, names: Names) -> Simulator:
    """Return an FMU as a simulator: a row's inputs and parameters are start values, its outputs those at the end."""
    try:
        import fmpy
    except ImportError:
        raise DataError(f"machine.fmu={file}: fmpy is needed; pip install 'calibench[fmu]'") from None
    opened: list[Any] = []

    def row(inputs: Array, parameters: Array) -> Array:
        if not opened:  # by each process, once
            opened.extend((fmpy.read_model_description(file), fmpy.extract(file)))
        starts = dict(zip((*names.inputs, *names.parameters), map(float, (*inputs, *parameters))))
        done = fmpy.simulate_fmu(
            opened[1], model_description=opened[0], start_values=starts, output=list(names.outputs)
        )
        return np.array([float(done[name][-1]) for name in names.outputs])

    return _row_by_row(row, len(names.outputs))


def _row_by_row(row: Callable[[Array, Array], Array], m: int) -> Simulator:
    def whole(inputs: Array, parameters: Array) -> Array:
        each = np.broadcast_to(parameters, (len(inputs), parameters.shape[-1]))
        return np.array([row(u, p) for u, p in zip(inputs, each)]).reshape(len(inputs), m)

    return whole


def code_of(call: str, command: str, fmu: str) -> str:
    """Return the digest of a simulator's code: a module with what it imports, or the files that a command names."""
    whole = blake2b(f"{call}\n{command}\n{fmu}".encode(), digest_size=12)
    if call:
        whole.update(sources.module_digest(simulators.factory(call).__module__).encode())
    for word in [*shlex.split(command), *([fmu] if fmu else [])]:
        path = Path(shutil.which(word) or word)
        if path.is_file():
            whole.update(path.read_bytes())
    return whole.hexdigest()


@final
@dataclass(eq=False)
class Caller:
    """A simulator whose calls are counted, kept, and done side by side.

    `rows` are those that were called for, each once; `run` of them were run, the others had been kept on disk.
    `seconds` is the time that the runs of rows took, all processes together.
    """

    simulator: Simulator
    names: Names
    code: str
    one: bool
    workers: int = 1
    rows: int = 0
    run: int = 0
    jobs: int = 0
    seconds: float = 0.0
    _known: dict[str, Array] = field(default_factory=dict, repr=False)

    @property
    def folder(self) -> Path:
        return cache_root() / "simulations" / self.code

    def ask(self, questions: Sequence[tuple[Array, Array]]) -> list[Array]:
        """Return (n, m) for each question, inputs (n, k) and parameters (p,) or (n, p); NaN where it gives none."""
        jobs: dict[str, tuple[Array, Array]] = {}
        asked: list[list[str]] = []
        for inputs, parameters in questions:
            step = _CHUNK if self.one else max(len(inputs), 1)
            keys = []
            for at in range(0, len(inputs), step):
                part = (inputs[at : at + step], parameters[at : at + step] if parameters.ndim == 2 else parameters)
                digest = blake2b(digest_size=16)
                for one in (np.ascontiguousarray(one, dtype=float) for one in part):
                    digest.update(f"{one.shape}".encode() + one.tobytes())
                keys.append(digest.hexdigest())
                jobs.setdefault(keys[-1], part)
            asked.append(keys)
        new = [key for key in jobs if key not in self._known]
        self.rows += sum(len(jobs[key][0]) for key in new)
        lacking = [(key, *jobs[key]) for key in new if not self._read(key)]
        self.run += sum(len(inputs) for _, inputs, _ in lacking)
        if lacking and not self.jobs:  # in this process, whose errors say most, and to know how long it takes
            first = lacking.pop(0)
            self._known[first[0]] = self._timed(*first)
        may_fork = "fork" in multiprocessing.get_all_start_methods() and not multiprocessing.current_process().daemon
        count = min(self.workers, len(lacking))
        if may_fork and count > 1 and self.seconds / self.jobs * len(lacking) > 10 * _SLOW:
            self._side_by_side(lacking, count)
        for key, inputs, parameters in lacking:
            if key not in self._known and not self._read(key):
                self._known[key] = self._timed(key, inputs, parameters)
        m = len(self.names.outputs)
        return [np.concatenate([self._known[key] for key in keys]) if keys else np.empty((0, m)) for keys in asked]

    def begin(self, inputs: Array, parameters: Array) -> float:
        """Call it first, for one row or for all, and return how many seconds the whole table takes one process."""
        self.ask([(inputs[:1] if self.one else inputs, parameters)])
        told = self.folder / "seconds.txt"
        if self.run:
            took = self.seconds * (len(inputs) if self.one else 1)
            with suppress(OSError):
                if told.parent.is_dir():
                    told.write_text(repr(took / len(inputs)))
            return took
        try:
            return float(told.read_text()) * len(inputs)
        except (OSError, ValueError):
            return 0.0

    def _side_by_side(self, jobs: list[tuple[str, Array, Array]], count: int) -> None:
        """Let `count` processes do the jobs; each writes what it found, and ends when this process has ended."""
        context, parent = multiprocessing.get_context("fork"), os.getpid()
        with tempfile.TemporaryDirectory() as spare:

            def share(k: int) -> None:
                for key, inputs, parameters in jobs[k::count]:
                    if os.getppid() != parent:
                        break
                    with suppress(Exception):  # it is tried again, and raised, where it is missed
                        self._timed(key, inputs, parameters, Path(spare))
                os._exit(0)

            began = time.perf_counter()
            children = [context.Process(target=share, args=(k,)) for k in range(count)]
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", DeprecationWarning)  # the child uses no thread of this process
                for child in children:
                    child.start()
            for child in children:
                child.join()
            for key, _, _ in jobs:
                self.jobs += self._read(key) or self._read(key, Path(spare))
            self.seconds += count * (time.perf_counter() - began)

    def _timed(self, key: str, inputs: Array, parameters: Array, spare: Path | None = None) -> Array:
        began = time.perf_counter()
        try:
            with redirect_stdout(sys.stderr):  # what a simulator prints is no part of an answer
                found = np.asarray(self.simulator(inputs, parameters), dtype=float)
        except DataError:
            raise
        except (Exception, SystemExit) as error:  # whatever a simulator of a user's raises
            each = parameters if parameters.ndim == 1 else parameters[0]
            values = ", ".join(f"{name} = {p:.6g}" for name, p in zip(self.names.parameters, each))
            raise DataError(f"the simulator failed at {values}: {said_of(error)}") from error
        took = time.perf_counter() - began
        if spare is None:
            self.jobs, self.seconds = self.jobs + 1, self.seconds + took
        kept = took > _SLOW and self._write(self.folder, key, found)
        if spare is not None and not kept:
            self._write(spare, key, found)
        return found

    def _read(self, key: str, folder: Path | None = None) -> bool:
        try:
            self._known[key] = np.load((folder or self.folder) / f"{key}.npy", allow_pickle=False)
        except (OSError, ValueError, EOFError):
            return False
        return True

    def _write(self, folder: Path, key: str, found: Array) -> bool:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.NamedTemporaryFile(dir=folder, suffix=".tmp", delete=False) as file:
                np.save(file, found)
            os.replace(file.name, folder / f"{key}.npy")
        except OSError:  # a full or read-only disk: the next process calls it again
            return False
        return True


def said_of(error: BaseException) -> str:
    """Return what a failure of a user's simulator says, in a line, with its place."""
    at = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {one_line(str(error))} ({Path(at.filename).name}, line {at.lineno})"


def duration(seconds: float) -> str:
    """Return a time in words, two digits.

    >>> duration(42.4), duration(380.0)
    ('43 s', '6.3 min')
    """
    for size, unit in ((3600.0, "h"), (60.0, "min")):
        if seconds >= 1.5 * size:
            return f"{seconds / size:.{0 if seconds >= 10 * size else 1}f} {unit}"
    return f"{math.ceil(seconds)} s" if seconds >= 10 else f"{seconds:.2g} s"
