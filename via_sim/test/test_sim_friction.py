"""Set-valued dry friction: exact standstill, breakaway at the threshold, stick-slip."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from sim_joints import antagonistic, device, flexible, rigid, servo_flexible
from sim_together import simulate_many
from via_core.devices import load_device
from via_core.errors import ParameterError
from via_core.signals import Signals
from via_sim.effects import Effect
from via_sim.joint.measurements import MEASURED
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import InitialConditions, Simulator, simulate

RATE = 1000.0


def coulomb(torque: float, site: str = "link", motor: int = 0) -> Effect:
    return Effect("coulomb_friction", site, {"torque": torque}, motor)


def pushed(values) -> Signals:
    """An external torque, one value per tick."""
    values = np.asarray(values, dtype=float)
    time = np.arange(len(values)) / RATE
    return Signals(time, {"external_torque": values}, {"external_torque": "N m"}, frozenset({"external_torque"}))


@pytest.mark.parametrize("friction", [0.1, 0.3, 7.0])
def test_link_sticks_exactly_up_to_breakaway(friction):
    """A rigid link under gravity, held by friction."""
    for share, holds in ((0.5, True), (1.0, True), (1.0 + 1e-12, False), (1.01, False)):
        plant = JointPlant.from_device(rigid()).with_effects([coulomb(friction)])
        q = simulate(plant, pushed(np.full(5000, friction * share)), 5.0, RATE).truth["q"]
        assert bool(np.all(q == 0.0)) is holds
    assert q[-1] == pytest.approx(0.5 * 0.01 * friction / 0.02 * 25.0, rel=1e-9)  # the rest accelerates it evenly


def test_stuck_link_on_a_spring_stays_off_its_rest_position():
    plant = JointPlant.from_device(servo_flexible(10.0)).with_effects([coulomb(0.5)])
    held = simulate(plant, None, 20.0, RATE, initial=InitialConditions((0.049, 0, 0, 0, 0, 0))).truth["q"]
    assert np.all(held == 0.049)  # .49 N m of spring torque against .5
    freed = simulate(plant, None, 1.0, RATE, initial=InitialConditions((0.051, 0, 0, 0, 0, 0))).truth["q"]
    assert abs(freed[-1]) < 0.05 and freed[-1] != 0.051


def test_free_vibration_decays_linearly_and_stops():
    """Closed form: extremes decrease by 2 F / k per half period, and the link stops where |k q| <= F."""
    k, F, M = 10.0, 0.3, 0.02
    plant = JointPlant.from_device(servo_flexible(k)).with_effects([coulomb(F)])
    q = simulate(plant, None, 3.0, 10_000.0, initial=InitialConditions((0.5, 0, 0, 0, 0, 0))).truth["q"]
    half = np.pi * np.sqrt(M / k)
    extremes = [q[round(n * half * 10_000.0)] for n in range(9)]
    assert extremes == pytest.approx([(-1) ** n * (0.5 - n * 0.06) for n in range(9)], abs=1e-5)
    rest = q[round(9 * half * 10_000.0) :]
    assert np.all(rest == rest[0])
    assert abs(rest[0]) <= F / k


def test_stick_slip_follows_an_event_driven_reference():
    """A slow motor pulls a link with Stribeck friction through a spring; scipy integrates each phase."""
    k, M, B, D, torque, Fs, Fk, vs = 10.0, 0.02, 0.01, 2.0, 1.0, 0.6, 0.3, 1.0
    effect = Effect("stribeck_friction", "link", {"breakaway": Fs, "kinetic": Fk, "velocity": vs})
    joint = flexible(k, motor=f"{{inertia: {B}, viscous_friction: {D}}}")
    plant = JointPlant.from_device(joint).with_effects([effect])

    def rate(_t, x, slips):
        q, theta, v, w = x
        spring = k * (q - theta)
        friction = Fk + (Fs - Fk) * np.exp(-((v / vs) ** 2))
        return [v, w, (-spring - friction) / M if slips else 0.0, (torque + spring - D * w) / B]

    def breaks(_t, x, _slips):
        return k * (x[1] - x[0]) - Fs

    def stops(_t, x, _slips):
        return x[2]

    breaks.terminal, breaks.direction, stops.terminal, stops.direction = True, 1.0, True, -1.0
    time = np.arange(2001) / RATE
    reference, t, x, slips, phases = np.zeros(2001), 0.0, np.zeros(4), False, 0
    while t < time[-1]:
        event = stops if slips else breaks
        phase = solve_ivp(
            rate, (t, time[-1]), x, "DOP853", args=(slips,), events=event, rtol=1e-12, atol=1e-14, dense_output=True
        )
        inside = (time >= t) & (time <= phase.t[-1])
        if np.any(inside):
            reference[inside] = phase.sol(time[inside])[0]
        t, x, slips, phases = phase.t[-1], phase.y[:, -1], not slips, phases + 1
        if not slips:
            x[2] = 0.0
    assert phases > 6
    held = Signals(np.zeros(1), {"motor": np.full((1, 1), torque)}, {"motor": "N m"})
    q = simulate(plant, held, 2.0, RATE).truth["q"]
    assert np.max(np.abs(q - reference)) < 1e-6


def test_motor_friction_holds_only_the_motor():
    plant = JointPlant.from_device(flexible(10.0)).with_effects([coulomb(0.4, "motor", 1)])
    truth = simulate(
        plant, None, 0.3, RATE, initial=InitialConditions((0.039, 0, 0, 0, 0, 0))
    ).truth  # at most .39 N m on the motor
    assert np.all(truth["theta"] == 0.0)
    assert np.ptp(truth["q"]) > 0.07
    moved = simulate(plant, None, 0.3, RATE, initial=InitialConditions((0.2, 0, 0, 0, 0, 0))).truth
    assert np.ptp(moved["theta"]) > 0.0


def test_friction_dissipates_energy_independently_of_the_step():
    effects = [coulomb(0.05), coulomb(0.1, "motor", 1), Effect("backlash", "transmission", {"gap": 0.05}, 2)]
    plant = JointPlant.from_device(antagonistic()).with_effects(effects)
    start = (0.4, -0.3, 0.2, 2.0, 0.0, -3.0)
    coarse = simulate(plant, None, 1.0, RATE, initial=InitialConditions(start)).truth
    fine = simulate(plant, None, 1.0, 16.0 * RATE, initial=InitialConditions(start)).truth
    assert np.max(np.abs(coarse["q"] - fine["q"][::16])) < 1e-5
    phi = fine["deflection"] - np.array([0.0, 0.05]) * 0.5 * np.sign(fine["deflection"])
    phi[np.abs(fine["deflection"]) < [0.0, 0.025]] = 0.0
    stored = np.sum(2.5 * phi**2 + 2.5 * phi**4, axis=1)
    kinetic = 0.01 * fine["q_velocity"] ** 2 + 0.005 * np.sum(fine["theta_velocity"] ** 2, axis=1)
    assert np.max(np.diff(stored + kinetic)) < 1e-9


def test_stribeck_breakaway_exceeds_sliding_friction():
    effect = Effect("stribeck_friction", "link", {"breakaway": 0.5, "kinetic": 0.2, "velocity": 0.1})
    plant = JointPlant.from_device(rigid()).with_effects([effect])
    below = simulate(plant, pushed(np.full(1000, 0.5)), 1.0, RATE).truth["q"]
    assert np.all(below == 0.0)
    kicked = np.full(1000, 0.4)
    kicked[:50] = 0.6
    sliding = simulate(plant, pushed(kicked), 1.0, RATE).truth
    assert (
        sliding["q_velocity"][-1] > sliding["q_velocity"][100] > 0.1
    )  # .4 N m drives it on, though it could not start it
    with pytest.raises(ParameterError, match="must be >= kinetic"):
        JointPlant.from_device(rigid()).with_effects(
            [Effect("stribeck_friction", "link", {"breakaway": 0.1, "kinetic": 0.2, "velocity": 0.1})]
        )


def test_friction_effects_add_up():
    two = JointPlant.from_device(rigid()).with_effects([coulomb(0.1), coulomb(0.2)])
    for torque, holds in ((0.3, True), (0.31, False)):
        q = simulate_many([two], np.tile([0.0, 0.0, 0.0, torque], (200, 1)), RATE)[0, :, 0]
        assert bool(np.all(q == 0.0)) is holds


def test_velocity_zero_within_a_step_is_detected():
    """A link stops, sticks for 0.36 ms and continues between two ticks with forward velocity."""
    k, M, F, rise, lowest = 10.0, 0.02, 0.1, 20.0, 0.5e-3
    jerk = k * rise / M  # the motor runs ahead: v = v0 + jerk (t - lowest)^2 / 2 - jerk lowest^2 / 2
    servo = servo_flexible(k)
    start = (0.0, (F - M * jerk * lowest) / k, 0.0, 0.6e-3, rise, 0.0)
    plant = JointPlant.from_device(servo).with_effects([coulomb(F)])
    once = simulate(plant, None, 1e-3, RATE, initial=InitialConditions(start)).truth["q_velocity"][-1]
    fine = simulate(plant, None, 1e-3, 64.0 * RATE, initial=InitialConditions(start)).truth["q_velocity"]
    assert np.any(fine == 0.0)
    assert once == pytest.approx(fine[-1], abs=1e-6)
    assert once == pytest.approx(0.5 * jerk * lowest**2, rel=0.1)  # the servo brakes a little on the way


def test_substeps_resolve_the_falling_stribeck_curve():
    """Breakaway on a friction curve that accelerates the link from rest with a rate up to 1300 1/s."""
    effect = Effect("stribeck_friction", "link", {"breakaway": 0.5, "kinetic": 0.2, "velocity": 0.01})
    plant = JointPlant.from_device(rigid()).with_effects([effect])
    commands = np.tile([0.0, 0.0, 0.0, 0.51], (20, 1))
    coarse = simulate_many([plant], commands, RATE)[0]
    fine = simulate_many([plant], np.repeat(commands, 50, axis=0), 50.0 * RATE)[0, ::50]
    assert coarse[-1, 3] > 0.1
    assert np.max(np.abs(coarse[:, 3] - fine[:, 3])) < 5e-6


CLUTCH = "damper: {site: link, map: linear, minimum: 1.0, maximum: 4.0}"
STRIBECK = Effect("stribeck_friction", "link", {"breakaway": 0.3, "kinetic": 0.1, "velocity": 0.05})


def test_rigid_joint_measures_the_torque_dissipated_in_its_clutch():
    """The measured torque balances the link: M qdd + Dq qd + tau_link = tau_ext."""
    plant = JointPlant.from_device(device("rigid", "{inertia: 0.1, viscous_friction: 0.02}", CLUTCH))
    time = np.arange(2000) / RATE
    channels = {"external_torque": 4.0 * np.sin(5.0 * time), "damping": 0.5 + 0.4 * np.sin(2.0 * time)}
    run = simulate(
        plant.with_effects([STRIBECK]), Signals(time, channels, {"external_torque": "N m", "damping": "-"}), 2.0, RATE
    )
    torque, speed, damping = run.measured["tau_link"], run.truth["q_velocity"], run.truth["damping"]
    expected = damping * speed + np.sign(speed) * (0.1 + 0.2 * np.exp(-((speed / 0.05) ** 2)))
    moving = speed != 0.0
    assert moving[1:].mean() > 0.9 and damping.max() - damping.min() > 2.0
    np.testing.assert_allclose(torque[moving], expected[moving], rtol=1e-12)
    external = 4.0 * np.sin(5.0 * time)
    lost = np.cumsum((external - 0.02 * speed[1:]) / RATE - 0.1 * np.diff(speed))
    dissipated = np.cumsum(0.5 * (torque[1:] + torque[:-1]) / RATE)
    assert np.abs(dissipated - lost).max() < 0.01 * np.abs(dissipated).max()


def test_stuck_clutch_balances_the_applied_torque():
    plant = JointPlant.from_device(device("rigid", rest=CLUTCH))
    push = np.where(np.arange(100) < 50, 0.2, -0.1)
    run = simulate(plant.with_effects([STRIBECK]), pushed(push), 0.1, RATE)
    assert np.all(run.truth["q"] == 0.0)
    np.testing.assert_array_equal(run.measured["tau_link"], np.concatenate([[0.0], push]))
    simulator = Simulator(plant.with_effects([STRIBECK]), RATE)
    state, measured, _ = simulator.step(simulator.init(), (0.0, 0.0, 0.0, 0.2))
    assert measured[MEASURED.tau_link] == 0.2 == simulator.sample(state)[0][MEASURED.tau_link]


def test_link_torque_sensor_depends_on_the_device_file():
    vpda = load_device("compact_vpda")
    assert Sensors.of_device(vpda).link_torque_noise == 0.05
    run = simulate(JointPlant.from_device(vpda), None, 2.0, RATE, sensors=Sensors.of_device(vpda))
    assert np.std(run.measured["tau_link"]) == pytest.approx(0.05, rel=0.1)
    assert Sensors.of_device(rigid()).link_torque_noise is None
    without = simulate(JointPlant.from_device(rigid()), None, 0.01, RATE, sensors=Sensors.of_device(rigid()))
    assert np.isnan(without.measured["tau_link"]).all()
