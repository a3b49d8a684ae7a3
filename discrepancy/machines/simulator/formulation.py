"""`SimulatorMachine`: any program that predicts what is measured; its inputs are columns, its parameters have bounds.

Each input is a joint of the machine's roles, each measured column an instrument, so that the general families look for
errors of all of them; the parameters have families of their own (`effects`). What an error of an input needs beside it
are columns of the file (`q_dir`, `q_vel`, `q_torque`, `q_temp` of an input q); the first two follow from a clock if
there is one. A row is a reading of its own. Where rows depend on each other, which is tried, inputs have no effects.
"""

from __future__ import annotations

import inspect
import math
import os
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal, final

import numpy as np

from calibench.core import user_file
from calibench.core.notes import Code, Note
from calibench.core.options import shown, suggest
from calibench.core.tables import mistakes
from calibench.core.tables.cells import USUAL_FACTORS, factors_near
from calibench.core.tables.mistakes import Kind, Mistake
from calibench.core.words import counted, plain, print_plain
from calibench.discrepancy.checks.wild import FAR
from calibench.discrepancy.machines.simulator import caller as calls
from calibench.discrepancy.machines.simulator.caller import Caller, Names, duration, simulators
from calibench.discrepancy.machines.simulator.local import FEW, LocalModel, Variable
from calibench.discrepancy.model.formulations import OfRows, Predicted, along_clock, means_at, numbers_of
from calibench.discrepancy.model.machine import Description
from calibench.discrepancy.model.measured import DataError, MeasuredData, Sensor, complete
from calibench.discrepancy.model.roles import RATE, Instrument, Joint, Roles
from calibench.discrepancy.registries import describe, machines
from calibench.problems.base import Array, Parameter

WAY = "direction of "  # before an input: the sign of its last change
_LONG = 30.0  # s: what takes longer is told beforehand
_SEARCH = 12  # passes of a search, about, beside those of calibration and slopes
_CALIBRATIONS = 3
_CURED = 0.3  # of the misfit of shuffled readings: by a factor, at the nominal parameters
_FEW_OF_UNITS = 50  # rows that are tried with a factor
_OF_UNITS = math.log(2)  # of a factor: less is an error of scale, or of a parameter
_ALIKE = 0.2  # of the logarithm of a factor: nominal parameters are not the true ones
_CELSIUS = 273.15
_NEARBY = 0.013  # of the range of a number
_ON_STEP = 1e-3  # of a step by which a rounded number may be off it
_HEARD = 0.05  # of the noise of the readings: the simulator's own from which it is added to theirs
_TOLD: set[tuple[str, int, bool]] = set()  # of what was told how long it takes: a search formulates more than once


