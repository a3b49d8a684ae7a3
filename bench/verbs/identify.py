"""``bench identify``: what the data of a problem can tell at all."""

from __future__ import annotations

import json

from bedrock.registry import coerce
from bench.request import build_member
from bench.verbs.terminal import print_table
from bench.verbs.words import split_flags
from problems import identify


def run(argv: list[str]) -> int:
    """Print rank, gauge, singular values and standard errors of the problem that `argv` names."""
    flags, words = split_flags(argv, ("--json",))
    noise = [w.partition("=")[2] for w in words if w.startswith("noise=")]
    problem = build_member("problem", [w for w in words if not w.startswith("noise=")])
    try:
        sigma = coerce("noise", float(noise[-1]), float) if noise else None
    except ValueError:
        raise ValueError(f"noise={noise[-1]}: a number (rad, or mm for the Orthoglide) is needed") from None
    found = identify(problem, noise=sigma)
    if "--json" in flags:
        print(json.dumps(found.to_dict(), indent=1))
        return 0
    print(f"{problem.name}: {found.sentence()}\n")
    print(f"singular values [{found.noise_unit}/mm]: {'  '.join(f'{s:.3g}' for s in found.singular_values)}\n")
    rows = [
        [name, unit, f"{value:.6g}", f"{error:.3g}" if error < float("inf") else "cannot be found"]
        for name, unit, value, error in zip(found.names, found.units, found.x, found.standard_errors, strict=True)
    ]
    print_table(["parameter", "unit", "value", f"standard error at {found.noise:g} {found.noise_unit}"], rows)
    return 0
