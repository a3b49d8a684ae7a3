"""Simulated readings have the same bits with and without the wide registers of a processor."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from calibench.problems.planar.gpm2002 import arccos, arctan2, cos, sin

_DIGEST = """
from calibench import problems
print([problems.make(name).data_id for name in ("sensor_zero", "link_length", "full11", "full12", "tracking_zero")])
"""


def _told(**disabled: str) -> str:
    made = subprocess.run(
        [sys.executable, "-c", _DIGEST], capture_output=True, text=True, check=True, env=os.environ | disabled
    )
    return made.stdout


def test_readings_have_the_same_bits_on_a_processor_with_narrow_registers() -> None:
    found = np.__config__.CONFIG["SIMD Extensions"].get("found", [])
    wide = [name for name in found if name.startswith(("AVX512", "X86_V4"))]
    if not wide:
        pytest.skip("this processor has no wider registers that NumPy would use")
    assert _told() == _told(NPY_DISABLE_CPU_FEATURES=" ".join(wide))


def test_angles_are_those_of_numpy_but_for_the_last_bit() -> None:
    x = np.linspace(-1, 1, 41).reshape(41, 1)
    assert cos(3 * x).shape == (41, 1)
    np.testing.assert_allclose(cos(3 * x), np.cos(3 * x), rtol=0, atol=3e-16)
    np.testing.assert_allclose(sin(3 * x), np.sin(3 * x), rtol=0, atol=3e-16)
    np.testing.assert_allclose(arccos(x), np.arccos(x), rtol=3e-16)
    np.testing.assert_allclose(arctan2(x, x.T), np.arctan2(x, x.T), rtol=3e-16)
    assert np.isnan(arccos([1.5, -2.0])).all()