@machines.register("simulator")
@final
@dataclass(frozen=True)
class SimulatorMachine:
    """A simulator: a Python function, a command or an FMU that predicts what is measured.

    `call` is FILE.py:FUNCTION, `command` a program with {args} or {NAME} in its words, `fmu` a file; one of these.
    `inputs` are columns, `parameters` name -> nominal, lower, upper; one with a single number is held. `measured` are
    the columns that it predicts, in its order, `sigma` their noise: a number for all, or name -> number or column. A
    file of Python may state them as INPUTS, PARAMETERS and OUTPUTS (a mapping to the noise, or names). With `rows=one`
    a function is called for each row. `time` is the column of the clock, an input that is the time within a trial, or
    both ("t,clock"); `covariates` are the columns that an error may follow, by default all others. `workers` are the
    processes that call it, by default one for each core.
    """

    call: str = ""
    command: str = ""
    fmu: str = ""
    rows: Literal["all", "one"] = "all"
    inputs: tuple[str, ...] = ()
    parameters: Mapping[str, float | tuple[float, ...]] = field(default_factory=dict)
    measured: tuple[str, ...] = ()
    sigma: float | Mapping[str, float | str] | None = None
    time: str = ""
    covariates: tuple[str, ...] = ()
    workers: int = 0
    name: str = field(default="simulator", init=False)

    def code(self) -> str:
        """Return the digest of the simulator's own code, beside the machine's; raise `DataError` for none, or two."""
        given = [key for key in ("call", "command", "fmu") if getattr(self, key)]
        if len(given) != 1:
            both = " and ".join(f"machine.{key}=" for key in given) or "none"
            raise DataError(
                f"machine=simulator: {both} is given; one of machine.call=FILE.py:FUNCTION, "
                'machine.command="./sim {args}" and machine.fmu=FILE is needed'
            )
        if self.call and not (user_file.is_file_path(self.call) or simulators.names()):
            raise DataError(f"machine.call={self.call}: FILE.py:FUNCTION is needed, such as sim.py:{self.call}")
        try:
            return calls.code_of(self.call, self.command, self.fmu)
        except ValueError as error:
            raise DataError(f"machine.call={self.call}: {error}") from None

    def formulate(self, data: MeasuredData) -> Predicted:
        code = self.code()
        inputs, numbers, measured = self._declared(data)
        names = Names(inputs, tuple(numbers), tuple(measured))
        there = [c for c in (*inputs, *measured) if c not in data or data[c].dtype.kind not in "iuf"]
        if there:
            raise DataError(f"{data.name}: {there[0]}: no column of numbers; {suggest(there[0], numbers_of(data))}")
        deviations = [s for s in measured.values() if isinstance(s, str)]
        stated_times = [c for c in map(str.strip, self.time.split(",")) if c] or ["t_s"] * ("t_s" in data)
        within = next((c for c in stated_times if c in inputs), "")
        clock = next((c for c in stated_times if c not in inputs), "")
        of_trial = [u for u in inputs if data.units.get(u) == "s"]
        if not within and len(of_trial) == 1:
            [within] = of_trial
            text = f"{within}, in seconds, is taken for the time within a trial, along which outputs may be late"
            data = data.with_note(Code.FILE, f"{text}; state machine.time= where it is another", (within,))
        data = complete(data, (*measured, *inputs, *deviations, *((clock,) if clock else ())))
        data = _moved(data, inputs, clock)
        table = np.column_stack([np.zeros((len(data), 0)), *(np.asarray(data[u], dtype=float) for u in inputs)])
        if self.command:
            simulator = calls.of_command(self.command, names)
        elif self.fmu:
            simulator = calls.of_fmu(self.fmu, names)
        else:
            simulator = calls.of_function(simulators.factory(self.call), names, self.rows == "one")
        one = self.rows == "one" or not self.call
        known = Caller(simulator, names, code, one, self.workers or os.cpu_count() or 1)
        variables = [
            Variable(u, True, k, float(np.ptp(table[:, k])) or max(1.0, abs(float(table[0, k]))))
            for k, u in enumerate(inputs)
        ]
        for k, (p, (value, lower, upper)) in enumerate(numbers.items()):
            bounded = upper > lower
            wide = upper - lower if bounded else max(abs(value), 1.0)
            edges = (lower, upper) if bounded else (-np.inf, np.inf)
            variables.append(Variable(p, False, k, wide, *edges))
        free = {p: limits[1] < limits[2] for p, limits in numbers.items()}
        stated = [s if isinstance(s, int | float) else np.nan for s in measured.values()]
        start = np.array([limits[0] for limits in numbers.values()])
        local = LocalModel(known, table, tuple(variables), start, np.array(stated, dtype=float))
        try:
            seconds = known.begin(table, start)
            _say_beforehand(known, seconds, local)
        except DataError as error:
            if error.__cause__ is None:
                raise
            one_row = "" if known.one else "; it is given all rows at once: machine.rows=one calls it for each"
            nominal = ", ".join(f"{p} = {limits[0]:g}" for p, limits in numbers.items())
            where = f"at the nominal parameters ({nominal}): {calls.said_of(error.__cause__)}"
            raise DataError(f"the simulator failed {where}{one_row}") from error
        seen = np.stack([np.asarray(data[y], dtype=float) for y in measured], axis=-1)
        try:
            local.prepare()
        except DataError:  # numbers far from those it is made for
            _refuse_units(data, local, start, seen)
            raise
        _refuse_coarse(data.name, local, seen)
        if local.rough:
            _say_beforehand(known, seconds, local)
        local.calibrate(seen, data.fitted, np.array([*free.values()], dtype=np.bool_))
        _refuse_units(data, local, start, seen)
        found = dict(zip(numbers, local.parameters.tolist()))
        for y, own, noise in zip(measured, local.own, local.scale):
            sigma = measured[y]
            if own > _HEARD * noise and isinstance(sigma, str):
                data = data.with_columns({sigma: np.hypot(np.asarray(data[sigma], dtype=float), own)})
            elif own > _HEARD * noise and sigma is not None:
                measured[y] = float(np.hypot(sigma, own))
        if within in local.slopes:  # time itself is an input: its slopes are the rates of the outputs
            rates = {f"{RATE}{y}": local.slopes[within][:, k] for k, y in enumerate(measured)}
            units = {f"{RATE}{y}": f"{data.units.get(y) or '1'}/s" for y in measured}
            data = data.with_columns(rates)
            data = replace(data, computed=data.computed | {*rates}, units={**units, **data.units})
        if not local.independent:
            text = "the table is simulated as a whole, and errors of inputs are not looked for"
            data = data.with_note(Code.SIMULATOR_ROWS, f"rows depend on each other: {text}", inputs)
        data = _from_the_second_row(data, clock) if local.independent else data
        numbers_of_rows = {int(n): k for k, n in enumerate(data.row_numbers)}
        of_rows = _OnRows(local, {u.tobytes(): k for k, u in enumerate(table)}, numbers_of_rows)
        predict, slopes = of_rows(data)
        sensors = tuple(Sensor(y, f"output {y}", data.units.get(y, ""), part=y) for y in measured)
        return Predicted(
            data, predict,
            tuple(Parameter(p, "", found[p], *limits[1:]) for p, limits in numbers.items() if free[p]),
            measured=measured, inputs=inputs, held={p: limits[0] for p, limits in numbers.items() if not free[p]},
            unit="", instruments=sensors, roles=self._roles(data, local, names, free, clock, within), slopes=slopes,
            of_rows=of_rows, of_new=partial(_of_new, of_rows, clock, within), at_end=of_rows.remarks,
            made_up=local.made_up,
        )  # fmt: skip

    def _declared(
        self, data: MeasuredData
    ) -> tuple[tuple[str, ...], dict[str, tuple[float, float, float]], dict[str, float | str | None]]:
        """Return inputs, parameter -> nominal and bounds, and measured column -> noise: of the words, else the file."""
        inputs: Any = self.inputs
        parameters: Any = dict(self.parameters)
        outputs: Any = self.measured
        if self.call:
            function = simulators.factory(self.call)
            file = inspect.getmodule(function) if user_file.is_file_path(self.call) else None
            inputs = inputs or getattr(file, "INPUTS", ())
            parameters = parameters or getattr(file, "PARAMETERS", {})
            outputs = outputs or getattr(file, "OUTPUTS", ())
            arguments = inspect.signature(function).parameters.values()
            if not parameters:
                parameters = {a.name: a.default for a in arguments if isinstance(a.default, int | float | tuple)}
            if not inputs:
                inputs = tuple(a.name for a in arguments if a.default is a.empty and a.name not in parameters)
        for word, value in (("inputs", inputs), ("parameters", parameters), ("measured", outputs)):
            if not value and (word != "parameters" or not self.call):  # a function may have none
                upper = {"inputs": "INPUTS", "parameters": "PARAMETERS", "measured": "OUTPUTS"}[word]
                where = f", or {upper} = ... in the file" if self.call else ""
                raise DataError(f"machine.{word}= is missing{where}: a simulator has {word}")
        limits: dict[str, tuple[float, float, float]] = {}  # nominal, lower and upper; one number is held
        for name, value in dict(parameters).items():
            numbers = [value] if isinstance(value, int | float) and not isinstance(value, bool) else value
            try:
                numbers = [float(v) for v in numbers]
            except (TypeError, ValueError):
                numbers = []
            if len(numbers) == 1:
                numbers *= 3
            if len(numbers) != 3 or not np.isfinite(numbers).all() or not numbers[1] <= numbers[0] <= numbers[2]:
                raise DataError(
                    f"parameter {name}: {shown(value)}: its nominal value, lower and upper bound are needed, such as "
                    f"[1.2, 0.5, 3.0], or one number, which is held"
                )
            limits[str(name)] = numbers[0], numbers[1], numbers[2]
        measured: dict[str, float | str | None] = dict.fromkeys(map(str, outputs))
        if isinstance(outputs, Mapping):
            measured = dict(outputs)
        if isinstance(self.sigma, Mapping):
            for name in self.sigma:
                if name not in measured:
                    raise DataError(f"machine.sigma: {name} is not measured; {suggest(name, measured)}")
            measured |= self.sigma
        elif self.sigma is not None:
            measured = dict.fromkeys(measured, self.sigma)
        twice = {*inputs} & {*limits} | {*inputs} & {*measured} | {*limits} & {*measured}
        if twice:
            raise DataError(f"{', '.join(sorted(twice))}: a name is an input, a parameter or measured: one of these")
        return tuple(map(str, inputs)), limits, measured

    def _roles(
        self, data: MeasuredData, local: LocalModel, names: Names, free: Mapping[str, bool], clock: str, within: str
    ) -> Roles:
        def beside(u: str, ending: str, made: str = "") -> str:
            return next((c for c in (f"{u}{ending}", f"{made}{u}") if c != u and c in data), "")

        joints = []
        for u in names.inputs if local.independent else ():
            unit = data.units.get(u, "")
            kind: Literal["rotary", "sliding"] = "rotary" if unit in ("rad", "deg") else "sliding"
            joints.append(Joint(
                u, u, kind, unit or f"units of {u}", direction=beside(u, "_dir", WAY), velocity=beside(u, "_vel", RATE),
                torque=beside(u, "_torque"), temperature=beside(u, "_temp"),
            ))  # fmt: skip
        used = {c for j in joints for c in (j.reading, j.direction, j.velocity, j.torque, j.temperature)}
        used |= {*names.inputs, *names.outputs, clock, *data.computed}
        others = [c for c in (self.covariates or numbers_of(data)) if c not in used or (c == clock and c in data)]
        for c in self.covariates:
            if c not in data:
                raise DataError(f"machine.covariates={c}: no column; {suggest(c, numbers_of(data))}")
        span = float(np.ptp(data[within])) if within else 0.0
        rates = {y: (f"{RATE}{y}",) if f"{RATE}{y}" in data else () for y in names.outputs}
        instruments = tuple(Instrument(y, (y,), rates[y], span=span) for y in names.outputs)
        heat = next((c for c in ("temp_K", "temperature") if c in data), "")
        columns = tuple(c for c in others if np.ptp(data[c]))
        parameters = sorted(free, key=lambda p: not free[p]) if local.independent else ()
        return Roles(tuple(joints), (), clock, heat, instruments, columns, tuple(parameters))


