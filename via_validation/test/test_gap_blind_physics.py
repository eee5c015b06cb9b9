"""The second simulator against the first: nominal joints and every named effect, under the same commands."""

from __future__ import annotations

import numpy as np
import pytest
from via_core.devices import Device, load_device
from via_core.signals import Array, Signals
from via_sim.effects import EFFECTS, Effect, places
from via_sim.plants import JointPlant
from via_sim.simulate import InitialConditions, Simulation
from via_sim.simulate import simulate as first
from via_validation.sealed.catalogue import CATALOGUE
from via_validation.sealed.excitation import excite, start_of
from via_validation.sealed.experiment import push_of
from via_validation.sealed.joints import FAMILIES, believed, device_of, draw_joint
from via_validation.sealed.model import STEP
from via_validation.sealed.physics import Physics
from via_validation.sealed.recording import neighbour_angle, sense
from via_validation.sealed.scene import scene_of
from via_validation.sealed.selections import OF_POSITION
from via_validation.sealed.stepping import Drive, Run
from via_validation.sealed.stepping import simulate as second
from via_validation.sealed.unmodelled import UNMODELLED

DURATION = 5.0  # [s]
FLOOR = 9.6e-5  # [rad] a step of a 16-bit encoder; what MuJoCo's soft dry friction leaves is about half of it


def drawn(family: str, seed: int) -> tuple[Device, Drive, Array]:
    """A true joint, a motion and where it starts."""
    rng = np.random.default_rng([seed, FAMILIES.index(family)])
    device = device_of(draw_joint(rng, family))
    drive = excite(rng, device, DURATION, 1.0)
    return device, drive, start_of(device, drive)


def repeated(
    device: Device, drive: Drive, physics: Physics, initial: Array, run: Run, effects: tuple[Effect, ...]
) -> Simulation:
    """The commands of a run of the second simulator on the first."""
    time = run.time[:-1]
    channels = {"motor": run.commands} if device.motors else {"external_torque": run.commands[:, 0]}
    if device.damper is not None:
        channels["damping"] = drive.damping
    if physics.coupling:
        channels["neighbour"] = neighbour_angle(physics.neighbour_period, time)
    units = {"motor": "N m", "external_torque": "N m", "damping": "-", "neighbour": "rad"}
    commands = Signals(time, channels, units, frozenset(channels))
    start = np.zeros(6)
    start[: len(initial)] = initial
    plant = JointPlant.from_device(device)
    return first(plant.with_effects(effects), commands, run.time[-1], drive.rate, initial=InitialConditions(start))


def angles(simulation: Simulation) -> Array:
    there = [name for name in ("q", "theta") if name in simulation.truth]
    return np.column_stack([simulation.truth[name] for name in there])


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("family", FAMILIES)
def test_without_effect_both_simulators_agree_below_the_noise(family: str, seed: int) -> None:
    device, drive, initial = drawn(family, seed)
    run = second(device, Physics(), drive, np.zeros(len(drive.references)), initial)
    assert run is not None
    assert np.ptp(run.angle[:, 0]) > 0.1  # it moves
    difference = angles(repeated(device, drive, Physics(), initial, run, ())) - run.angle
    dry = any(getattr(axis, "coulomb_friction", 0.0) for axis in (device.link, *device.motors))
    assert np.abs(difference).max() < (FLOOR if dry else 1e-6)


@pytest.mark.parametrize("name", ["cubic_demo", "qbmove_a", "maccepavd"])
def test_shipped_devices_agree_too(name: str) -> None:
    device = load_device(name)
    if device.sensors.rate == 217.0:
        device = device.model_copy(update={"sensors": device.sensors.model_copy(update={"rate": 200.0})})
    rng = np.random.default_rng(5)
    drive = excite(rng, device, 3.0, 0.5)
    initial = start_of(device, drive)
    run = second(device, Physics(), drive, np.zeros(len(drive.references)), initial)
    assert run is not None
    difference = angles(repeated(device, drive, Physics(), initial, run, ())) - run.angle
    assert np.abs(difference).max() < FLOOR


def test_the_error_decreases_with_the_step() -> None:
    """Exponential springs are torques of the loop, with an error of second order in the step."""
    device, drive, initial = drawn("exponential_pair", 0)
    exact, none = None, np.zeros(len(drive.references))
    errors = []
    for step in (4.0 * STEP, 2.0 * STEP, STEP):
        run = second(device, Physics(), drive, none, initial, step)
        assert run is not None
        exact = angles(repeated(device, drive, Physics(), initial, run, ()))
        errors.append(np.abs(exact - run.angle).max())
    assert errors[0] > 3.0 * errors[1] > 9.0 * errors[2]  # second order


FAMILY_OF = {
    "gravity_error": "stiff",
    "payload": "series_elastic",
    "preset_error": "polynomial_pair",
    "contact": "polynomial_pair",
    "stiffness_drift": "exponential_pair",
    "spring_law": "polynomial_pair",
    "actuator_delay": "variable_damping",
}


