"""What all joints of an arm feel together: a payload, a wrong body, or other gravity than in the model.

A payload raises the torque of every joint by about the same share. Joint by joint it is therefore taken for a wrong
gain of each drive, and a tilted base for couplings; only together do the joints show them. Models are compared by
held-out errors of blocks: joints with wrong gains; each cause with right gains; each cause with wrong gains. The first
must be significantly worse than one of the others; gains are wrong beside a cause only if that is significantly better,
because gains can replace most of a payload. A payload is a point mass, a special case of a wrong body: a body is wrong
only if that is significantly better than the best payload or gravity.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter, ValidationError
from scipy.stats import norm
from via_core.errors import SignalError
from via_core.problems import problems
from via_core.signals import Array
from via_core.text_files import read_text

from via_gap.logs.log import JointLog
from via_gap.run.arm_body import BodyError, BodyNumbers, with_body
from via_gap.run.arm_equation import ArmFit, Shared, blocks, exceeds
from via_gap.run.arm_gravity import Gravity, MissingGravity, significant, with_gravity
from via_gap.run.arm_model import Arm, body_of
from via_gap.run.arm_payload import Payload, PointMass, with_payload
from via_gap.selection.numbers import NUMBERS

FEWEST = 4  # blocks fitted, and held out: with fewer a t test finds only what needs no test
EDGE = 1e-3  # of the mass of a body: closer to its loss the mass counts as at the end of its range

ArmCause = Payload | BodyError | Gravity


def find_cause(
    arm: Arm, logs: Sequence[Sequence[JointLog]], holdout: Sequence[Sequence[JointLog]] = ()
) -> ArmCause | None:
    """The cause that explains what errors of single joints leave; None if there is none, or if it cannot be tested.

    logs, holdout: recordings of the whole arm, one log per joint each; without `holdout` every second block is held out
    """
    fitted = [each for run in logs for each in blocks(arm, run)]
    held = [each for run in holdout for each in blocks(arm, run)] if holdout else fitted[1::2]
    fitted = fitted if holdout else fitted[::2]
    if min(len(fitted), len(held)) < FEWEST:
        return None
    train, test = np.stack(fitted), np.stack(held)
    alone = ArmFit.of(train, None, gains=True)
    plain, bodies = ([_better(train, test, each) for each in causes] for causes in _causes(arm))
    best, body = (min(fits, key=lambda fit: float(fit.against(alone, test).mean())) for fits in (plain, bodies))
    fits = plain
    if exceeds(best.against(body, test), NUMBERS.significance / len(bodies)):
        best, fits = body, bodies
    gain = best.against(alone, test)
    explained = 1.0 - float(np.exp(gain.mean()))
    if (
        not exceeds(-gain - NUMBERS.margin, NUMBERS.significance / (len(plain) + len(bodies)))
        or explained < NUMBERS.substantial
    ):
        return None
    others = [each for each in fits if each is not best and not exceeds(each.against(best, test), NUMBERS.significance)]
    sd = np.maximum(best.jackknife(train), best.sd)
    return _found(arm, best, sd, others, explained)


def read_cause(path: Path) -> ArmCause:
    """The cause in a file that `via gap diagnose --arm --json` wrote. Raises ViaError in one line."""
    try:
        return TypeAdapter(ArmCause).validate_json(read_text(path))
    except ValidationError as error:
        raise SignalError(f"{path}: no payload, body or gravity of an arm: {problems(error)}") from None


def with_cause(arm: Arm, cause: ArmCause) -> Arm:
    """The arm that contains the cause. Raises SignalError if the arm has no joint of its link."""
    if isinstance(cause, BodyError):
        return with_body(arm, cause)
    return with_payload(arm, cause) if isinstance(cause, Payload) else with_gravity(arm, cause)


def _causes(arm: Arm) -> tuple[list[Shared], list[Shared]]:
    """Payloads and gravity; bodies."""
    whole = sum(each.mass for each in arm.model.inertias)
    bodies = [arm.model.inertias[body_of(arm, k)].mass for k in range(len(arm.devices))]
    gravity = [MissingGravity()] if np.any(arm.model.gravity.linear) else []
    plain: list[Shared] = [*(PointMass(k, mass, whole) for k, mass in enumerate(bodies)), *gravity]
    return plain, [BodyNumbers(k, whole) for k in range(len(bodies))]


def _better(train: Array, test: Array, cause: Shared) -> ArmFit:
    """The cause with right gains, or with wrong gains if that is significantly better."""
    right, wrong = (ArmFit.of(train, cause, gains) for gains in (False, True))
    return wrong if exceeds(right.against(wrong, test) - NUMBERS.margin, NUMBERS.significance) else right


def _found(arm: Arm, best: ArmFit, sd: Array, others: Sequence[ArmFit], explained: float) -> ArmCause | None:
    """The cause of the best fit with standard deviations sd (p,) of its unknowns; None where it may be zero."""
    tied = tuple(arm.devices[each.column].name for each in others if not isinstance(each.cause, MissingGravity))
    if isinstance(best.cause, BodyNumbers):
        point, wide = (tuple(map(float, each)) for each in (best.point, sd))
        return BodyError(arm.devices[best.column].name, tied, point, wide, explained)
    if not isinstance(best.cause, PointMass):
        if not significant(best.point, sd):
            return None
        modelled = arm.model.gravity.linear
        return Gravity(_three(modelled + best.point), _three(sd), _three(modelled), tied, explained)
    mass, joint = float(best.point[0]), arm.devices[best.column]
    carried = sum(arm.model.inertias[body].mass for body in arm.model.subtrees[body_of(arm, best.column)])
    if (
        abs(mass) < joint.tolerances.gravity * carried
        or abs(mass) < norm.ppf(1.0 - 0.5 * NUMBERS.significance) * sd[0]
        or mass < -(1.0 - EDGE) * best.cause.there
    ):
        return None
    tied += ("gravity",) if len(tied) < len(others) else ()
    return Payload(joint.name, tied, mass, float(sd[0]), _three(best.point[1:]), _three(sd[1:]), explained)


def _three(values: Array) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z