@final
@dataclass(frozen=True, eq=False)
class _OnRows:
    """The prediction for the rows of any data: those of the table by their inputs, others by calls."""

    local: LocalModel
    places: Mapping[bytes, int]
    numbers: Mapping[int, int]

    def __call__(self, data: MeasuredData) -> OfRows:
        names = self.local.caller.names.inputs
        given = np.stack([np.asarray(data[u], dtype=float) for u in names], axis=-1)
        # the place of each row in the table, -1 for none; where rows depend on each other, by its number
        if self.local.independent:
            rows = np.array([self.places.get(u.tobytes(), -1) for u in given], dtype=np.intp)
        else:
            rows = np.array([self.numbers.get(int(n), -1) for n in data.row_numbers], dtype=np.intp)
            rows = np.where((rows >= 0) & (self.local.inputs[rows] == given).all(axis=1), rows, -1)
        return partial(self.local.predict, rows), partial(self.local.slopes_at, rows)

    def remarks(self) -> tuple[Note, ...]:
        known, local = self.local.caller, self.local
        times = plain(known.rows / max(len(local.inputs), 1), 3)
        noise = float(np.max(local.own / local.scale))
        how = f"in {duration(known.seconds)} on {counted(known.workers, 'core')}"
        if known.run < known.rows:
            how = f"{known.run or 'none'} of them {how if known.run else 'by this command'}, the others had been kept"
        else:
            how = f"all {how}"
        text = f"the simulator was called for {counted(known.rows, 'row')}, {times} times the table, {how}; its own "
        text += f"noise is {noise:.1g} times that of the readings"
        text += ", and is added to theirs" * bool(noise > _HEARD)
        if local.rough:
            wide = max(6 * local.steps[v.name] / v.width for v in local.variables if v.name in local.rough)
            text += f"; it is rounded, noisy or jumps: slopes are taken over up to {wide:.0%} of the range of a number"
        text += f"; what led to where it fails ({local.refused}) is not taken" * bool(local.refused)
        values = {"rows": known.rows, "run": known.run, "seconds": known.seconds, "noise": noise}
        return (Note(Code.SIMULATOR_CALLS, text, values=values),)


