"""What a method is called that a user chose by the name of a preset, ``optimizer=fmincon_matlab``: by that name.

A preset is a file of ``conf/optimizer/``: a registered optimiser, or another preset, with other options. Rows hold the
optimiser and its options; tables, figures and pages say the shorter name that stands for both.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

from calibench import conf, optimizers
from calibench.bench.provenance.run_id import canonical, options_of

CONF = Path(conf.__file__).resolve().parent


@cache
def preset_names() -> dict[tuple[str, str], str]:
    """Return (optimiser, its options as canonical JSON) -> the preset that has just these options."""
    found: dict[tuple[str, str], str] = {}
    for path in sorted((CONF / "optimizer").glob("*.yaml")):
        name, options = _resolved(path.stem)
        if name in optimizers.registry:
            found.setdefault((name, canonical(options_of(optimizers.make(name, **options)))), path.stem)
    return found


def _resolved(preset: str) -> tuple[str, dict[str, Any]]:
    """Return the registered name at the end of a preset's `defaults`, and the options on the way."""
    from omegaconf import OmegaConf

    path = CONF / "optimizer" / f"{preset}.yaml"
    if not path.is_file():
        return preset, {}
    said: Any = OmegaConf.to_container(OmegaConf.load(path))
    base = next((entry for entry in said.pop("defaults", []) if entry != "_self_"), said.pop("name", preset))
    name, options = _resolved(str(base))
    return name, options | said
