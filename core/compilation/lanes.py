"""What kernels need to run with candidates in the SIMD lanes, with the same bits in the lanes, alone, and interpreted.

`cross` (differential evolution) and `exchange` (genetic algorithm) take four neighbours of a row at once: the compiler
fills the lanes from loops of 16 turns or more only, and rows of a population are shorter. `fma(a, b, c)` is a b + c
rounded once: a compiler left to contract products by itself does so where it likes, and a batch gets other bits than a
call. `cos_sin` calls no C library: the argument less its quarter turns, r in -pi/4 .. pi/4, goes into both Taylor
series, cut where a term is below a quarter of the last bit; the errors are below 1.5 units in the last place.
"""

import ctypes
import math
import sys
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic, overload
from numpy.typing import NDArray

from calibench.core.compilation.compiled import njit

Array = NDArray[np.float64]
Words = NDArray[np.int64]
LANES = 4


def cross(
    x: Array, own: int, a: int, b: int, c: int, f: float, chances: NDArray[np.uint32], at: int, highest: np.uint32,
    low: Array, high: Array, j: int, y: Array,
) -> int:  # fmt: skip
    """Write y[own : own + 4]: x_a + f (x_b - x_c) where a chance is at most `highest`, else x_own.

    Return 0 where all four lie from `low` to `high`, else another number. Of each array four neighbours are meant: of x
    from `own`, `a`, `b`, `c` on, of the chances from `at`, of the bounds from `j`. All must exist, none be negative.
    """
    mutant = x[a : a + LANES] + f * (x[b : b + LANES] - x[c : c + LANES])
    value = np.where(chances[at : at + LANES] <= highest, mutant, x[own : own + LANES])
    y[own : own + LANES] = value
    return int(not ((low[j : j + LANES] <= value) & (value <= high[j : j + LANES])).all())


def exchange(
    x: Words, a: int, b: int, point: int, ends: Words, lengths: Words, j: int, y: Words, at: int, beside: int
) -> None:
    """Write y[at : at + 4] and y[beside : beside + 4]: x_a and x_b, their bits behind `point` exchanged.

    The numbers from `a` and from `b` on are parts of two strings, of so many bits as `lengths` say from `j` on. `ends`
    count the bits of a string to the end of each, `point` those in front of the point. No index is negative.
    """
    first, second, here = x[a : a + LANES], x[b : b + LANES], slice(j, j + LANES)
    behind = np.minimum(np.maximum(ends[here] - point, 0), lengths[here])
    exchanged = (first ^ second) & ((1 << behind) - 1)
    y[at : at + LANES], y[beside : beside + LANES] = first ^ exchanged, second ^ exchanged


@final
@dataclass(frozen=True)
class _Row:
    """The instructions that take four neighbours out of arrays, and put them there: both are told by argument."""

    context: Any
    builder: Any
    signature: Any
    given: Any

    def load(self, array: int, index: int) -> Any:
        place = self._place(array, index)
        return self.builder.load(place, align=self.context.get_abi_sizeof(place.type.pointee.element))

    def store(self, vector: Any, array: int, index: int) -> None:
        self.builder.store(vector, self._place(array, index), align=8)

    def everywhere(self, number: int) -> Any:
        vector = ir.Constant(ir.VectorType(self.given[number].type, LANES), ir.Undefined)
        for lane in range(LANES):
            vector = self.builder.insert_element(vector, self.given[number], ir.Constant(ir.IntType(32), lane))
        return vector

    def _place(self, array: int, index: int) -> Any:
        kind, value = self.signature.args[array], self.given[array]
        data = self.context.make_array(kind)(self.context, self.builder, value=value).data
        vector = ir.VectorType(data.type.pointee, LANES)
        return self.builder.bitcast(self.builder.gep(data, [self.given[index]]), vector.as_pointer())


