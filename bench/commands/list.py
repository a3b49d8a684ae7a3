"""``bench list``: the entries of the registries, with traits and options."""

import json
from dataclasses import asdict
from typing import Any

from calibench.bench.words import split_flags
from calibench.core.options import suggest
from calibench.core.registry import about
from calibench.core.words import print_plain as print

_KINDS = ("problems", "optimizers", "effects", "machines", "studies", "figures")
# written down here: the modules that draw take seconds to import; a test compares it with them
_FIGURES = {
    "convergence": "best error over charged evaluations, median and quartiles, rounding floor",
    "target": "what each method paid to the last target, on one logarithmic axis; where the paper stopped its own",
    "ecdf": "share of targets that each method reached over charged evaluations, of all problems and of each group",
    "critical_difference": "mean rank of each method over the problems; a bar joins those that no test tells apart",
    "overview": "of many methods or problems: the place of each method on each, and its runs at the goal",
    "gauge": "Table 4's and Table 7's printed results on the curve along which no reading changes",
    "plans": "singular values for readings on a line, a circle, two circles and a disc",
    "cong2008_fig3": "Fig. 3 of Cong et al. 2008: GA, PSO and DE under J1, beside the printed ends; fig4 is of J2",
    "cong2008_fig4": "the same under J2", "cong2008_fig5": "the same under J3",
    "orthoglide_residuals": "measured deviations before and after calibration, for three parameter sets",
    "where": "discover: how strongly the residual of each part of the machine depends on each recorded quantity",
    "workspace": "discover: the mean residual of each region over its own noise; calibrate: the error of each pose",
    "candidates": "discover: what each effect of the catalogue explains, the set marked",
    "residuals": "discover: the error of the quantity that an effect changes, before and after",
    "gap": "discover: the error on readings that were not fitted over the noise floor",
    "noise": "discover: what was seen of noise that is blamed: outlying readings, steps of a sensor, heavy tails",
    "errors": "calibrate: the share of poses below each error, before and after",
    "joints": "calibrate: the error over the angle of each joint, before and after",
}  # fmt: skip


def run(argv: list[str]) -> int:
    """Print the kind that `argv` names, or its entries named after it; only modules of that kind are imported."""
    flags, words = split_flags(argv, ("--json", "--all"))
    kind, names = (words[0], words[1:]) if words else ("", [])
    if kind not in _KINDS:
        what = f"list {kind}: no such kind" if words else "list: what is to be listed is missing"
        raise ValueError(f"{what}; {suggest(kind, _KINDS)}")
    rows = [] if names and all(":" in name for name in names) else _rows(kind)
    listed = {row["name"]: row for row in rows}
    for name in names:
        if name in listed:
            continue
        if ":" not in name or kind not in ("problems", "optimizers"):
            raise ValueError(f"list {kind} {name}: no such name; {suggest(name, listed)}")
        registry = _registry(kind)  # a user's own
        own = {"name": registry.told_name(name), "about": about(registry.factory(name))}
        listed[name] = own | {"options": _options(registry, name)}
    rows = [listed[name] for name in names] if names else rows
    if "--all" in flags and not names and kind in ("problems", "optimizers"):
        left_out = _registry(kind).left_out.items()
        rows += [{"name": name, "about": reason, "left_out": True} for name, reason in left_out]
    if "--json" in flags:
        print(json.dumps(rows, indent=1))
        return 0
    for row in rows:
        traits = [k for k, v in row.get("traits", {}).items() if v is True]
        if (most := row.get("traits", {}).get("maximum_dimension")) is not None:
            traits.append(f"at most {most} dimensions")
        traits += row.get("tags", [])
        traits += ["left out"] if row.get("left_out") else []
        print(f"{row['name']}" + (f"  [{', '.join(traits)}]" if traits else ""))
        if row["about"]:
            print(f"    {row['about']}")
        if row.get("options"):
            print(f"    {'  '.join(option['text'] for option in row['options'])}")
    return 0


def _registry(kind: str) -> Any:
    from calibench import optimizers, problems

    return problems.registry if kind == "problems" else optimizers.registry


def _rows(kind: str) -> list[dict[str, Any]]:
    if kind == "figures":
        return [{"name": name, "about": shows} for name, shows in _FIGURES.items()]
    if kind == "studies":
        from calibench.bench.sweep.composition import study_names, study_preset

        return [{"name": name, "about": (study_preset(name) or {})["description"]} for name in study_names()]
    if kind in ("problems", "optimizers"):
        registry, rows = _registry(kind), []
        for name, factory in registry.factories().items():
            row = {"name": name, "about": about(factory)}
            if kind == "optimizers":
                needs = any(option.required for option in registry.options(name).values())
                traits = getattr(None if needs else factory(), "traits", None)
                row["traits"] = {} if traits is None else asdict(traits)
            rows.append(row | {"options": _options(registry, name)})
        return rows
    from calibench.discrepancy import effects, machines
    from calibench.discrepancy.registries import machines as registry_of_machines

    if kind == "machines":
        return [
            {
                "name": name, "about": about(registry_of_machines.factories()[name]),
                "options": _options(registry_of_machines, name),
                "effects": [family.name for family in effects.families(name)],
            }
            for name in machines.names()
        ]  # fmt: skip
    return [
        {
            "name": family.name, "about": f"{family.cause}: {family.formula}", "machine": family.machine,
            "tags": [family.machine, family.channel], "formula": family.formula, "channel": family.channel,
            "unit": family.unit, "targets": list(family.targets), "columns": list(family.columns),
            "twins": family.twins,
        }
        for machine in machines.names()
        for family in effects.families(machine)
    ]  # fmt: skip


def _options(registry: Any, name: str) -> list[dict[str, Any]]:
    return [
        {"name": o.name, "default": o.default, "required": o.required, "text": o.describe()}
        for o in registry.options(name).values()
    ]
