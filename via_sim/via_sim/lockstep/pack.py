"""A compiled number type: LANES float64 numbers, one per run, with the operators of a number.

LLVM keeps a pack in vector registers, which no loop over lanes guarantees. An equation written for numbers therefore
serves all lanes of a block at once; a number among its operands counts for all lanes. A comparison is 1 or 0 in each
lane. Sums and products round as scalar ones; sine and exponential are polynomials, because the library has none for
vectors.

Compiled functions read and write packs as rows of a matrix z (rows, LANES), in which `z[row, lane]` is one number.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core.typeconv import Conversion
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, lower_cast, models, overload, register_model
from via_core.signals import Array

from via_sim.joint.compiled import bare, compiled, inlined

LANES = 16  # two of the widest vector registers: each waits less for the other's results
_VECTOR, _WHOLE = ir.VectorType(ir.DoubleType(), LANES), ir.VectorType(ir.IntType(64), LANES)


class _PackType(types.Type):  # type: ignore[misc]
    def __init__(self) -> None:
        super().__init__(name=f"Pack{LANES}")

    def can_convert_from(self, _context: object, other: types.Type) -> Conversion | None:
        return Conversion.safe if isinstance(other, types.Float) else None


PACK = _PackType()


@register_model(_PackType)
class _PackModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: types.Type) -> None:
        super().__init__(manager, kind, _VECTOR)


@lower_cast(types.Float, _PackType)
def _spread(_context: Any, builder: Any, _source: Any, _target: Any, value: Any) -> Any:
    one = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), value, ir.IntType(32)(0))
    lanes = ir.Constant(ir.VectorType(ir.IntType(32), LANES), None)
    return builder.shuffle_vector(one, ir.Constant(_VECTOR, ir.Undefined), lanes)


def _operator(function: Any, count: int, build: Callable[..., Any]) -> None:
    """Make `function` of `count` packs, or packs and numbers, the instructions that `build` writes."""

    class Typing(AbstractTemplate):  # type: ignore[misc]
        def generic(self, args: tuple[types.Type, ...], kws: object) -> Any:
            known = all(each == PACK or isinstance(each, types.Float) for each in args)
            return signature(PACK, *[PACK] * count) if known and len(args) == count and PACK in args else None

    infer_global(function)(Typing)
    lower_builtin(function, *[PACK] * count)(lambda _context, builder, _types, args: build(builder, *args))


def _arithmetic(name: str) -> Callable[..., Any]:
    return lambda builder, a, b: getattr(builder, name)(a, b)


def _compared(order: str) -> Callable[..., Any]:
    return lambda builder, a, b: builder.uitofp(builder.fcmp_ordered(order, a, b), _VECTOR)


def _chosen_by(order: str) -> Callable[..., Any]:
    return lambda builder, a, b: builder.select(builder.fcmp_ordered(order, a, b), a, b)


def _called(name: str) -> Callable[..., Any]:
    kind = ir.FunctionType(_VECTOR, [_VECTOR])
    return lambda builder, a: builder.call(builder.module.declare_intrinsic(f"llvm.{name}.v{LANES}f64", (), kind), [a])


for _functions, _count, _build in (
    ((operator.add, operator.iadd), 2, _arithmetic("fadd")),
    ((operator.sub, operator.isub), 2, _arithmetic("fsub")),
    ((operator.mul, operator.imul), 2, _arithmetic("fmul")),
    ((operator.truediv,), 2, _arithmetic("fdiv")),
    ((operator.neg,), 1, lambda builder, a: builder.fneg(a)),
    ((operator.gt,), 2, _compared(">")),
    ((operator.ge,), 2, _compared(">=")),
    ((min,), 2, _chosen_by("<")),
    ((max,), 2, _chosen_by(">")),
    ((abs,), 1, _called("fabs")),
    ((math.floor,), 1, _called("floor")),
    ((math.sqrt,), 1, _called("sqrt")),
):
    for _function in _functions:
        _operator(_function, _count, _build)


def choose(_sign: float, _above: float, _else: float) -> float:
    """`above` in lanes where `sign` is positive, elsewhere the other."""
    raise NotImplementedError  # exists in compiled code


def _chosen(builder: Any, sign: Any, above: Any, other: Any) -> Any:
    return builder.select(builder.fcmp_ordered(">", sign, ir.Constant(_VECTOR, None)), above, other)


_operator(choose, 3, _chosen)


def _place(context: Any, builder: Any, kind: Any, z: Any, row: Any) -> Any:
    return builder.gep(context.make_array(kind)(context, builder, z).data, [builder.mul(row, row.type(LANES))])


def _pack_at(context: Any, builder: Any, kind: Any, z: Any, row: Any) -> Any:
    return builder.bitcast(_place(context, builder, kind, z, row), _VECTOR.as_pointer())


@intrinsic  # type: ignore[untyped-decorator]
def get(_typing: Any, z: Any, _row: Any) -> Any:
    """Row of z as a pack."""

    def generate(context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.load(_pack_at(context, builder, z, *args), align=8)

    return PACK(z, types.intp), generate


@intrinsic  # type: ignore[untyped-decorator]
def put(_typing: Any, z: Any, _row: Any, _value: Any) -> Any:
    """Set a row of z to a pack or a number."""

    def generate(context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        builder.store(args[2], _pack_at(context, builder, z, *args[:2]), align=8)
        return context.get_dummy_value()

    return types.void(z, types.intp, PACK), generate


@intrinsic  # type: ignore[untyped-decorator]
def get_one(_typing: Any, z: Any, _row: Any, _lane: Any) -> Any:
    """z[row, lane] for inner loops: numba does not know that a row has LANES numbers."""

    def generate(context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.load(builder.gep(_place(context, builder, z, *args[:2]), [args[2]]))

    return types.float64(z, types.intp, types.intp), generate


@intrinsic  # type: ignore[untyped-decorator]
def put_one(_typing: Any, z: Any, _row: Any, _lane: Any, _value: Any) -> Any:
    """Set z[row, lane], see `get_one`."""

    def generate(context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        builder.store(args[3], builder.gep(_place(context, builder, z, *args[:2]), [args[2]]))
        return context.get_dummy_value()

    return types.void(z, types.intp, types.intp, types.float64), generate


@intrinsic  # type: ignore[untyped-decorator]
def _times_power(_typing: Any, x: Any, _k: Any) -> Any:
    """x 2^k of packs with whole numbers k."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        exponent = builder.add(builder.fptosi(args[1], _WHOLE), ir.Constant(_WHOLE, [1023] * LANES))
        power = builder.bitcast(builder.shl(exponent, ir.Constant(_WHOLE, [52] * LANES)), _VECTOR)
        return builder.fmul(args[0], power)

    return x(x, x), generate


