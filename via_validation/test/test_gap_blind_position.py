"""Position drives: the second simulator against the first, and the diagnosis of a planted speed limit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from via_core.devices import Device, parse_device
from via_core.signals import Array, Signals
from via_gap.diagnosis import diagnose
from via_gap.logs.log import JointLog
from via_sim.effects import Effect
from via_sim.plants import JointPlant
from via_sim.simulate import InitialConditions
from via_sim.simulate import simulate as first
from via_validation.sealed.excitation import excite
from via_validation.sealed.joints import POSITIONED, as_yaml, believed, device_of, draw_joint, servo_of
from via_validation.sealed.physics import Physics
from via_validation.sealed.recorder import Recorder
from via_validation.sealed.recording import sense
from via_validation.sealed.scene import scene_of
from via_validation.sealed.selections import OF_POSITION
from via_validation.sealed.stepping import Drive, Run, simulate

DURATION = 4.0  # [s]
STEP = 0.05e-3  # [s] of the second simulator, whose goal moves once a step
HELD = frozenset({"equilibrium"})
START = np.zeros(1)  # [rad] at rest at the first goal


def drawn(seed: int = 3) -> tuple[Device, Device, Drive]:
    """A joint as both simulators take it, without friction of its own, and a motion with a jump of its goal."""
    rng = np.random.default_rng(seed)
    content = draw_joint(rng, POSITIONED)
    content["link"].pop("coulomb_friction", None)
    content["servo"] |= {"delay": 0.0}  # until its first goal comes the drive of the first simulator is off
    content["servo"].pop("speed_limit", None)
    device = device_of(content)
    drive = excite(rng, device, DURATION, 1.0, 200.0, servo_of(content))
    jump = 0.4 * (np.arange(len(drive.references)) > 300)[:, None]
    return device, parse_device(as_yaml(content), "joint"), replace(drive, references=drive.references + jump)


def repeated(device: Device, run: Run, effects: tuple[Effect, ...], before: Array) -> Array:
    """(N+1,) [rad] link angle of the first simulator under the goals of a run of the second.

    before  (1,) [rad] goal while none has come
    """
    time = run.time[:-1]
    goals = Signals(time, {"equilibrium": run.commands[:, 0]}, {"equilibrium": "rad"}, HELD)
    start = np.array([before[0], 0.0, 0.0, 0.0, 0.0, 0.0])
    return first(
        JointPlant.from_device(device).with_effects(effects),
        goals,
        run.time[-1],
        200.0,
        initial=InitialConditions(start),
    ).truth["q"]


def planted(name: str, device: Device, drive: Drive) -> tuple[Physics, Effect]:
    """A clear amount of an effect, of one order where it has several."""
    run = simulate(device, Physics(), drive, np.zeros(len(drive.references)), START, STEP)
    assert run is not None
    rng, scene, entry = np.random.default_rng(5), scene_of(device, run), OF_POSITION[name]
    shape = {key: value for key, value in entry.shape(rng, scene).items() if key[-2:] not in ("_2", "_3", "_4")}
    site, motor = entry.locations(device)[-1]
    size = {"actuator_delay": 0.03, "speed_limit": 1.5, "load_dependent_friction": 0.25}.get(name, 0.5 * entry.high)
    physics, numbers = entry.of_size(scene, (site, motor), size, shape)
    return physics, Effect(name, site, numbers, motor)


@pytest.mark.parametrize("name", OF_POSITION)
def test_every_effect_of_a_position_drive_is_the_same_physics_in_both(name: str) -> None:
    """To the integration error of the second simulator, of first order where friction follows the drive's torque.

    A dead band is discontinuous, and both notice its edge at their next step only.
    """
    true, device, drive = drawn()
    physics, effect = planted(name, true, drive)
    still = np.zeros(len(drive.references))
    coarse, fine = (simulate(true, physics, drive, still, START, step) for step in (2.0 * STEP, STEP))
    assert coarse is not None and fine is not None
    found = 2.0 * fine.angle[:, 0] - coarse.angle[:, 0]
    with_effect, without = (repeated(device, fine, effects, START) for effects in ((effect,), ()))
    assert np.abs(found - without).max() > 0.01
    width = effect.parameters["width"] if name == "position_deadband" else 0.0
    assert np.abs(found - with_effect).max() < 5e-5 + 0.02 * width


def recorded(seed: int, name: str, size: float, duration: float) -> tuple[JointLog, Effect]:
    """What an observer gets of a drive with an effect: a noisy log, and the numbers of the file up to 5 % off."""
    rng = np.random.default_rng(seed)
    content = draw_joint(rng, POSITIONED)
    content["servo"].pop("speed_limit", None)
    true = device_of(content)
    drive = excite(rng, true, duration, 1.0, 250.0, servo_of(content))
    plain = simulate(true, Physics(), drive, np.zeros(len(drive.references)), START)
    assert plain is not None
    entry = OF_POSITION[name]
    place = entry.locations(true)[0]
    physics, numbers = entry.of_size(scene_of(true, plain), place, size, {})
    run = simulate(true, physics, drive, np.zeros(len(drive.references)), START)
    assert run is not None
    log = sense(rng, true, physics, drive, run, Recorder(encoder_noise=0.5))
    nominal, _ = believed(rng, content, 0.05)
    device = parse_device(as_yaml(nominal), "joint")
    measured = Signals(log.time, {"q": log.q}, {"q": "rad"})
    goals = Signals(log.command_time, {"equilibrium": log.commands[:, 0]}, {"equilibrium": "rad"}, HELD)
    return JointLog("run", device, measured, goals), Effect(name, place[0], numbers, place[1])


@pytest.mark.parametrize(("name", "size"), [("speed_limit", 1 / 1.2), ("position_deadband", 0.03)])
def test_a_defect_of_the_goal_is_named_and_measured(name: str, size: float) -> None:
    log, planted = recorded(7, name, size, 12.0)
    report = diagnose([log], log.device)
    assert [(each.effect, each.site, each.motor) for each in report.effects] == [(name, planted.site, planted.motor)]
    assert report.verdict == "effect"
    for parameter, value in planted.parameters.items():
        assert report.causes[0].parameters[parameter].value == pytest.approx(value, rel=0.03)


@pytest.mark.parametrize("name", ["torque_gain", "position_gain"])
def test_a_wrong_torque_constant_is_told_from_a_wrong_position_gain(name: str) -> None:
    """kp and kd of the device file are up to 5 % off themselves."""
    log, planted = recorded(7, name, -0.3, 12.0)
    report = diagnose([log], log.device)
    assert (report.verdict, [each.effect for each in report.effects]) == ("effect", [name])
    assert report.causes[0].parameters["gain"].value == pytest.approx(planted.parameters["gain"], rel=0.06)
