"""Terms of the equations of motion, from which all kernels are composed.

An equation is a plain function of numbers. Its arguments are named after slots of the parameter row and after signals
that the kernel provides. The scalar kernel, the lanes kernel and the equations of a log call the same function; in
lanes, `sin` is the polynomial that the compiler vectorises.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from inspect import signature
from typing import Any

# Signals of each place of a term, and what its equation returns.
#   axis     angle [rad] and speed [rad/s] of an axis -> torque [N m] on it
#   command  commanded torque [N m] of a drive -> torque that passes on
#   error    error [rad] of the goal of a position drive -> error that it corrects
#   input    angle [rad] of a motor -> error [rad] of the angle at the input of its transmission, and its derivative
SIGNALS: Mapping[str, tuple[str, ...]] = {
    "axis": ("angle", "speed"), "command": ("torque",), "error": ("error",), "input": ("angle",),
}  # fmt: skip


@dataclass(frozen=True)
class Term:
    """place     key of SIGNALS
    equation  function of slots and signals; its first argument is the size: the term is absent at its neutral value
    repeats   number of harmonics, whose results add up
    """

    place: str
    equation: Callable[..., Any]
    repeats: int = 1

    @property
    def arguments(self) -> tuple[str, ...]:
        return tuple(signature(self.equation).parameters)

    @property
    def slots(self) -> tuple[str, ...]:
        """Slots of the parameter row among the arguments."""
        return tuple(name for name in self.arguments if name not in SIGNALS[self.place])
