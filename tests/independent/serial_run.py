"""Search a stated batch of arms and write an answer a line: ``python -m tests.independent.serial_run mixed out.jsonl``.

What is in the file already is not searched again; a third word is the seed to begin with. ``... score out.jsonl``
prints the rates of what the files hold.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from calibench.discrepancy import MeasuredData, explain
from calibench.discrepancy.machines.arm import Arm
from tests.independent.serial_cases import case
from tests.independent.serial_score import Answer, answer, batches, from_plain, score


def told(seed: int, unstated: Sequence[str] = (), **asked: object) -> Answer:
    """Return the answer to one case, of which the search is not told what is `unstated`, such as `sigma_mm`."""
    drawn = case(seed, **asked)  # type: ignore[arg-type]
    stated = {name: value for name, value in drawn.stated.items() if name not in unstated}
    with TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        path.write_text(drawn.urdf)
        return answer(seed, drawn, explain(Arm(str(path)), MeasuredData(drawn.columns, "arm", stated, f"arm{seed}")))


def main(name: str, *files: str) -> None:
    """Search a batch, or score files of answers."""
    if name == "score":
        lines = [json.loads(line) for file in files for line in Path(file).read_text().splitlines()]
        print(*score([from_plain(line) for line in lines]), sep="\n")
        return
    [batch] = [one for one in batches() if one["name"] == name]
    out = Path(files[0])
    known = {json.loads(line)["seed"] for line in out.read_text().splitlines()} if out.exists() else set()
    with out.open("a") as file:
        first = int(files[1]) if len(files) > 1 else batch["first"]
        for seed in range(first, batch["last"] + 1):
            if seed not in known:
                print(json.dumps(told(seed, **batch["asked"]).plain()), file=file, flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