def _of_new(of_rows: _OnRows, clock: str, within: str, data: MeasuredData) -> MeasuredData:
    """Return rows that are only predicted, with the rates and directions that the fit computed; a file's own stay.

    `clock` is that of the run, `within` the time within a trial.
    """
    local, names = of_rows.local, of_rows.local.caller.names
    made = _moved(data, names.inputs, clock) if clock in data else data
    if within in data and within in local.slopes:
        q = {u: np.asarray(data[u], dtype=float) for u in names.inputs}
        rates = of_rows(data)[1](q | dict(zip(names.parameters, local.parameters)))[within]
        made = made.with_columns({f"{RATE}{y}": rates[:, k] for k, y in enumerate(names.outputs)})
    return made.with_columns(data.columns)


def _say_beforehand(known: Caller, seconds: float, local: LocalModel) -> None:
    """Tell on the terminal how long the simulator, `seconds` for the whole table, will take, where it takes long."""
    p, n = len(known.names.parameters), len(local.inputs)
    of_few = min(FEW / n, 1.0) * (9 + 26 * len(local.variables))  # noise and steps
    of_slopes = (4 if local.rough else 2) * (_CALIBRATIONS * p + len(local.variables))
    passes = int(of_slopes + 2 * _CALIBRATIONS + p * (p + 1) / 2 + of_few + _SEARCH)
    ahead = seconds * passes / max(known.workers, 1)
    if ahead > _LONG:
        a_call = f"{duration(seconds / n)} a row" if known.one else f"{duration(seconds)} for all rows"
        before = sum(1 for _ in known.folder.glob("*.npy"))
        text = (
            f"simulator: {a_call}, about {passes} times {n} rows: {duration(ahead)} on "
            f"{counted(known.workers, 'core')}, less what was kept before ({counted(before, 'call')}); calls are kept "
            f"in {known.folder}, so a command that is killed goes on"
        )
        if (known.code, n, bool(local.rough)) not in _TOLD:
            _TOLD.add((known.code, n, bool(local.rough)))
            print_plain(text, file=sys.stderr, flush=True)


