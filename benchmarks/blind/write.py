"""Write sealed cases: ``python -m benchmarks.blind.write --seeds 0:600 --to DIR --sealed OTHER_DIR``."""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

from benchmarks.blind.gpm2002 import noise
from benchmarks.blind.gpm2002.record import write
from benchmarks.blind.gpm2002.simulate import KINDS, case


def main(arguments: list[str] | None = None) -> None:
    """Simulate and write the cases that the command line asks for."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.blind.write", description=__doc__)
    parser.add_argument("--seeds", required=True, help="A:B, A included, B not")
    parser.add_argument("--to", type=Path, required=True, help="folder for the measured files")
    parser.add_argument("--sealed", type=Path, required=True, help="another folder, for the truths")
    parser.add_argument("--kind", choices=KINDS)
    parser.add_argument("--family")
    parser.add_argument("--target")
    parser.add_argument("--lam", type=float, help="visible size in sigma, of every effect")
    parser.add_argument("--noise", choices=noise.LAWS)
    parser.add_argument("--xy", choices=("yes", "no"))
    parser.add_argument("--bent", action="store_true", help="every effect's form off by 5 to 15 %% of its size")
    parser.add_argument("--workers", type=int, default=1)
    asked = parser.parse_args(arguments)
    first, _, last = asked.seeds.partition(":")
    seeds = range(int(first), int(last)) if last else range(int(first))
    one = partial(
        _one,
        to=asked.to,
        sealed=asked.sealed,
        options={
            "kind": asked.kind,
            "family": asked.family,
            "target": asked.target,
            "lam": asked.lam,
            "noise": asked.noise,
            "bent": asked.bent,
            "xy": None if asked.xy is None else asked.xy == "yes",
        },
    )
    if asked.workers == 1:
        for seed in seeds:
            one(seed)
    else:
        with ProcessPoolExecutor(asked.workers) as pool:
            list(pool.map(one, seeds, chunksize=16))
    print(f"{len(seeds)} cases in {asked.to}, their truths in {asked.sealed}")


def _one(seed: int, to: Path, sealed: Path, options: dict[str, object]) -> None:
    write(case(seed, **options), to, sealed, f"case_{seed:05d}")


if __name__ == "__main__":
    main()
