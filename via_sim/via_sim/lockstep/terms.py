"""Terms of the catalogue composed into functions of all lanes of a block; see `via_sim.joint.terms`."""

from __future__ import annotations

from typing import Any

from via_sim.catalogue.terms import SIGNALS, Term
from via_sim.joint.compiled import bare, inlined
from via_sim.joint.parameters import P
from via_sim.joint.terms import made, terms_at
from via_sim.lockstep.block import R, Z
from via_sim.lockstep.pack import add, get, put

_AXIS, _COMMAND, _ERROR, _INPUT = (terms_at(place) for place in SIGNALS)


def _call(term: Term, number: int, index: str) -> str:
    """Source of a call of term `number`, with its slots at `index`: 'axis', or of a harmonic 'k'."""
    given = [f"get(z, {getattr(Z, name)} + {index})" if name in term.slots else name for name in term.arguments]
    return f"term_{number}({', '.join(given)})"


def _compiled(name: str, arguments: str, lines: list[str], terms: tuple[Term, ...]) -> Any:
    names = {f"term_{number}": inlined(term.equation) for number, term in enumerate(terms)}
    names |= {"add": add, "get": get, "put": put}
    return bare(made(name, arguments, lines, __file__, names))


def _bit(number: int) -> int:
    """First bit of term `number` of an axis: one per axis and harmonic."""
    return R.terms + sum(3 * term.repeats for term in _AXIS[:number])


def _bits() -> Any:
    lines = ["bits = 0"]
    for number, term in enumerate(_AXIS):
        size = getattr(P, term.arguments[0])
        lines += [f"for k in range({3 * term.repeats}):",
                  f"    bits |= int(p[{size} + k] != 0.0) << ({_bit(number)} + k)"]  # fmt: skip
    return _compiled("term_bits", "p", [*lines, "return bits"], ())


def _torques() -> Any:
    lines = []
    for number, term in enumerate(_AXIS):
        lines += [f"if rare >> {_bit(number)} & {2 ** (3 * term.repeats) - 1} != 0:", "    for axis in range(axes):",
                  f"        angle, speed = get(z, {Z.at} + axis), get(z, {Z.at + 3} + axis)",
                  f"        for k in range(axis, {3 * term.repeats}, 3):",
                  f"            if rare >> ({_bit(number)} + k) & 1:",
                  f"                add(z, out + axis, {_call(term, number, 'k')})"]  # fmt: skip
    return _compiled("add_terms", "z, axes, out, rare", lines or ["pass"], _AXIS)


def _passed() -> Any:
    lines = [f"torque = {_call(term, number, 'axis')}" for number, term in enumerate(_COMMAND)]
    return _compiled("saturated", "z, axis, torque", [*lines, "return torque"], _COMMAND)


def _corrected() -> Any:
    lines = [f"error = {_call(term, number, '0')}" for number, term in enumerate(_ERROR)]
    return _compiled("corrected", "z, error", [*lines, "return error"], _ERROR)


def _inputs() -> Any:
    lines = ["for i in range(2):", "    axis = 1 + i", f"    angle = get(z, {Z.at} + axis)"]
    lines += [f"    put(z, {row} + i, 0.0)" for row in (Z.input_error, Z.input_slope)]
    for number, term in enumerate(_INPUT):
        lines += [f"    for k in range(axis, {3 * term.repeats}, 3):",
                  f"        error, slope = {_call(term, number, 'k')}",
                  f"        add(z, {Z.input_error} + i, error)",
                  f"        add(z, {Z.input_slope} + i, slope)"]  # fmt: skip
    return _compiled("find_input_errors", "z", lines, _INPUT)


# term_bits(p): bits of the terms of axes that a parameter row has
term_bits = _bits()
# add_terms(z, axes, out, rare): their torques added to rows from `out` on
add_terms = _torques()
# saturated(z, axis, torque): commanded torque [N m] that the drives pass on
saturated = _passed()
# corrected(z, error): error [rad] of its goal that a position drive corrects
corrected = _corrected()
# find_input_errors(z): errors and slopes of the inputs of both transmissions at `Z.at`
find_input_errors = _inputs()
