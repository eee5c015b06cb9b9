"""What all joints of an arm feel together: a wrong body, a wrong zero of an angle, a payload, or other gravity.

A payload raises the torque of every joint by about the same share. Joint by joint it is therefore taken for a wrong
gain of each drive, and a tilted base for couplings; only together do the joints show them. Models are compared by
held-out errors of blocks: joints with wrong gains; each cause with right gains; each cause with wrong gains.

The smaller of two models holds unless the larger one is significantly better: of the causes, a body of another
density or the zero of an angle (one unknown), gravity or a payload, which is a point mass (three and four), and any
other error of a body (ten); of a cause with right and with wrong gains; of a cause and wrong gains alone, each of
which is one unknown. So a cause with more unknowns than there are wrong gains must be significantly better than
these, and any other cause must not be significantly worse. A single unknown must differ from zero. Causes are added
one at a time; each is fitted again beside the others.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter, ValidationError
from scipy.stats import norm
from scipy.stats import t as student
from via_core.errors import SignalError
from via_core.records import problems
from via_core.signals import Array
from via_core.text_files import read_text

from via_gap.logs.log import JointLog
from via_gap.run.arm_body import BodyError, BodyNumbers, Density, with_body
from via_gap.run.arm_equation import ArmFit, OneUnknown, Shared, blocks, exceeds
from via_gap.run.arm_gravity import Gravity, MissingGravity, significant, with_gravity
from via_gap.run.arm_model import Arm, body_of
from via_gap.run.arm_offset import LINEAR, AngleOffset, Zero, Zeros, with_offset
from via_gap.run.arm_payload import Payload, PointMass, with_payload
from via_gap.selection.numbers import NUMBERS

FEWEST = 4  # blocks fitted, and held out: with fewer a t test finds only what needs no test
EDGE = 1e-3  # of the mass of a body: closer to its loss the mass counts as at the end of its range

_CERTAIN = norm.ppf(1.0 - 0.5 * NUMBERS.significance)  # sd by which a number must differ from zero
_KINDS = {
    Density: "the mass moved by",
    Zero: "the zero of the angle of",
    PointMass: "a payload at",
    BodyNumbers: "the body moved by",
}
ArmCause = Payload | BodyError | Gravity | AngleOffset


def find_causes(
    arm: Arm, logs: Sequence[Sequence[JointLog]], holdout: Sequence[Sequence[JointLog]] = ()
) -> tuple[ArmCause, ...]:
    """The causes that explain what errors of single joints leave; none if there is none, or if it cannot be tested.

    logs, holdout: recordings of the whole arm, one log per joint each; without `holdout` every second block is held out
    """

    def found_beside(others: Sequence[ArmCause], again: ArmCause | None = None) -> ArmCause | None:
        carrying = with_causes(arm, others)
        fitted = [each for run in logs for each in blocks(carrying, run)]
        held = [each for run in holdout for each in blocks(carrying, run)] if holdout else fitted[1::2]
        fitted = fitted if holdout else fitted[::2]
        if min(len(fitted), len(held)) < FEWEST:
            return None
        train, test = np.stack(fitted), np.stack(held)
        return _find(carrying, train, test) if again is None else _fitted_again(carrying, again, train, test)

    causes: list[ArmCause] = []
    while len(causes) < len(arm.devices) > 1 and (new := found_beside(causes)) is not None:
        if any((each.name, each.link) == (new.name, new.link) for each in causes):
            break  # fits that do not converge
        causes.append(new)
        for i in [*range(len(causes) - 1), *range(len(causes))] if len(causes) > 1 else []:
            again = found_beside([each for each in causes if each is not causes[i]], causes[i])
            causes[i] = again or causes[i]
    return tuple(causes)


def _find(arm: Arm, train: Array, test: Array) -> ArmCause | None:
    none, alone = (ArmFit.of(train, None, gains) for gains in (False, True))
    best, rivals, tests = _smallest(arm, train, test, alone)
    fewer = _unknowns(arm, best, train) <= _unknowns(arm, alone, train)
    without = none if fewer else alone
    gain = best.against(without, test)
    explained = 1.0 - float(best.left(without, test).min())
    if isinstance(best.cause, OneUnknown):
        certain = _differs(best, np.concatenate((train, test)), NUMBERS.significance / tests)
    else:
        certain = exceeds(-gain - NUMBERS.margin, NUMBERS.significance / tests)
    if (
        not certain
        or explained < NUMBERS.substantial
        or (fewer and exceeds(best.against(alone, test) - NUMBERS.margin, NUMBERS.significance))
    ):
        return None
    return _found(arm, best, best.uncertain(train)[0], _tied(arm, best, rivals, train, test), explained)


def _differs(fit: ArmFit, every: Array, significance: float) -> bool:
    """Whether the one unknown of a cause, fitted to all blocks, differs from zero: Wald's test with the jackknife.

    Blocks without motion, or without motion that the cause changes, make errors differ from block to block, but not
    the unknown: it needs fewer blocks than a comparison of errors.
    """
    again = ArmFit.of(every, fit.cause, fit.gains, fit.point)
    least = student.ppf(1.0 - 0.5 * significance, len(every) - 1) * again.uncertain(every)[0]
    return bool(abs(again.point[0]) > least[0])


def read_cause(path: Path) -> ArmCause:
    """The cause in a file that `via gap diagnose --arm --json` wrote. Raises ViaError in one line."""
    try:
        return TypeAdapter(ArmCause).validate_json(read_text(path))
    except ValidationError as error:
        raise SignalError(f"{path}: no payload, body, offset or gravity of an arm: {problems(error)}") from None


def is_cause(path: Path) -> bool:
    """Whether a JSON file holds what all joints of an arm feel, rather than a report of one joint."""
    try:
        keys = json.loads(read_text(path)).keys()
    except (ValueError, AttributeError, RecursionError):
        return False
    return {"tied", "explained"} <= keys and "verdict" not in keys


def with_causes(arm: Arm, causes: Sequence[ArmCause]) -> Arm:
    """The arm that contains the causes. Raises SignalError if the arm has no joint of their links."""
    for cause in causes:
        match cause:
            case BodyError():
                arm = with_body(arm, cause)
            case Payload():
                arm = with_payload(arm, cause)
            case AngleOffset():
                arm = with_offset(arm, cause)
            case Gravity():
                arm = with_gravity(arm, cause)
    return arm


def _fitted_again(arm: Arm, cause: ArmCause, train: Array, test: Array) -> ArmCause | None:
    """The same cause with other numbers; None where it may be zero."""
    sort = {BodyError: BodyNumbers, Payload: PointMass, AngleOffset: Zero, Gravity: MissingGravity}[type(cause)]
    if isinstance(cause, BodyError) and cause.share is not None:
        sort = Density
    alike = (each for causes in _causes(arm) for each in causes if isinstance(each, sort))
    names = [each.name for each in arm.devices]
    same = next(each for each in alike if sort is MissingGravity or names[_joint(each)] == cause.link)
    right, wrong = (ArmFit.of(train, same, gains) for gains in (False, True))
    fit = wrong if exceeds(right.against(wrong, test) - NUMBERS.margin, NUMBERS.significance) else right
    return _found(arm, fit, fit.uncertain(train)[0], cause.tied, cause.explained)


def _smallest(arm: Arm, train: Array, test: Array, alone: ArmFit) -> tuple[ArmFit, list[ArmFit], int]:
    """The cause of the fewest unknowns beside which none with more is significantly better; its rivals.

    Also the number of models that were compared.
    """
    sorts = [[ArmFit.of(train, each, gains) for each in causes] for gains in (False, True) for causes in _causes(arm)]
    bests = [min(fits, key=lambda fit: float(fit.against(alone, test).mean())) for fits in sorts]
    chosen = 0
    for larger in range(1, len(sorts)):
        difference = bests[chosen].against(bests[larger], test) - NUMBERS.margin
        if exceeds(difference, NUMBERS.significance / len(sorts[larger])):
            chosen = larger
    rivals = [each for each in sorts[chosen] if each is not bests[chosen]]
    if isinstance(bests[chosen].cause, Density):
        rivals.append(bests[chosen + 1])  # a payload or gravity
    elif isinstance(bests[chosen].cause, Zero):
        rivals += [bests[chosen + 1], bests[chosen + 3]]  # or a body, which contains one of another density
    return bests[chosen], [*rivals, alone], sum(map(len, sorts))


def _causes(arm: Arm) -> tuple[list[Shared], ...]:
    """Bodies of another density and zeros of angles; payloads and gravity; zeros of all angles; any error of a body."""
    whole = sum(each.mass for each in arm.model.inertias)
    bodies = [arm.model.inertias[body_of(arm, k)] for k in range(len(arm.devices))]
    gravity = [MissingGravity()] if np.any(arm.model.gravity.linear) else []
    single: list[Shared] = [Zero.of(arm, k) for k in range(len(bodies))]
    single += [
        Density(k, k, tuple(each.toDynamicParameters()), (-1.0, np.inf))
        for k, each in enumerate(bodies)
        if _felt_beside(arm, k)
    ]
    plain: list[Shared] = [*(PointMass(k, each.mass, whole) for k, each in enumerate(bodies)), *gravity]
    return single, plain, [Zeros.of(arm)], [BodyNumbers(k, whole) for k in range(len(bodies))]


def _felt_beside(arm: Arm, joint: int) -> bool:
    """Whether other joints carry the body that a joint moves; else its own diagnosis shows more than the density."""
    return len(arm.model.supports[body_of(arm, joint)]) > 2  # the base and the body


def _wrong_gains(arm: Arm, fit: ArmFit, train: Array) -> list[str]:
    """Joints whose gain is wrong by more than a model's masses may be, and by more than it is uncertain."""
    tolerated = np.array([each.tolerances.gravity for each in arm.devices])
    wrong = np.abs(fit.gain) > np.maximum(tolerated, _CERTAIN * fit.uncertain(train)[1])
    return [each.name for each, is_wrong in zip(arm.devices, wrong, strict=True) if is_wrong]


