"""Numbers in few digits, without exponents; percentages below 100 never round to 100."""

from __future__ import annotations

import re
from itertools import pairwise
from math import ceil, floor, isfinite, log10

RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
UNKNOWN = 1e6  # a standard deviation beyond which a parameter is not determined
PREFIXES = ((1.0, ""), (1e3, "m"), (1e6, "µ"), (1e9, "n"))
SCALED = ("rad", "rad/s", "N m", "s")  # units that take a prefix


def number(value: float, digits: int = 3) -> str:
    """12.3, 0.00123, 1.2 × 10⁻⁵: `digits` significant digits."""
    if value == 0.0 or not isfinite(value):
        return "0" if value == 0.0 else "-"
    power = floor(log10(abs(float(f"{value:.{digits - 1}e}"))))
    if -4 <= power < 6:
        shown = f"{value:.{max(digits - 1 - power, 0)}f}"
        return shown.rstrip("0").rstrip(".") if "." in shown else shown
    return f"{value / 10.0**power:.{digits - 1}f} × 10{str(power).translate(RAISED)}"


def with_sd(value: float, sd: float, unit: str) -> str:
    """0.02997 ± 0.00009 N m: as many digits as the standard deviation allows, five at most."""
    shown_unit = "" if unit in ("", "-") else f" {raised(unit)}"
    if sd >= UNKNOWN:
        return f"{number(value)}{shown_unit}, not determined by these data"
    if sd <= 0.0 or value == 0.0:
        return f"{number(value)}{shown_unit}" if sd <= 0.0 else f"0 ± {number(sd, 1)}{shown_unit}"
    digits = min(max(floor(log10(abs(value))) - floor(log10(sd)) + 1, 1), 5)
    decimals = digits - 1 - floor(log10(abs(value)))
    if 0 <= decimals <= 7 and abs(value) >= 1e-4:
        least = 10.0**-decimals
        return f"{value:.{decimals}f} ± {f'{sd:.{decimals}f}' if sd >= least else number(sd, 1)}{shown_unit}"
    return f"{number(value, digits)} ± {number(sd, 1)}{shown_unit}"


def raised(unit: str) -> str:
    """kg m^2 -> kg m²."""
    return re.sub(r"\^(-?[0-9]+)", lambda power: power[1].translate(RAISED), unit)


def percent(value: float) -> str:
    """86 %, 4.2 %, 0.0028 %; never 100 % for what is less."""
    hundred = 100.0 * value
    if 99.0 < hundred < 100.0:
        return f"{min(floor(hundred * 10.0) / 10.0, 99.9):g} %"
    if abs(hundred) < 1e-4:
        return "0 %" if value == 0.0 else "below 0.0001 %"
    return f"{hundred:.0f} %" if abs(hundred) >= 10.0 else f"{number(hundred, 2)} %"


def chance(probability: float) -> str:
    """A probability or a share, in whole percent between 'below 1 %' and 'above 99 %'."""
    if probability < 0.01:
        return "below 1 %"
    return "above 99 %" if probability > 0.99 else f"{100.0 * probability:.0f} %"


def prefix(largest: float, unit: str) -> tuple[float, str]:
    """Factor and unit in which `largest` reads as a number of one to three digits: (1000, mrad)."""
    if unit not in SCALED or largest <= 0.0:
        return 1.0, unit
    for factor, letter in PREFIXES:
        if largest * factor >= 0.1:
            return factor, letter + unit
    return PREFIXES[-1][0], PREFIXES[-1][1] + unit


def prefixed(value: float, unit: str) -> str:
    """0.00012 rad -> 0.12 mrad."""
    factor, shown = prefix(abs(value), unit)
    return f"{number(value * factor, 2)} {shown}"


def ticks(low: float, high: float, about: int = 5) -> list[float]:
    """Round numbers between `low` and `high`: steps of 1, 2 or 5 times a power of ten."""
    span = high - low
    if not span > 0.0:
        return [low]
    rough = span / about
    power = 10.0 ** floor(log10(rough))
    step = next(s * power for s in (1.0, 2.0, 5.0, 10.0) if s * power >= rough * (1.0 - 1e-9))
    return [round(k * step, 12) for k in range(ceil(low / step - 1e-9), floor(high / step + 1e-9) + 1)]


def tick_words(values: list[float]) -> list[str]:
    """Ticks with one and the same number of decimals."""
    step = min((b - a for a, b in pairwise(values)), default=1.0)
    decimals = max(0, -floor(log10(step) + 1e-9)) if step > 0.0 else 0
    return [f"{value + 0.0:.{decimals}f}" for value in values]