def _refuse_coarse(name: str, local: LocalModel, seen: Array) -> None:
    """Raise `DataError` where an output is rounded to steps larger than its noise, between which it is read."""
    rows = np.arange(min(len(seen), _FEW_OF_UNITS) if local.independent else len(seen))
    here, coarse = local.places[0].values, list[str]()
    with suppress(DataError):  # a little off in all inputs: what lies on the steps there too is rounded
        width = np.array([v.width if v.name in local.steps else 0.0 for v in local.variables if v.is_input])
        [moved] = local.caller.ask([(local.inputs[rows] + _NEARBY * width, local.parameters)])
        for k, y in enumerate(local.caller.names.outputs):
            levels, noise = np.unique(here[:, k]), float(local.scale[k])
            step = float(np.diff(levels).min()) if len(levels) > 1 else 0.0
            if not step / math.sqrt(12) > noise:
                continue
            own, of_moved, read = (
                bool(np.all(np.abs(d / step - np.round(d / step)) < _ON_STEP))
                for d in (levels - levels[0], moved[:, k] - levels[0], seen[:, k] - levels[0])
            )
            if own and of_moved and not read:
                enough = f"state a noise of {step / math.sqrt(12):.2g}, which such steps are worth"
                text = f"{name}: the simulator rounds {y} to steps of {step:.3g}, far more than its noise, {noise:.2g}"
                coarse.append(f"{text}: let it give more digits, or {enough}")
    if coarse:
        raise DataError(coarse[0])


