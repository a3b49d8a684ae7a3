"""`combine(x, a, b, c, f, y, at)`: four neighbours at once of y = x_a + f (x_b - x_c), rounded as one by one.

The compiler fills the lanes from loops of 16 turns or more only: rows of a population are shorter, and it takes them a
number at a time. Written out, a row of 12 is three such steps.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic, overload
from numpy.typing import NDArray

LANES = 4


def combine(x: NDArray[np.float64], a: int, b: int, c: int, f: float, y: NDArray[np.float64], at: int) -> None:
    """Write y[at : at + 4] = x[a : a + 4] + f (x[b : b + 4] - x[c : c + 4]); all must exist, and none is negative."""
    y[at : at + LANES] = x[a : a + LANES] + f * (x[b : b + LANES] - x[c : c + LANES])


@intrinsic
def _instructions(_typing: Any, x: Any, a: Any, b: Any, c: Any, f: Any, y: Any, at: Any) -> Any:
    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        vector = ir.VectorType(ir.DoubleType(), LANES)

        def place(array: int, index: int) -> Any:
            data = context.make_array(signature.args[array])(context, builder, value=arguments[array]).data
            return builder.bitcast(builder.gep(data, [arguments[index]]), vector.as_pointer())

        first, plus, minus = (builder.load(place(0, index), align=8) for index in (1, 2, 3))
        factor = ir.Constant(vector, ir.Undefined)
        for lane in range(LANES):
            factor = builder.insert_element(factor, arguments[4], ir.Constant(ir.IntType(32), lane))
        result = builder.fadd(first, builder.fmul(factor, builder.fsub(plus, minus)))
        builder.store(result, place(5, 6), align=8)
        return context.get_dummy_value()

    return types.none(x, types.intp, types.intp, types.intp, types.float64, y, types.intp), emit


@overload(combine)
def _compiled(x, a, b, c, f, y, at):  # type: ignore[no-untyped-def]  # numba compares this signature with the one it returns
    return lambda x, a, b, c, f, y, at: _instructions(x, a, b, c, f, y, at)  # type: ignore[call-arg]
