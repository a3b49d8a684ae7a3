"""Write the simulated printer.cfg that ships as ``data=printer``: ``python -m tests.independent.write_printer``."""

from pathlib import Path

import numpy as np

from calibench import discrepancy
from tests.independent.delta import Firmware, honest, measured, places, printer_cfg, spoilt

SHIPPED = Path(discrepancy.__file__).resolve().parent / "demo" / "delta" / "printer.cfg"


def text():
    """Return the file: a radius .74 mm too small in it, and tower b 3.5 mrad off."""
    rng, firmware = np.random.default_rng([20261122, 1]), Firmware()
    printer = spoilt(honest(firmware, rng), "delta_radius all", 0.74, rng)
    printer = spoilt(printer, "tower_angle tower b", 0.0035, rng)
    probed, *ends = places(rng, 19, 12, 140.0)
    columns, _ = measured(printer, firmware, probed, ends, (0.02, 0.05), rng)
    return printer_cfg(columns, firmware, firmware.mm_per_step, 140.0)


if __name__ == "__main__":
    SHIPPED.write_text(text())