def _refuse_units(data: MeasuredData, local: LocalModel, nominal: Array, seen: Array) -> None:
    """Raise `DataError` where readings are far from the simulator, and other units of theirs cure it.

    Far is a calibrated output that is as far as from shuffled readings, or much nearer to a multiple of them. Cures are
    tried at the nominal parameters: the best factor of each such output, whatever its unit, alone and beside each other
    unit that an input, or all inputs of one stated unit, may be in.
    """

    def stated(column: str) -> tuple[float, ...]:
        """Return the factors between the unit that a column states and others, both ways; of alike ones the first."""
        found: list[float] = []
        for f in (f for one in factors_near(data.units.get(column, "")).values() for f in (one, 1 / one)):
            found += [f] * all(abs(math.log(f / other)) > _ALIKE for other in found)
        return tuple(found)

    rows, names = np.flatnonzero(data.fitted)[:_FEW_OF_UNITS], local.caller.names
    read, inputs = seen[rows], local.inputs[rows]
    mixed = np.random.default_rng(0).permutation(read)

    def misfit(predicted: Array, factors: Array | float = 1.0) -> Array:
        here, there = (np.median(np.abs(factors * y - predicted), axis=0) for y in (read, mixed))
        return np.asarray(np.where(np.isfinite(here) & (there > 0), here / np.where(there > 0, there, 1.0), 1.0))

    def factors(predicted: Array) -> Array:
        """Return by what the readings are to be multiplied, (m,), 1 where it may be an error of their scale."""
        found = np.ones(read.shape[1])
        for k, (name, y, p) in enumerate(zip(names.outputs, read.T, predicted.T)):
            known = (y != 0) & (p / np.where(y != 0, y, 1.0) > 0) & np.isfinite(p)
            if known.sum() < len(y) // 2:
                continue
            # the factor of least deviation; that of two units where one is this near to it, its own before others
            ratio, weight = p[known] / y[known], np.abs(y[known])
            order = np.argsort(ratio)
            middle = float(ratio[order][np.searchsorted(np.cumsum(weight[order]), weight.sum() / 2)])
            nearest = [
                sorted(some, key=lambda f: abs(math.log(f / middle)))[:1] for some in (stated(name), USUAL_FACTORS)
            ]
            found[k] = next((f for [f] in filter(None, nearest) if abs(math.log(f / middle)) < _ALIKE), middle)
        return np.where(np.abs(np.log(found)) > _OF_UNITS, found, 1.0)

    if len(rows) < _FEW_OF_UNITS // 2:
        return
    far = np.ones(len(names.outputs), dtype=np.bool_)
    if local.slopes:  # it is calibrated
        calibrated = local.places[0].values[rows]
        now = misfit(calibrated)
        far = (now > FAR) | (misfit(calibrated, factors(calibrated)) < _CURED * now)
    if not far.any():
        return
    columns = dict(zip(names.inputs, inputs.T))
    found: list[Mistake | None] = [None]
    by_unit: dict[str, list[str]] = {}
    for u in names.inputs if local.independent else ():
        by_unit.setdefault(data.units.get(u, ""), []).append(u)
        found += mistakes.in_units(columns, [u], (("", by) for by in {*USUAL_FACTORS, *stated(u)}))
        found += [mistakes.moved(columns, u, by) for by in (_CELSIUS, -_CELSIUS)]
    for alike in (one for one in by_unit.values() if len(one) > 1):
        found += mistakes.in_units(columns, alike, (("", by) for by in stated(alike[0])))
    cures = []
    for one in found:
        at = inputs.copy()
        for u, column in (one.columns if one else {}).items():
            at[:, names.inputs.index(u)] = column
        with suppress(DataError), np.errstate(all="ignore"):
            [predicted] = local.caller.ask([(at, nominal)])
            for of_outputs in (np.ones(len(far)), np.where(far, factors(predicted), 1.0)):
                words = [_words(one)] if one else []
                words += [f"{y} is multiplied by {f:.6g}" for y, f in zip(names.outputs, of_outputs) if f != 1]
                cures.append((misfit(predicted, of_outputs), len(words), " and ".join(words)))
    best = min(cures, key=lambda cure: (round(float(np.mean(cure[0])), 2), cure[1]))
    if best[2] and best[0][far].max() < _CURED:
        enough = [cure for cure in cures if cure[2] and cure[0][far].max() < _CURED]
        how = min(enough, key=lambda cure: (cure[1], float(np.mean(cure[0]))))[2]
        raise DataError(
            f"{data.name}: the readings are as far from the simulator as shuffled ones, and near to it if {how}: file "
            "and simulator are in other units; write one of them in those of the other"
        )


