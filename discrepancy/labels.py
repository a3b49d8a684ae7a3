"""The words for families, columns and parameters, as machines declare them.

Sensors that a machine states in its formulation have words of their own (`Sensor.label`); here are those of everything
that a machine declares, and of the laws of the noise, which are the same for all machines.
"""

from collections.abc import Mapping

from calibench.core.tables.columns import Quantity
from calibench.discrepancy.registries import description_of, family_of

NO_WORDS: Mapping[str, str] = {}
_NOISE = {"outlier": "outlying readings", "heavy_tails": "heavy-tailed noise", "quantisation": "coarse quantisation"}
_PLACE = {
    "place": Quantity("place", "", "place in the workspace"),
    "place_x": Quantity("place_x", "mm", "x of the tool"),
    "place_y": Quantity("place_y", "mm", "y of the tool"),
}  # covariates that smooth terms over the workspace have on every machine

_OFTEN = ("once", "twice")  # how a target of a period begins, which is no part


def effect_label(machine: str, family: str, target: str, again: bool = False) -> str:
    """Return an effect in words; without a target, its family. With `again`, the short code of its field alone.

    >>> effect_label("gpm2002", "backlash", "joint 2"), effect_label("gpm2002", "thermal_links", "all")
    ('backlash of joint 2', 'thermal growth of all links')
    >>> effect_label("table", "known_cycle", "twice in month")
    'cycle of known period, twice in month'
    >>> effect_label("arm", "slip", "tool"), effect_label("orthoglide", "bar_skew", "common")
    ('slip of the tool', 'bar skew, common in the three axes')
    """
    known = family_of(machine, family)
    label = (known.code if again else "") or known.label if known else ""
    words = _NOISE.get(family) or label or family.replace("_", " ")
    if not target:
        return words
    if target == "all":
        of_all = words if family in _NOISE else known.label_of_all if known else ""
        return of_all or f"{words} (all)"
    way = description_of(machine).targets.get(target)
    if way is not None:
        between = " of " if way.startswith("the ") else ", "  # a part, or a way
        return f"{words}{between}{way}" if way else words
    kind = target.partition(" ")[0]
    if kind in _OFTEN:
        return f"{words}, {target}"
    return f"{words.removeprefix(f'{kind} ')} of {target}"  # not "base shift of base 1"


def part_label(machine: str, target: str) -> str:
    """Return the part of a machine that a target is, in words; "" where it is none, as the whole machine, or a way.

    Of the targets that a machine has words for, parts are those whose words begin with an article.

    >>> part_label("gpm2002", "joint 2"), part_label("arm", "base")
    ('joint 2', 'the base')
    >>> part_label("gpm2002", "all"), part_label("orthoglide", "common")
    ('', '')
    """
    label = description_of(machine).targets.get(target)
    if label is not None:
        return label if label.startswith("the ") else ""
    return "" if target == "all" else target


def quantity_of(machine: str, name: str) -> Quantity:
    """Return what a machine declares of a column, a parameter or a covariate; its bare name where it declares nothing.

    >>> quantity_of("gpm2002", "lb3").label, quantity_of("gpm2002", "tau_1").unit
    ('distal link 3', 'N mm')
    """
    return description_of(machine).quantity(name) or _PLACE.get(name) or Quantity(name)


def quantity_label(machine: str, name: str, words: Mapping[str, str] = NO_WORDS) -> str:
    """Return the name of a column, quantity or covariate in words: the machine's, or those of its roles, `words`.

    >>> [quantity_label("gpm2002", name) for name in ("enc_2", "dir_1", "lb3", "t_s")]
    ['angle of joint 2', 'direction of joint 1', 'distal link 3', 'time']
    """
    return quantity_of(machine, name).label or words.get(name) or name.replace("_", " ")
