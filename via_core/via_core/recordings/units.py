"""Units of recordings: factors to SI, by pint. Angles are in rad, joints that slide have metres, newtons, kilograms.

Counts need the counts of one turn, currents and voltages a torque constant: no table of units has them.
"""

from __future__ import annotations

import re
from functools import cache
from math import pi
from typing import Any

from via_core.errors import ParameterError

COUNTS = re.compile(r"(?:count|tick|step)s?(?P<rate>/s)?", re.IGNORECASE)
# Spellings in logs that pint lacks or takes for something else.
SPELLED = {
    "-": "dimensionless", "": "dimensionless", "%": "percent", "Nm": "N m", "Nmm": "N mm", "mNm": "mN m", "kNm": "kN m",
    "Ncm": "N cm", "in": "inch", "lb": "pound", "lbf in": "pound_force inch", "inlb": "pound_force inch",
    "in lb": "pound_force inch", "ft lb": "pound_force foot", "ftlb": "pound_force foot", "lbft": "pound_force foot",
    "lb ft": "pound_force foot", "lbfft": "pound_force foot", "lbin": "pound_force inch", "lb in": "pound_force inch",
    "lbfin": "pound_force inch", "ozin": "force_ounce inch", "kgcm": "kilogram_force cm", "kgfcm": "kilogram_force cm",
    "kgfm": "kilogram_force m", "rev": "turn", "revs": "turn", "sec": "s", "secs": "s", "usec": "us", "msec": "ms",
    "nsec": "ns", "degs": "deg", "°": "deg", "rads": "rad", "rps": "turn/s", "dps": "deg/s", "degps": "deg/s",
    "radps": "rad/s", "mmps": "mm/s", "kgf cm": "kilogram_force cm", "oz in": "force_ounce inch",
}  # fmt: skip
FORCE = "[length] * [mass] / [time] ** 2"
DIMENSIONS = {  # of joints that slide, and of what has no rad
    "time": ("[time]",),
    "angle": ("[length]",),
    "speed": ("[length] / [time]",),
    "torque": ("[length] ** 2 * [mass] / [time] ** 2", FORCE),
    "current": ("[current]",),
}
_BRACKETED = re.compile(r"(.*?)\s*[\[({]\s*([^\[\](){}]+?)\s*[\])}]\s*")
_WRITTEN = re.compile(r"[A-Za-zµ°%_][A-Za-zµ0-9 _*/^.·°-]{0,39}|-|%|")


@cache
def _registry() -> Any:
    from pint import UnitRegistry  # takes a third of a second

    return UnitRegistry()


@cache
def _unit(text: str) -> Any:
    """The unit; `text` is no expression with numbers but powers, so that it costs nothing to evaluate."""
    if _WRITTEN.fullmatch(text) is None or re.search(r"\d{3}", text):
        raise ParameterError(f"'{text}' is no unit; write e.g. deg, N m, mA, counts")
    plain = text.replace("·", " ").strip()
    try:
        return _registry().Quantity(1.0, _registry().parse_units(SPELLED.get(plain, plain)))
    except Exception:  # pint raises errors of tokenizers, attributes and its own
        raise ParameterError(f"'{text}' is no unit; write e.g. deg, N m, mA, counts") from None


def factor(unit: str, counts_per_turn: float | None = None) -> float:
    """SI value of one `unit`: 0.01745... for deg. Raises ParameterError with the remedy."""
    if COUNTS.fullmatch(unit):
        if counts_per_turn is None:
            raise ParameterError(f"unit '{unit}' needs counts_per_turn, e.g. counts_per_turn: 4096")
        return 2.0 * pi / counts_per_turn
    return float(_unit(unit).to_base_units().magnitude)


def kind(unit: str) -> str:
    """'time', 'angle', 'speed', 'torque' (or force) or 'current' by dimension; '' for others, such as Hz and %."""
    counts = COUNTS.fullmatch(unit)
    if counts:
        return "speed" if counts["rate"] else "angle"
    si = _unit(unit).to_base_units()  # keeps rad, which has no dimension
    if "radian" in str(si.units):
        return {0: "angle", -1: "speed"}.get(si.dimensionality.get("[time]", 0), "")
    for name, dimensions in DIMENSIONS.items():
        if any(si.dimensionality == _registry().get_dimensionality(each) for each in dimensions):
            return name
    return ""


def is_unit(text: str) -> bool:
    """Whether a text is a unit that this module converts."""
    try:
        return COUNTS.fullmatch(text) is not None or _unit(text) is not None
    except ParameterError:
        return False


def split_unit(name: str) -> tuple[str, str]:
    """Name of a column without the unit in brackets at its end, and that unit: `q [deg]`. Without one, '' as unit."""
    stated = _BRACKETED.fullmatch(name)
    if stated is None or stated[2].isdigit() or not is_unit(stated[2]):  # an index, or a remark
        return name, ""
    return stated[1], stated[2]


def is_linear(unit: str) -> bool:
    """Whether the unit belongs to a joint that slides: lengths, their rates, forces."""
    if COUNTS.fullmatch(unit):
        return False
    dimension = _unit(unit).dimensionality
    linear = [*DIMENSIONS["angle"], *DIMENSIONS["speed"], FORCE]
    return any(dimension == _registry().get_dimensionality(each) for each in linear)