@intrinsic  # type: ignore[untyped-decorator]
def any_above(_typing: Any, x: Any, y: Any) -> Any:
    """Whether x > y in any lane."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        bits = builder.bitcast(builder.fcmp_ordered(">", *args), ir.IntType(LANES))
        return builder.icmp_unsigned("!=", bits, bits.type(0))

    return types.boolean(PACK, PACK), generate


@bare
def _sine(x: Any) -> Any:
    """sin(x) within 1e-11 for |x| <= 1e4: Taylor series about the nearest multiple of pi."""
    turns = math.floor(x * 0.3183098861837907 + 0.5)
    r = (x - turns * 3.141592653589793) - turns * 1.2246467991473532e-16
    s = r * r
    t = s * (-1.0 / 121645100408832000.0) + 1.0 / 355687428096000.0
    t = s * t - 1.0 / 1307674368000.0
    t = s * t + 1.0 / 6227020800.0
    t = s * t - 1.0 / 39916800.0
    t = s * t + 1.0 / 362880.0
    t = s * t - 1.0 / 5040.0
    t = s * t + 1.0 / 120.0
    t = s * t - 1.0 / 6.0
    odd = turns - 2.0 * math.floor(0.5 * turns)
    return (1.0 - 2.0 * odd) * (r + r * s * t)


@bare
def _exponential(x: Any) -> Any:
    """exp(x) within rounding for |x| <= 700, beyond it as at 700: Taylor series within one octave."""
    x = min(max(x, -700.0), 700.0)
    k = math.floor(x * 1.4426950408889634 + 0.5)
    r = (x - k * 0.6931471803691238) - k * 1.9082149292705877e-10  # ln 2; k times its first 33 bits is exact
    t = r * (1.0 / 479001600.0) + 1.0 / 39916800.0
    t = r * t + 1.0 / 3628800.0
    t = r * t + 1.0 / 362880.0
    t = r * t + 1.0 / 40320.0
    t = r * t + 1.0 / 5040.0
    t = r * t + 1.0 / 720.0
    t = r * t + 1.0 / 120.0
    t = r * t + 1.0 / 24.0
    t = r * t + 1.0 / 6.0
    t = r * t + 0.5
    t = r * t + 1.0
    t = r * t + 1.0
    return _times_power(t, k)


@overload(math.sin, strict=False)
def _sin(x: Any) -> Any:
    return (lambda x: _sine(x)) if x == PACK else None


@overload(math.cos, strict=False)
def _cos(x: Any) -> Any:
    return (lambda x: _sine(x + 1.5707963267948966)) if x == PACK else None


@overload(math.exp, strict=False)
def _exp(x: Any) -> Any:
    return (lambda x: _exponential(x)) if x == PACK else None


@inlined
def add(z: Array, row: int, value: Any) -> None:
    """Add a pack to a row of z."""
    put(z, row, get(z, row) + value)


@compiled
def rows_of_packs(count: int) -> Array:
    """Zeros (count, LANES), each row on one cache line."""
    memory = np.zeros((count + 1) * LANES)
    skipped = (-(memory.ctypes.data // 8)) % LANES
    return memory[skipped : skipped + count * LANES].reshape(count, LANES)
