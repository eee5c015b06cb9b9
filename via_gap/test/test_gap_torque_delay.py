"""Measured torques of the tick before or after their sample: neither is a cause, and both models are exact.

The joint is integrated here, in closed form for a constant torque over each tick.
"""

from dataclasses import replace

import numpy as np
import pytest
from gap_logs import rigid
from via_core.device_parts import WireColumn
from via_core.devices import Device
from via_core.signals import Signals
from via_gap.diagnosis import diagnose
from via_gap.logs.log import JointLog
from via_gap.residual.segments import cut_log
from via_gap.selection.experiment import Experiment
from via_sim.joint.parameters import P
from via_sim.plants import JointPlant

PERIOD, INERTIA, DRAG = 0.005, 0.04, 0.1
QUANTUM = 2e-6


def recorded(device: Device, after: bool, missing_drag: float = 0.0, duration: float = 20.0) -> JointLog:
    """Angle and torque of a joint in a velocity loop; the torque of a sample acts in the tick before or after it."""
    count = round(duration / PERIOD)
    time, drag = PERIOD * np.arange(count), DRAG + missing_drag
    fade = np.exp(-drag / INERTIA * PERIOD)
    wish = 1.2 * np.cos(2.3 * time) + 0.9 * np.cos(5.9 * time + 1.0) + 0.6 * np.cos(0.7 * time)
    angle, speed = np.zeros(count + 1), np.zeros(count + 1)
    torque = np.zeros(count)
    for k in range(count):
        torque[k] = 0.6 * (wish[k] - speed[k]) + 0.1 * wish[k]
        last = torque[k] / drag
        speed[k + 1] = last + (speed[k] - last) * fade
        angle[k + 1] = angle[k] + last * PERIOD + (speed[k] - last) * (1.0 - fade) * INERTIA / drag
    q = QUANTUM * np.round(angle / QUANTUM)
    shown = q[:-1] if after else q[1:]
    tau = {"tau": torque[:, None]}
    return JointLog("log", device, Signals(time, {"q": shown, **tau}, {"q": "rad", "tau": "N m"}), None)


def joint() -> Device:
    device = rigid()
    link = device.link.model_copy(update={"gravity_torque": 0.0})
    sensors = device.sensors.model_copy(update={"rate": 1.0 / PERIOD, "link_quantum": QUANTUM})
    return device.model_copy(update={"link": link, "sensors": sensors})


@pytest.mark.parametrize("after", [False, True])
def test_the_tick_of_a_torque_is_found_and_is_no_device_parameter(after: bool):
    device = joint()
    experiment = Experiment.of([cut_log(recorded(device, after))], [])
    found = dict(zip([n.name for n in experiment.fitted.nuisances], experiment.tuned.fit.offsets, strict=True))
    assert PERIOD * found["torque delay between samples"] == pytest.approx(PERIOD * after, abs=0.05 * PERIOD)
    assert experiment.tuned.mean_square < 2.0
    repaired = JointPlant.from_device(experiment.fitted.repaired(experiment.tuned.fit.offsets))
    fitted = experiment.fitted.row((), experiment.tuned.fit.offsets)
    assert repaired.parameters[P.delay] == 0.0 and (fitted[P.delay] > 0.0) == after


def test_a_torque_of_the_next_tick_is_no_cause_beside_another_one():
    """Without its delay, the exact angles of this log would require a late command beside the friction."""
    device = joint()
    report = diagnose([recorded(device, after=True, missing_drag=0.08)], device)
    assert [each.effect for each in report.effects] == ["viscous_friction"]
    assert report.repair()[0].parameters["coefficient"] == pytest.approx(0.08, rel=0.1)
    assert diagnose([recorded(device, after=True)], device).verdict == "no_gap"


def test_a_column_of_torques_is_driven_as_a_measured_torque():
    device = joint()
    log = recorded(device, after=False)
    columns = {"external_torque": WireColumn(column="torque", measured=True)}
    read = device.model_copy(update={"wire": device.wire.model_copy(update={"columns": columns})})
    torque = Signals(log.measured.time, {"external_torque": log.measured["tau"][:, 0]}, {"external_torque": "N m"})
    torque = replace(torque, held=frozenset({"external_torque"}))
    other = JointLog("log", read, log.measured.select(["q"]), torque)
    ours, theirs = cut_log(log), cut_log(other)
    np.testing.assert_array_equal(ours.commands, theirs.commands)
