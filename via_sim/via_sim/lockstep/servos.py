"""Servos of all lanes of a block: their motion within a step has a closed form, see `actuation.servo_motion`."""

from __future__ import annotations

from via_core.servos import servo_step
from via_core.signals import Array

from via_sim.joint.actuation import servo_motion
from via_sim.joint.compiled import bare, inlined
from via_sim.lockstep.block import R, Z
from via_sim.lockstep.pack import get, put

MIDDLE, END = 0, 1  # moments of a step
_ROWS = 4  # of a moment: angles of both motors, then velocities


@bare
def find_servos(z: Array, rows: Array, rare: int) -> None:
    """Motion of the servos at the middle and at the end of a step from `Z.start` on."""
    for i in range(2):
        if rare >> (R.servo + i) & 1:
            if rare >> R.limited & 1:
                _each_servo(z, rows, i)
                continue
            angle, speed, goal = get(z, Z.start + 1 + i), get(z, Z.start + 4 + i), get(z, Z.command + i)
            for moment in (MIDDLE, END):
                after = 0.5 * (1.0 + moment) * get(z, Z.length)
                there, moving = servo_step(angle, speed, goal, get(z, Z.bandwidth + i), after)
                put(z, Z.servo + _ROWS * moment + i, there)
                put(z, Z.servo + _ROWS * moment + 2 + i, moving)


@bare
def _each_servo(z: Array, rows: Array, i: int) -> None:
    """The same of one motor, lane by lane: some have a limited speed."""
    for lane in range(len(rows)):
        angle, speed, goal = z[Z.start + 1 + i, lane], z[Z.start + 4 + i, lane], z[Z.command + i, lane]
        for moment in (MIDDLE, END):
            after = 0.5 * (1.0 + moment) * z[Z.length, lane]
            there, moving = servo_motion(rows[lane], i, angle, speed, goal, after)
            z[Z.servo + _ROWS * moment + i, lane] = there
            z[Z.servo + _ROWS * moment + 2 + i, lane] = moving


@inlined
def place_servos(z: Array, rare: int, moment: int) -> None:
    """Motion of the servos at a moment into `Z.at`."""
    for i in range(2):
        if rare >> (R.servo + i) & 1:
            put(z, Z.at + 1 + i, get(z, Z.servo + _ROWS * moment + i))
            put(z, Z.at + 4 + i, get(z, Z.servo + _ROWS * moment + 2 + i))