RIGID = ("load_dependent_friction", "torque_gain", "torque_ripple", "torque_saturation", "actuator_lag", "payload")


@pytest.mark.parametrize(
    ("name", "family"),
    [(name, FAMILY_OF.get(name, "series_elastic")) for name in CATALOGUE] + [(name, "rigid") for name in RIGID],
)
def test_every_named_effect_is_the_same_physics_in_both_simulators(name: str, family: str) -> None:
    entry = CATALOGUE[name]
    seed = next(s for s in range(20) if entry.locations(drawn(family, s)[0]))
    device, drive, initial = drawn(family, seed)
    rng = np.random.default_rng(3)
    plain = second(device, Physics(), drive, np.zeros(len(drive.references)), initial)
    assert plain is not None
    scene = scene_of(device, plain)
    site, number = entry.locations(device)[-1]
    size = {"actuator_delay": 0.01}.get(name, min(2.0 * entry.low + 0.1 * entry.high, entry.high))
    shape = {key: value for key, value in entry.shape(rng, scene).items() if key[-2:] not in ("_2", "_3", "_4")}
    physics, numbers = entry.of_size(scene, (site, number), size, shape)
    run = second(device, physics, drive, push_of(rng, physics, drive), initial)
    assert run is not None
    quiet = device.model_copy(update={"sensors": device.sensors.model_copy(update={"torque_noise": 0.0})})
    log = sense(rng, quiet, physics, drive, run)
    effect = Effect(name, site, numbers, number)
    left = []
    for effects in ((), (effect,)):
        seen = repeated(device, drive, physics, initial, run, effects).measured
        shown = [seen[name] for name in ("q", "theta", "tau") if name in seen]
        recorded = [log.q, log.theta, log.tau][: len(shown)]
        error = np.nan_to_num(np.column_stack(shown) - np.column_stack(recorded))
        left.append(np.sqrt(np.mean(error**2, axis=0)))
    worst = int(np.argmax(left[0]))
    quantum = max(device.sensors.link_quantum or 0.0, device.sensors.motor_quantum or 0.0)
    assert left[0][worst] > 3.0 * left[1][worst]  # it acts
    assert left[1][worst] < max(0.05 * left[0][worst], quantum)


@pytest.mark.parametrize("name", list(UNMODELLED))
def test_physics_outside_the_catalogue_acts(name: str) -> None:
    """The measured link angle changes by far more than the sensor noise."""
    entry = UNMODELLED[name]
    device, drive, initial = drawn("polynomial_pair", 1)
    rng, none = np.random.default_rng(3), np.zeros(len(drive.references))
    plain = second(device, Physics(), drive, none, initial)
    assert plain is not None
    scene = scene_of(device, plain)
    place = entry.locations(device)[-1]
    physics, _ = entry.of_size(scene, place, 0.5 * entry.high, entry.shape(rng, scene))
    run = second(device, physics, drive, push_of(rng, physics, drive), initial)
    assert run is not None
    logs = [sense(np.random.default_rng(8), device, p, drive, r) for p, r in ((Physics(), plain), (physics, run))]
    assert np.abs(logs[0].q - logs[1].q).max() > 20.0 * FLOOR


def test_two_effects_join_unless_they_change_the_same_field() -> None:
    lag, gap = Physics(lag=0.01), Physics(gap=(0.1, 0.0))
    both = lag.joined(gap)
    assert (both.lag, both.gap, both.friction) == (0.01, (0.1, 0.0), (0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="both change lag"):
        both.joined(Physics(lag=0.02))


def test_locations_are_those_of_the_first_catalogue() -> None:
    assert list(CATALOGUE) == [name for name, kind in EFFECTS.items() if not kind.of_goal]
    assert {name for name, kind in EFFECTS.items() if kind.of_goal} <= set(OF_POSITION)
    for family in FAMILIES:
        for seed in range(4):
            device = drawn(family, seed)[0]
            for name, entry in CATALOGUE.items():
                assert set(entry.locations(device)) <= set(places(name, device))


@pytest.mark.parametrize("family", FAMILIES)
def test_the_nominal_file_is_wrong_by_up_to_five_percent(family: str) -> None:
    rng = np.random.default_rng(9)
    true = draw_joint(rng, family)
    nominal, errors = believed(rng, true)
    assert errors and all(abs(each) <= 0.05 for each in errors.values())
    assert "tolerances" not in nominal  # 5 % is what a device file means that states none
    assert nominal["link"]["inertia"] == pytest.approx(
        true["link"]["inertia"] * (1.0 + errors["link.inertia"]), rel=1e-5
    )
    assert nominal["sensors"] == true["sensors"]
    given = {key for key in true["link"] if key.startswith("gravity")}
    assert all(nominal["link"][key] == true["link"][key] for key in given)
    device_of(nominal)
