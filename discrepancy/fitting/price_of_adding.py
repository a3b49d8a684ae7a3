"""The penalty for a family that entered the catalogue after the data had been seen.

The p of the best candidate is corrected for the number of candidates, if the list was written before the data. Here a
family was written because of the residuals: the list itself depends on the data, and other families might have been
written instead. So there are three p-values, each at least as large as the one before: for the catalogue as it is; for
all families ever tried, also those that were removed again; and for these with `others` further families of the same
shape that might have been written. Each of these is taken to point anywhere in the residual space: on noise it does as
well as the family itself does, independently, so p = 1 - (1 - p of all ever tried) (1 - p of the family alone) ^
others.
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