def _unknowns(arm: Arm, fit: ArmFit, train: Array) -> int:
    """Those of the cause, and wrong gains."""
    return len(fit.point) + len(_wrong_gains(arm, fit, train)) if fit.gains else len(fit.point)


def _tied(arm: Arm, best: ArmFit, rivals: Sequence[ArmFit], train: Array, test: Array) -> tuple[str, ...]:
    """Rivals that are not significantly worse: joints of the same sort of cause, or other causes."""
    equal = [each for each in rivals if not exceeds(each.against(best, test), NUMBERS.significance)]
    return tuple(_words(arm, best, each, train) for each in equal)


def _words(arm: Arm, best: ArmFit, tied: ArmFit, train: Array) -> str:
    if tied.cause is None:
        return f"wrong gains of {', '.join(_wrong_gains(arm, tied, train))}"
    if isinstance(tied.cause, MissingGravity):
        return Gravity.name
    joint = arm.devices[_joint(tied.cause)].name
    return joint if isinstance(tied.cause, type(best.cause)) else f"{_KINDS[type(tied.cause)]} {joint}"


def _joint(cause: Shared) -> int:
    """Number of the joint of a cause other than gravity."""
    return cause.joint if isinstance(cause, OneUnknown) else cause.column


def _found(arm: Arm, best: ArmFit, sd: Array, tied: tuple[str, ...], explained: float) -> ArmCause | None:
    """The cause of a fit with standard deviations sd (p,) of its unknowns; None where it may be zero."""
    cause = best.cause
    assert cause is not None
    if isinstance(cause, MissingGravity):
        if not significant(best.point, sd):
            return None
        modelled = arm.model.gravity.linear
        return Gravity(_three(modelled + best.point), _three(sd), _three(modelled), tied, explained)
    if isinstance(cause, Zeros):  # one after the other, beginning with the clearest
        return _found(arm, *cause.clearest(arm, best, sd), tied, explained)
    joint = arm.devices[_joint(cause)]
    point, wide = (tuple(map(float, each)) for each in (best.point, sd))
    if isinstance(cause, BodyNumbers):
        return BodyError(joint.name, tied, point, wide, explained)
    if isinstance(cause, Zero):
        certain = _CERTAIN * wide[0] < abs(point[0]) < LINEAR
        return AngleOffset(joint.name, tied, point[0], wide[0], explained) if certain else None
    if isinstance(cause, Density):
        if abs(point[0]) < max(joint.tolerances.gravity, _CERTAIN * wide[0]):
            return None
        numbers, numbers_sd = (tuple(map(float, cause.numbers(each))) for each in (best.point, sd))
        return BodyError(joint.name, tied, numbers, tuple(map(abs, numbers_sd)), explained, point[0], wide[0])
    assert isinstance(cause, PointMass)
    mass = point[0]
    carried = sum(arm.model.inertias[body].mass for body in arm.model.subtrees[body_of(arm, best.column)])
    if abs(mass) < max(joint.tolerances.gravity * carried, _CERTAIN * wide[0]) or mass < -(1.0 - EDGE) * cause.there:
        return None
    return Payload(joint.name, tied, mass, wide[0], _three(best.point[1:]), _three(sd[1:]), explained)


def _three(values: Array) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z
