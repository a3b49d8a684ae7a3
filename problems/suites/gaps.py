"""How far above its minimum a value of a suite's function is looked at: the gaps that COCO and IOH share."""

from __future__ import annotations

COCO_GAPS = tuple(10.0 ** (k / 5) for k in range(10, -41, -1))  # 51: 1e2 to 1e-8, the floats that cocopp has
