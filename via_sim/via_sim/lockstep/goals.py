"""Goals of the position drives of all lanes of a block, see `via_sim.joint.position_drive`."""

from __future__ import annotations

from math import exp, sin
from typing import Any

from via_core.signals import Array

from via_sim.catalogue.sensor.encoder_eccentricity import ENCODER_HARMONICS
from via_sim.joint.compiled import bare
from via_sim.lockstep.block import R, Z
from via_sim.lockstep.pack import choose, get, put


@bare
def read_link(z: Array, rare: int) -> Any:
    """Link angle [rad] that the drive's encoder measures at `Z.at`."""
    measured = get(z, Z.at) + get(z, Z.encoder_offset)
    if rare >> R.eccentric & 1:
        for k in range(0, 3 * ENCODER_HARMONICS, 3):
            turned = get(z, Z.eccentricity_order + k) * get(z, Z.at) + get(z, Z.eccentricity_phase + k)
            measured += get(z, Z.eccentricity + k) * sin(turned)
    return measured


@bare
def recall_goals(z: Array, rare: int) -> None:
    """Goals at the end of the last tick, from its command and the distances from it, as `kernel.recall_goal`."""
    put(z, Z.at, get(z, Z.start))
    measured, power = read_link(z, rare), get(z, Z.power)
    followed = choose(power, get(z, Z.sent) - get(z, Z.behind), measured)
    put(z, Z.followed, followed)
    put(z, Z.trailing, choose(power, followed - get(z, Z.lagged), measured))


@bare
def take_goals(z: Array, rare: int) -> None:
    """Commands of a piece of a tick, as `kernel.take_goal`; a goal without a speed limit is there at once."""
    put(z, Z.at, get(z, Z.start))
    measured, power = read_link(z, rare), get(z, Z.power)
    sent, step = get(z, Z.sent), get(z, Z.sent) - get(z, Z.sent_before)
    put(z, Z.target, choose(power, sent + get(z, Z.lead) * get(z, Z.on_before) * step, measured))
    put(z, Z.sent, choose(power, sent, measured))
    put(z, Z.followed, choose(power * get(z, Z.slews), get(z, Z.followed), get(z, Z.target)))
    put(z, Z.trailing, choose(power, get(z, Z.trailing), measured))


@bare
def begin_integrals(z: Array, rare: int, steps: int) -> None:
    """Mean integrals of a piece of a tick with so many steps, see `position_drive`."""
    put(z, Z.at, get(z, Z.start))
    move_goals(z, 0)
    error = get(z, Z.power) * (get(z, Z.acting) - read_link(z, rare))
    put(z, Z.integral, get(z, Z.power) * get(z, Z.integral))
    put(z, Z.first_error, error)
    put(z, Z.held, _integrated(z, 0.5 * steps, error))


@bare
def end_integrals(z: Array, rare: int, steps: int) -> None:
    """Integrals at the end of a piece of a tick."""
    put(z, Z.at, get(z, Z.start))
    error = get(z, Z.power) * (get(z, Z.trailing) - read_link(z, rare))
    put(z, Z.integral, _integrated(z, 1.0 * steps, 0.5 * (get(z, Z.first_error) + error)))


@bare
def _integrated(z: Array, steps: float, error: Any) -> Any:
    """Integrals after so many steps, as `position_drive.integrated`."""
    reach = get(z, Z.integral_reach)
    return min(max(get(z, Z.integral) + get(z, Z.integral_rate) * get(z, Z.length) * steps * error, -reach), reach)


@bare
def move_goals(z: Array, moment: int) -> None:
    """Acting goals at the beginning (0), the middle (1) or the end (2) of a step, as `position_drive.acting_goal`."""
    after, speed, lag = 0.5 * moment * get(z, Z.length), get(z, Z.drive_speed_limit), get(z, Z.lag)
    start = get(z, Z.followed)
    way = get(z, Z.target) - start
    ramp = min(abs(way) / speed, after)
    goal = _followed(z, after)
    behind = get(z, Z.trailing) - choose(ramp, start, goal)
    trail = choose(way, speed * lag, -speed * lag)
    behind = choose(ramp, (behind + trail) * exp(-ramp / lag) - trail, behind)
    put(z, Z.acting, choose(get(z, Z.lags), goal + behind * exp(-(after - ramp) / lag), goal))


@bare
def keep_goals(z: Array) -> None:
    """Goals at the end of a step; the last acting ones are those at its end."""
    put(z, Z.trailing, get(z, Z.acting))
    put(z, Z.followed, _followed(z, get(z, Z.length)))


@bare
def leave_goals(z: Array) -> None:
    """Distances of the goals from the command at the end of a tick, which the state holds."""
    put(z, Z.behind, get(z, Z.sent) - get(z, Z.followed))
    put(z, Z.lagged, get(z, Z.followed) - get(z, Z.trailing))


@bare
def _followed(z: Array, after: Any) -> Any:
    """Goals behind the speed limit, as `position_drive.followed`."""
    start, target, reach = get(z, Z.followed), get(z, Z.target), get(z, Z.drive_speed_limit) * after
    way = target - start
    return choose(abs(way) - reach, start + choose(way, reach, -reach), target)
