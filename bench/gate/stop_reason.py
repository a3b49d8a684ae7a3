"""Why a run ended: the words of the column `stop_reason`, listed here and nowhere else.

A new reason is entered here, set where it happens (in the gate, as `Evaluator.stopped`, or in
`calibench.bench.execution.outcome`), and told in docs/results.md.
"""

from __future__ import annotations

from typing import Literal, get_args

ByGate = Literal["budget", "target", "timeout"]  # the gate refused a call: the run would have gone on
StopReason = Literal["converged", "budget", "target", "failed", "timeout"]

BY_GATE: tuple[ByGate, ...] = get_args(ByGate)
STOP_REASONS: tuple[StopReason, ...] = get_args(StopReason)
