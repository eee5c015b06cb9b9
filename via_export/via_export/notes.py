"""Notes on a joint in a given model: what is replaced, and what remains to be done by hand."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from via_sim.joint.parameters import LINK, P
from via_sim.plants import GRAVITY

from via_export import payloads
from via_export.target import Target

ROUNDED = 1e-4  # relative change that is not worth an edit by hand: device files round their numbers
SMALL = 1e-9  # relative change of a number that counts as none
SAME = 1e-6  # relative change of a number that is written with ten digits


def replaced(values: Mapping[str, tuple[float, float]]) -> list[str]:
    """One note on numbers of the file, old and new, that others replace; zeros are not worth one."""
    changed = [
        f"{name} {old:.6g} by {new:.6g}"
        for name, (old, new) in values.items()
        if old != 0.0 and abs(new - old) > SAME * abs(old)
    ]
    return [f"the device replaces {', '.join(changed)}"] if changed else []


def inertia_added(target: Target, moved: float) -> float:
    """[kg m^2] about the axis, payloads excluded, by which inertia `moved` exceeds that of the device's link."""
    return moved - float(target.nominal[P.inertia + LINK]) - payloads.moments(target.effects)[0]


def sliding_payload(target: Target) -> list[str]:
    """What a payload, which is known by its effect on a joint that turns, is on one that slides."""
    added = payloads.moments(target.effects)[0]
    return [f"payload: on a joint that slides it adds mass times distance squared: {added:.6g} kg"] if added else []


def weight(target: Target, body: str) -> list[str]:
    """What a change of gravity needs: other masses or another centre of the given body. Payloads are bodies."""
    before, after = (float(row[P.gravity_torque]) for row in (target.nominal, target.row))
    added = payloads.moments(target.effects)[1] * (target.nominal[P.gravity] != 0.0)
    change = np.copysign(1.0, before) * (after - before) - added
    notes = []
    if abs(change) > ROUNDED * max(target.gravity_torque, 1e-3):
        notes.append(
            f"gravity torque: change mass times distance of the centre of {body} by {change / GRAVITY:.6g} kg m"
        )
    turned = float(target.row[P.gravity_angle] - target.nominal[P.gravity_angle])
    if turned:
        notes.append(f"gravity angle: turn the centre of mass of {body} by {-turned:.6g} rad about the joint")
    return notes
