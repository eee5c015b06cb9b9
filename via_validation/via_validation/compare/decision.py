"""Which method to use: the rule of the comparison page, and rules that would choose otherwise.

Rule: of the methods that are usable (status OK in at least `TRUSTED` of the samples, 95 % interval right in at least
`HONEST` of those), the one with the smallest error. Errors up to `EQUAL` above the smallest count as equal, and then
the cheapest method is best. If no method is usable, the smallest error alone decides.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from via_validation.compare.run import WRONG_LEVEL, Case, Comparison

HONEST = 0.9  # [-] coverage of the 95 % interval
TRUSTED = 0.9  # [-] share of samples with status OK
EQUAL = 0.05  # [-] relative difference of errors that does not count
ENOUGH = 0.1  # [-] error below which a cheap method is good enough


def usable(case: Case) -> bool:
    """Whether status and interval of the method can be relied on; an undefined coverage is none."""
    return case.figures.trusted >= TRUSTED and case.figures.coverage >= HONEST


def candidates(cases: Sequence[Case]) -> list[Case]:
    """The usable cases; all of them if none is."""
    return [case for case in cases if usable(case)] or list(cases)


def best(cases: Sequence[Case]) -> Case:
    """The best case of one device and level."""
    left = candidates(cases)
    smallest = min(case.figures.accuracy for case in left)
    return min((c for c in left if c.figures.accuracy <= (1.0 + EQUAL) * smallest), key=lambda case: case.cost)


def _by_error(cases: Sequence[Case]) -> Case:
    return min(cases, key=lambda case: case.figures.accuracy)


def _by_convergence(cases: Sequence[Case]) -> Case:
    return min(candidates(cases), key=lambda case: (case.figures.convergence, case.figures.accuracy))


def _by_cost(cases: Sequence[Case]) -> Case | None:
    good = [case for case in candidates(cases) if case.figures.accuracy <= ENOUGH]
    return min(good, key=lambda case: case.cost, default=None)


def _by_wrong_motors(cases: Sequence[Case]) -> Case | None:
    known = [case for case in candidates(cases) if case.wrong_motors is not None]
    return min(known, key=lambda case: case.wrong_motors or 0.0, default=None)


# Words of a rule -> its choice among the cases of one device and level; None if no method fulfils it.
OTHER_RULES: dict[str, Callable[[Sequence[Case]], Case | None]] = {
    "smallest error, whatever status and interval": _by_error,
    "fastest convergence": _by_convergence,
    f"cheapest with an error below {100.0 * ENOUGH:g} %": _by_cost,
    f"smallest error with wrong motors (*{WRONG_LEVEL}* only)": _by_wrong_motors,
}


def default_case(comparison: Comparison, device: str, level: str) -> Case | None:
    """The case of the device's default; None if the comparison does not have that method."""
    method = comparison.defaults[device]
    return next((case for case in comparison.of(device, level) if case.method == method), None)


def replaced(comparison: Comparison) -> dict[str, str]:
    """Device -> method that is better than its default at WRONG_LEVEL, or at the last level if that is missing."""
    names = [level.name for level in comparison.levels]
    at = WRONG_LEVEL if WRONG_LEVEL in names else names[-1]
    found = {device: best(comparison.of(device, at)).method for device in comparison.devices}
    return {device: method for device, method in found.items() if method != comparison.defaults[device]}
