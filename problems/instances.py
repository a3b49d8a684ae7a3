"""Instances of a family of problems: ``problem.instance=K`` draws a machine, a plan, a noise, a box and a data seed.

An instance is a block of a test, whereas a repetition is not; docs/instances.md says what each family draws. Each drawn
thing has a stream of its own, seeded by names: family, K, attempt, thing; so a family that draws one thing more leaves
all others as they were. Only uniform numbers are drawn, and what follows is rounded to stated digits, so no last bit
that differs between two machines reaches the problem.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Generic, TypeVar, final

import numpy as np

from calibench.core.options import Range, shown
from calibench.core.seeds import seed_sequence
from calibench.problems.base import Array

T = TypeVar("T")
M = TypeVar("M")
P = TypeVar("P")
Seed = Annotated[int, Range(0)]
Sigma = Annotated[float, Range(0, unit="a standard deviation, mm")]
Radians = Annotated[float, Range(0, 1, unit="a standard deviation, rad")]  # above 1 rad nothing is left of a reading
WORST_CONDITION = 1e4  # of the identifiable part: a disc of R 100 has 9e2, one circle of R 80 6e4
WORST_ERROR = 1.0  # mm: what the noise may leave in the worst direction that can be seen (angles times 244 mm)
_ATTEMPTS = 1000
_WITHOUT_NOISE = 0.25


@final
@dataclass(frozen=True)
class Stream:
    """The uniform numbers of one drawn thing, seeded by its names."""

    rng: np.random.Generator

    @staticmethod
    def of(family: str, instance: int, attempt: int, thing: str) -> Stream:
        """Return the stream of `thing` in this attempt at this instance of `family`."""
        return Stream(np.random.default_rng(seed_sequence(family, "instance", instance, thing, repetition=attempt)))

    def between(self, low: float, high: float) -> float:
        """Return a number uniform in low .. high."""
        return float(low + (high - low) * self.rng.random())

    def log_between(self, low: float, high: float) -> float:
        """Return a number whose logarithm is uniform between those of low and high."""
        return float(low * (high / low) ** self.rng.random())

    def whole(self, low: int, high: int) -> int:
        """Return a whole number, each of low .. high as likely."""
        return low + int((high - low + 1) * self.rng.random())

    def one_of(self, choices: Sequence[T]) -> T:
        """Return one of `choices`, each as likely."""
        return choices[self.whole(0, len(choices) - 1)]

    def sign(self) -> float:
        """Return 1 or -1."""
        return 1.0 if self.rng.random() < 0.5 else -1.0


@final
@dataclass(frozen=True)
class Noise:
    """The noise of the readings: its standard deviation (0: none), and the seed of the data."""

    level: float
    data_seed: int

    @staticmethod
    def drawn(stream: Stream, low: float, high: float) -> Noise:
        """Draw none, or a level log-uniform in low .. high."""
        none, level = stream.between(0, 1) < _WITHOUT_NOISE, stream.log_between(low, high)
        return Noise(0.0 if none else float(f"{level:.1e}"), stream.whole(0, 2**31 - 1))


@final
@dataclass(frozen=True, eq=False)
class Box:
    """Where each parameter starts and truly is, and the box in which it is sought: arrays of shape (dim,)."""

    start: Array
    truth: Array
    lower: Array
    upper: Array

    @staticmethod
    def drawn(stream: Stream, start: Array, half: Array, digits: Sequence[int]) -> Box:
        """Draw a truth beside each `start`, and a box that holds both; `half` is the half-width of the paper's box.

        Values are rounded to `digits` decimals.
        """
        rows = []
        for at, wide, places in zip(start.tolist(), half.tolist(), digits, strict=True):
            error = stream.sign() * stream.between(0.1, 0.6) * wide
            width = 2 * wide * stream.log_between(1, 2)
            away = error / width  # from the start to the truth, in widths: at most .3
            low, high = round(max(0.05, 0.05 + away), 12), round(min(0.95, 0.95 + away), 12)

            # the truth's share of the box: uniform over what both may have, without the middle
            pieces = [(a, b) for a, b in ((low, min(high, 0.45)), (max(low, 0.55), high)) if b > a]
            rest = stream.between(0, sum(b - a for a, b in pieces))
            share = pieces[-1][1]
            for a, b in pieces:
                if rest <= b - a:
                    share = a + rest
                    break
                rest -= b - a

            truth = round(at + error, places)
            lower = round(truth - share * width, places)
            rows.append((at, truth, lower, round(lower + width, places)))
        return Box(*np.array(rows).T)


@final
@dataclass(frozen=True, eq=False)
class Drawn(Generic[M, P]):
    """What ``instance=K`` of a family draws: a machine and a plan as the family has them, box, noise.

    It decides the family's `options`; `attempts` were drawn until one could be identified.
    """

    machine: M
    box: Box
    plan: P
    noise: Noise
    options: Mapping[str, Any]
    attempts: int


def refuse_drawn(family: str, instance: int, given: dict[str, Any], drawn: dict[str, Any]) -> None:
    """Raise `ValueError` for an option that was given otherwise than the instance has it; the same value is no harm."""
    for key, value in drawn.items():
        if given.get(key) is not None and given[key] != value:
            raise ValueError(
                f"{family}.{key}={shown(given[key])}: instance={instance} means {key}={shown(value)}; leave one of the "
                "two out"
            )


def first_that_fits(family: str, instance: int, attempt: Callable[[int], T | None]) -> T:
    """Return what the first of the attempts 0, 1, ... gives that gives something."""
    for number in range(_ATTEMPTS):
        found = attempt(number)
        if found is not None:
            return found
    raise ValueError(f"{family}.instance={instance}: none of {_ATTEMPTS} draws can be identified; take another")


def can_be_identified(problem: Any, rank: int, noise: float) -> bool:
    """Tell whether readings of `problem` (without noise) see `rank` directions, and `noise` leaves none too uncertain.

    `noise` is the standard deviation of a reading.
    """
    from calibench.problems.identifiability import identify  # only an instance needs it

    found = identify(problem)
    least = float(found.singular_values[rank - 1])
    return found.rank == rank and found.condition <= WORST_CONDITION and noise <= WORST_ERROR * least