def _words(mistake: Mistake) -> str:
    names = [*mistake.columns]
    if mistake.kind is Kind.ZERO:
        return f"{mistake.by:+g} is added to {names[0]}"
    return f"{', '.join(names)} {'is' if len(names) == 1 else 'are'} multiplied by {mistake.by:.6g}"


def _moved(data: MeasuredData, inputs: Sequence[str], clock: str) -> MeasuredData:
    """Return the data with rate and direction of each input along the clock, where the file has no columns of them."""
    if not clock:
        return data
    t, at = np.unique(np.asarray(data[clock], dtype=float), return_inverse=True)
    made = along_clock(data, [u for u in inputs if f"{u}_vel" not in data], clock)
    for u in (u for u in inputs if len(t) >= 3 and f"{u}_dir" not in data):
        values = means_at(data[u], at)
        moves = np.sign(np.diff(values, prepend=values[:1]))
        made[f"{WAY}{u}"] = moves[np.maximum.accumulate(np.where(moves != 0, np.arange(len(t)), 0))][at]
    return replace(data.with_columns(made), computed=data.computed | {*made})


def _from_the_second_row(data: MeasuredData, clock: str) -> MeasuredData:
    """Return the data without their first row where the clock tells from where inputs came: of that one it does not."""
    made = [column.removeprefix(WAY) for column in data.columns if column.startswith(WAY)]
    first = np.asarray(data[clock] == np.min(data[clock])) if made else np.zeros(len(data), dtype=np.bool_)
    if first.sum() != 1:
        return data
    which = "inputs" if len(made) > 1 else made[0]
    text = f"the order of {clock} tells from where {which} came, but of the first row, which is left out"
    return data.rows(~first).with_note(Code.TIME_UNKNOWN, text, tuple(made))


describe("simulator", Description(
    stated=(), part_of=str, own_units=True, replaced=("frame_drift", "frame_shift", "polynomial"),
))  # fmt: skip
