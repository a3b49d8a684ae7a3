"""``bench identify``: which parameters the data of a problem determine."""

from __future__ import annotations

from calibench.bench.commands.arguments import split_flags
from calibench.bench.commands.console import print_json, print_table
from calibench.bench.sweep.request import build_member
from calibench.bench.sweep.words import read_pairs
from calibench.core.options import coerce, shown
from calibench.core.words import plain
from calibench.core.words import print_plain as print
from calibench.problems import identify


def run(argv: list[str]) -> int:
    """Print rank, gauge, singular values and standard errors of the problem that `argv` names."""
    flags, words = split_flags(argv, ("--json",))
    of_problem = [word for word in words if word.partition("=")[0].partition(".")[0] == "problem"]
    given = read_pairs(
        "identify", [word for word in words if word not in of_problem], {"problem": "full12", "noise": "1e-4"}
    )
    problem = build_member("problem", of_problem)
    try:
        sigma = coerce("noise", float(given["noise"]), float) if "noise" in given else None
    except ValueError:
        raise ValueError(f"noise={shown(given['noise'])}: a number (rad, or mm for the Orthoglide) is needed") from None
    known = identify(problem, noise=sigma)
    if "--json" in flags:
        print_json(known.to_dict())
        return 0
    print(f"{getattr(problem, 'name', type(problem).__name__)}: {known.sentence()}\n")
    unit = known.noise_unit + ("/mm" if any(known.units) else "")
    print(f"singular values [{unit}]: {'  '.join(f'{plain(s, 3)}' for s in known.singular_values)}\n")
    rows = [
        [name, unit, f"{value:.6g}", f"{plain(error, 3)}" if error < float("inf") else "cannot be found"]
        for name, unit, value, error in zip(known.names, known.units, known.x, known.standard_errors, strict=True)
    ]
    print_table(["parameter", "unit", "value", f"standard error at {known.noise:g} {known.noise_unit}"], rows)
    return 0
