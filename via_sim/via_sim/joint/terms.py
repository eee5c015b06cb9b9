"""Terms of the catalogue (`via_sim.catalogue.terms`) composed into compiled functions of the parameter row.

A new term acts in every kernel, because nothing else lists them: the source of each function below is written from the
terms' arguments.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from via_sim.catalogue import EFFECTS
from via_sim.catalogue.terms import Term
from via_sim.joint.compiled import bare, inlined
from via_sim.joint.layout import MODE
from via_sim.joint.parameters import P


def terms_at(place: str) -> tuple[Term, ...]:
    """All terms at a place, in the order of the catalogue."""
    return tuple(term for kind in EFFECTS.values() for term in kind.terms if term.place == place)


def made(name: str, arguments: str, lines: Sequence[str], file: str, names: Mapping[str, object]) -> Callable[..., Any]:
    """A Python function from its source; numba caches it as one of `file`."""
    space: dict[str, Any] = {"__name__": __name__, **names}
    exec(compile("\n    ".join([f"def {name}({arguments}):", *lines]), file, "exec"), space)
    return space[name]  # type: ignore[no-any-return]


def call(term: Term, number: int, index: str) -> str:
    """Source of a call of term `number`, with its slots at `index`: 'axis', or of a harmonic 'k'."""
    given = [f"p[{getattr(P, name)} + {index}]" if name in term.slots else name for name in term.arguments]
    return f"term_{number}({', '.join(given)})"


_Lines = Callable[[int, Term], Sequence[str]]


def _scalar(name: str, arguments: str, place: str, lines: _Lines, end: str, begin: str = "total = 0.0") -> Any:
    terms = terms_at(place)
    body = [line for number, term in enumerate(terms) for line in lines(number, term)]
    names = {f"term_{number}": inlined(term.equation) for number, term in enumerate(terms)}
    start = {"axis": [begin], "input": ["error = slope = 0.0"], "command": [], "error": []}[place]
    return bare(made(name, arguments, [*start, *body, end], __file__, names))


def _repeated(number: int) -> int:
    """First column of modes with the number of harmonics of term `number` at an axis."""
    return MODE.repeats + 3 * sum(term.repeats > 1 for term in terms_at("axis")[:number])


def _added(number: int, term: Term) -> list[str]:
    if term.repeats == 1:
        return [f"total += {call(term, number, 'axis')}"]
    count = f"modes[{_repeated(number)} + axis]"
    return [f"if {count} > 0:", "    series = 0.0", f"    for k in range(axis, 3 * {count}, 3):",
            f"        series += {call(term, number, 'k')}", "    total += series"]  # fmt: skip


def _counted(number: int, term: Term) -> list[str]:
    """Lines that set whether the term is there, and the number of harmonics up to the last nonzero one."""
    size = getattr(P, term.arguments[0])
    if term.repeats == 1:
        return [f"there |= p[{size} + axis] != 0.0"]
    count = f"modes[{_repeated(number)} + axis]"
    return [f"{count} = 0", f"for k in range({term.repeats}):", f"    if p[{size} + 3 * k + axis] != 0.0:",
            f"        {count} = k + 1", "        there = True"]  # fmt: skip


def _passed(number: int, term: Term) -> list[str]:
    return [f"torque = {call(term, number, 'axis')}"]


def _corrected(number: int, term: Term) -> list[str]:
    return [f"error = {call(term, number, '0')}"]


def _at_input(number: int, term: Term) -> list[str]:
    return [f"for k in range(axis, {3 * term.repeats}, 3):", f"    more = {call(term, number, 'k')}",
            "    error, slope = error + more[0], slope + more[1]"]  # fmt: skip


# axis_torque(p, modes, axis, angle, speed): sum [N m] of all terms of an axis
axis_torque = _scalar("axis_torque", "p, modes, axis, angle, speed", "axis", _added, "return total")
# count_terms(p, modes, axis): whether any term of an axis is there; number of harmonics into modes
count_terms = _scalar("count_terms", "p, modes, axis", "axis", _counted, "return there", "there = False")
# saturated(p, axis, torque): commanded torque [N m] that a drive passes on
saturated = _scalar("saturated", "p, axis, torque", "command", _passed, "return torque")
# corrected(p, error): error [rad] of its goal that the position drive of the link corrects
corrected = _scalar("corrected", "p, error", "error", _corrected, "return error")
# input_error(p, axis, angle): error [rad] of the angle at the input of a motor's transmission, and its derivative [-]
input_error = _scalar("input_error", "p, axis, angle", "input", _at_input, "return error, slope")