@intrinsic
def _cross(
    _typing: Any, x: Any, own: Any, a: Any, b: Any, c: Any, f: Any, chances: Any, at: Any, highest: Any, low: Any,
    high: Any, j: Any, y: Any,
) -> Any:  # fmt: skip
    def emit(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        row = _Row(context, builder, signature, given)
        member, first, plus, minus = (row.load(0, index) for index in (1, 2, 3, 4))
        mutant = builder.fadd(first, builder.fmul(row.everywhere(5), builder.fsub(plus, minus)))
        crosses = builder.icmp_unsigned("<=", row.load(6, 7), row.everywhere(8))
        value = builder.select(crosses, mutant, member)
        row.store(value, 12, 1)
        above, below = (
            builder.fcmp_ordered("<=", *pair) for pair in ((row.load(9, 11), value), (value, row.load(10, 11)))
        )
        outside = builder.not_(builder.and_(above, below))
        return builder.zext(builder.bitcast(outside, ir.IntType(LANES)), ir.IntType(64))

    return types.int64(
        x, types.intp, types.intp, types.intp, types.intp, types.float64, chances, types.intp, types.uint32, low, high,
        types.intp, y,
    ), emit  # fmt: skip


@overload(cross)
def _compiled_cross(x, own, a, b, c, f, chances, at, highest, low, high, j, y):  # type: ignore[no-untyped-def]  # numba compares this signature with the one it returns
    return lambda x, own, a, b, c, f, chances, at, highest, low, high, j, y: _cross(  # type: ignore[call-arg]
        x, own, a, b, c, f, chances, at, highest, low, high, j, y
    )


@intrinsic
def _exchange(
    _typing: Any, x: Any, a: Any, b: Any, point: Any, ends: Any, lengths: Any, j: Any, y: Any, at: Any, beside: Any
) -> Any:
    def emit(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        row = _Row(context, builder, signature, given)
        first, second, length = row.load(0, 1), row.load(0, 2), row.load(5, 6)
        none, one = (ir.Constant(length.type, [number] * LANES) for number in (0, 1))
        behind = builder.sub(row.load(4, 6), row.everywhere(3))
        behind = builder.select(builder.icmp_signed(">", behind, none), behind, none)
        behind = builder.select(builder.icmp_signed("<", behind, length), behind, length)
        exchanged = builder.and_(builder.xor(first, second), builder.sub(builder.shl(one, behind), one))
        row.store(builder.xor(first, exchanged), 7, 8)
        row.store(builder.xor(second, exchanged), 7, 9)
        return context.get_dummy_value()

    return types.none(
        x, types.intp, types.intp, types.intp, ends, lengths, types.intp, y, types.intp, types.intp
    ), emit  # fmt: skip


@overload(exchange)
def _compiled_exchange(x, a, b, point, ends, lengths, j, y, at, beside):  # type: ignore[no-untyped-def]  # likewise
    return lambda x, a, b, point, ends, lengths, j, y, at, beside: _exchange(  # type: ignore[call-arg]
        x, a, b, point, ends, lengths, j, y, at, beside
    )


_in_c = ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None).fma
_in_c.argtypes, _in_c.restype = [ctypes.c_double] * 3, ctypes.c_double


def fma(a: float, b: float, c: float) -> float:
    """Return a b + c, correctly rounded."""
    return np.float64(_in_c(a, b, c))


@intrinsic
def _instruction(_typing: Any, a: Any, b: Any, c: Any) -> Any:
    def emit(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.fma(*arguments)

    return types.float64(types.float64, types.float64, types.float64), emit


@overload(fma)
def _compiled(a, b, c):  # type: ignore[no-untyped-def]  # numba compares this signature with the one it returns
    return lambda a, b, c: _instruction(a, b, c)  # type: ignore[call-arg]


FAR = 1e6  # rad; from here on the reduction loses bits
_QUARTERS = 2.0 / math.pi
_HALF_PI, _HALF_PI_REST = math.pi / 2, 6.123233995736766e-17  # their sum is pi/2 to 107 bits
_S3, _S5, _S7, _S9, _S11, _S13, _S15, _S17 = (
    (-1.0) ** (k // 2) / math.factorial(k) for k in (3, 5, 7, 9, 11, 13, 15, 17)
)
_C2, _C4, _C6, _C8, _C10, _C12, _C14, _C16 = (
    (-1.0) ** (k // 2) / math.factorial(k) for k in (2, 4, 6, 8, 10, 12, 14, 16)
)


@njit()
def cos_sin(z: float) -> tuple[float, float]:
    """Return cos z and sin z of any z, rad."""
    if not abs(z) > FAR:
        return near_cos_sin(z)
    return (math.cos(z), math.sin(z)) if abs(z) < math.inf else (math.nan, math.nan)


@njit()
def near_cos_sin(z: float) -> tuple[float, float]:
    """Return cos z and sin z for |z| <= FAR, without a branch."""
    quarters = np.floor(z * _QUARTERS + 0.5)
    r = fma(-quarters, _HALF_PI_REST, fma(-quarters, _HALF_PI, z))  # the inner one is exact
    q = r * r
    s = fma(q, fma(q, fma(q, fma(q, fma(q, fma(q, fma(q, _S17, _S15), _S13), _S11), _S9), _S7), _S5), _S3)
    c = fma(q, fma(q, fma(q, fma(q, fma(q, fma(q, fma(q, _C16, _C14), _C12), _C10), _C8), _C6), _C4), _C2)
    sine, cosine = fma(r * q, s, r), fma(q, c, 1.0)
    turned = quarters - 4.0 * np.floor(0.25 * quarters)  # 0, 1, 2, 3
    odd = turned == 1.0 or turned == 3.0
    x, y = (sine if odd else cosine), (cosine if odd else sine)
    return (-x if turned == 1.0 or turned == 2.0 else x), (-y if turned >= 2.0 else y)
