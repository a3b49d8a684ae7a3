"""The penalty for a family that entered the catalogue after the data had been seen.

The p of the best of all tried counts the candidates of a list that was there before the data. A family that was written
because of what the fit had left is another thing: the list itself followed the data, and others might have been written
in its place. Three prices follow, each at least the one before: of the catalogue as it stands; of all that was ever
tried, what was taken out again too; and of that with the freedom to write one of `others` further families of the same
shape. For the last, each of them lies in the residual space any way round: on noise it does as well as the family
itself does, independently, so p = 1 - (1 - p of all ever tried) (1 - p of the family alone) ^ others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

from calibench.discrepancy.fitting.small_sample import Calibrated, SmallSample, small_sample
from calibench.discrepancy.model.effect import Effect


@final
@dataclass(frozen=True)
class Price:
    """`name`, the best candidate, with its own p and the chance that the best of each list does as well on noise.

    `listed`: of the list without what was added, in which the name must stand; None where it does not. `now`: of the
    catalogue as it stands. `ever`: of all that was ever tried, `tried` candidates. `chosen`: with the freedom to write
    `others` further families; None for a name that was there from the beginning, which needed no such freedom.
    """

    name: str
    p: float
    listed: float | None
    now: float
    ever: float
    chosen: float | None
    tried: int
    others: int

    @property
    def right(self) -> float:
        """Return the price that counts: with the choice where there was one, else that of all families ever tried."""
        return self.ever if self.chosen is None else self.chosen


def price(
    about: Calibrated, catalogue: Sequence[Effect], taken_out: Sequence[Effect], added: str, draws: int = 5_000
) -> tuple[Price, Price]:
    """Return the prices of the best candidate of the family `added`, and of the best that was there without it.

    `catalogue` is the list as it stands, `taken_out` what was tried once and is no candidate any more. As many further
    families might have been written as there are other ones in the catalogue.
    """
    own = [e for e in catalogue if e.family == added]
    first = [*(e for e in catalogue if e.family != added), *taken_out]
    others = len({e.family for e in catalogue} - {added})
    lists = [small_sample(about, chosen, draws=draws) for chosen in (first, catalogue, [*catalogue, *taken_out], own)]
    listed, now, ever, alone = lists
    late = alone.candidates[0]
    kept = {c.name for c in now.candidates}
    early = next(c for c in listed.candidates if c.name in kept)
    chosen = 1 - (1 - ever[late.name].p_tried) * (1 - alone[late.name].p_tried) ** others
    return (
        Price(late.name, late.p, None, now[late.name].p_tried, ever[late.name].p_tried, chosen, ever.tried, others),
        _early(early.name, listed, now, ever, others),
    )


def _early(name: str, listed: SmallSample, now: SmallSample, ever: SmallSample, others: int) -> Price:
    return Price(
        name, listed[name].p, listed[name].p_tried, now[name].p_tried, ever[name].p_tried, None, ever.tried, others
    )
