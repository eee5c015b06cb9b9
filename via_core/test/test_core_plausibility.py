"""Torque equations of a device against signals that it can or cannot produce, and the names of the faults."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from via_core.device_parts import WireColumn
from via_core.devices import load_device
from via_core.faults import fault_of, faulty_time
from via_core.modulated_rows import IMPOSSIBLE, Samples
from via_core.plausibility import equations_of, recorded_equations, worst
from via_core.signals import Signals

CUBIC, QBMOVE, ELASTIC, DAMPER, PENDULUM = (
    load_device(name)
    for name in ("cubic_demo", "qbmove_a", "visco_elastic_demo", "compact_vpda", "dfki_simple_pendulum")
)
PERIOD = 2e-3
MOTION = np.arange(1500) * PERIOD  # three seconds


def moved(device, inertia=1.0, damping=1.0, spring=1.0, friction=0.0, offset=0.0, noise=0.0, time=MOTION, pace=1.0):
    """Samples of a device in smooth motion under the torques that it needs; factors of its file and of speed."""
    rng = np.random.default_rng(1)
    reach = 0.35 * device.springs[0].max_deflection
    theta, torque = [], []
    q = 0.3 * reach * np.sin(5.0 * pace * time)
    middle = time - 0.5 * (time[1] - time[0])  # a torque acts over the interval that ends at its stamp
    for i, motor in enumerate(device.motors):
        sign, own = 1 - 2 * i, pace * (6.0 + 3.0 * i)

        def angle(t, sign=sign, own=own):
            return reach * (sign + 0.5 * np.sin(own * t))

        rate, bend = 0.5 * reach * own * np.cos(own * middle), -0.5 * reach * own**2 * np.sin(own * middle)
        load = device.springs[i].torque(0.3 * reach * np.sin(5.0 * pace * middle) - angle(middle))
        tau = inertia * motor.inertia * bend + damping * motor.viscous_friction * rate - spring * load
        size = np.sqrt(np.mean(tau**2))
        theta.append(angle(time))
        torque.append(tau + size * (friction * np.sign(rate) + offset + noise * rng.normal(size=len(time))))
    return Samples(time, q, np.column_stack(theta), np.column_stack(torque))


def damped(damping=2.0):
    rate = np.cos(4.0 * MOTION) + 0.5 * np.cos(9.0 * MOTION)
    angle = 0.25 * np.sin(4.0 * MOTION) + 0.5 / 9.0 * np.sin(9.0 * MOTION)
    return Samples(MOTION, angle, np.empty((len(MOTION), 0)), (damping * rate)[:, None])


def share(device, samples):
    return worst([each.share(samples.between(0.9, 1.9)) for each in equations_of(device)])


@pytest.mark.parametrize("device", [CUBIC, QBMOVE, ELASTIC], ids=lambda each: each.name)
@pytest.mark.parametrize(
    "changes",
    [{}, {"inertia": 2.0}, {"inertia": 0.5, "damping": 5.0}, {"spring": 0.5}, {"spring": 2.0}, {"friction": 0.5},
     {"offset": 0.05}, {"noise": 0.3}],
)  # fmt: skip
def test_signals_of_a_device_near_its_file_are_possible(device, changes):
    found = share(device, moved(device, **changes))
    assert found.known and found.unexplained < 0.5 * IMPOSSIBLE


@settings(max_examples=40, deadline=None)
@given(
    st.floats(0.45, 2.2), st.floats(0.0, 5.0), st.floats(0.45, 2.2), st.floats(0.0, 0.5), st.floats(0.0, 0.3),
    st.sampled_from([CUBIC, QBMOVE, ELASTIC]),
)  # fmt: skip
def test_any_number_within_the_bounds_is_possible(inertia, damping, spring, friction, noise, device):
    found = share(device, moved(device, inertia, damping, spring, friction, noise=noise))
    assert not found.impossible


def frozen(values, columns):
    return np.where(np.isin(np.arange(values.shape[1]), columns), values[400], values)


FAULTS = {
    "tau_1, tau_2 sign": (lambda s: s._replace(torque=-s.torque), "wrong sign of tau_1, tau_2"),
    "tau_1 sign": (lambda s: s._replace(torque=s.torque * [-1.0, 1.0]), "wrong sign of tau_1"),
    "theta sign": (lambda s: s._replace(theta=-s.theta), "wrong sign of theta_1, theta_2"),
    "q sign": (lambda s: s._replace(q=-s.q), "wrong sign of q"),
    "swapped": (lambda s: s._replace(torque=s.torque[:, ::-1]), "are exchanged"),
    "zero": (lambda s: s._replace(torque=0.0 * s.torque), "tau_1, tau_2: zero throughout"),
    "frozen torque": (lambda s: s._replace(torque=frozen(s.torque, [1])), "tau_2: one number repeated"),
    "frozen encoder": (lambda s: s._replace(theta=frozen(s.theta, [0])), "theta_1: one number repeated"),
    "N mm": (lambda s: s._replace(torque=1e3 * s.torque), "tau_1, tau_2 in N mm, not in N m"),
    "degrees": (lambda s: s._replace(q=np.degrees(s.q), theta=np.degrees(s.theta)), "in degrees, not in rad"),
}


# The link of the qbmove moves too little beside its motors for the sign of its angle to matter.
@pytest.mark.parametrize(
    ("device", "name"),
    [(device, name) for device in (CUBIC, QBMOVE) for name in FAULTS if (device, name) != (QBMOVE, "q sign")],
    ids=lambda each: each if isinstance(each, str) else each.name,
)
def test_a_fault_is_found_and_named(device, name):
    change, words = FAULTS[name]
    sound = moved(device, noise=0.01)
    assert fault_of(device, sound.between(0.9, 1.9)) is None and faulty_time(device, sound) is None
    faulty = change(sound)
    fault = fault_of(device, faulty.between(0.9, 1.9))
    assert fault is not None and words in fault.text
    whole = faulty_time(device, faulty)
    assert whole is not None and whole.fault.text == fault.text and whole.share > 0.9


def test_a_gap_longer_than_an_interval_is_no_fault_and_hides_none():
    sound = moved(CUBIC, noise=0.01)
    later = sound._replace(time=np.where(sound.time < np.median(sound.time), sound.time, sound.time + 5.0))
    assert faulty_time(CUBIC, later) is None
    whole = faulty_time(CUBIC, later._replace(torque=-later.torque))
    assert whole is not None and "wrong sign" in whole.fault.text


def test_torques_of_another_device_have_no_name_but_are_impossible():
    rng = np.random.default_rng(2)
    samples = moved(CUBIC)
    slow = np.column_stack([np.convolve(rng.normal(size=len(MOTION)), np.ones(50) / 50, "same") for _ in range(2)])
    fault = fault_of(CUBIC, samples._replace(torque=5.0 * slow).between(0.9, 1.9))
    assert fault is not None and "fit no motor and spring" in fault.text and not fault.proven


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda s: s._replace(torque=-s.torque), "wrong sign of tau_link"),
        (lambda s: s._replace(torque=0.0 * s.torque), "tau_link: zero throughout"),
        (lambda s: s._replace(torque=0.0 * s.torque + 1.5), "tau_link: one number repeated"),
        (lambda s: s._replace(torque=1e3 * s.torque), "tau_link in N mm"),
    ],
)
def test_faults_of_a_damper_are_named(change, words):
    sound = damped()
    assert share(DAMPER, sound).known and fault_of(DAMPER, sound.between(0.9, 1.9)) is None
    fault = fault_of(DAMPER, change(sound).between(0.9, 1.9))
    assert fault is not None and words in fault.text


def test_a_motor_at_rest_says_nothing_about_its_friction():
    """Declared dry friction takes up any torque of a motor that does not move; undeclared friction does not."""
    rest = moved(CUBIC)
    still = rest._replace(q=0.0 * rest.q, theta=np.tile([0.5, -0.5], (len(MOTION), 1)))
    hold = -CUBIC.torque_each(still.q, still.theta) + 0.5 * np.sin(7.0 * MOTION)[:, None]
    still = still._replace(torque=hold)
    assert share(CUBIC, still).impossible
    motors = tuple(motor.model_copy(update={"coulomb_friction": 0.3}) for motor in CUBIC.motors)
    assert not share(CUBIC.model_copy(update={"motors": motors}), still).impossible


def test_standstill_and_short_logs_are_unknown():
    samples = moved(CUBIC)
    assert not share(
        CUBIC, samples._replace(torque=0.0 * samples.torque, q=0.0 * samples.q, theta=0.0 * samples.theta)
    ).known
    assert not worst([each.share(samples.between(0.0, 0.05)) for each in equations_of(CUBIC)]).known
    position = load_device("xl330")
    assert equations_of(position) == () and faulty_time(position, samples) is None


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("device", [CUBIC, QBMOVE, ELASTIC], ids=lambda each: each.name)
def test_a_channel_that_is_not_measured_says_nothing(device):
    samples = moved(device)
    for missing in (samples._replace(q=np.nan * samples.q), samples._replace(theta=np.nan * samples.theta)):
        assert not share(device, missing).known


@pytest.mark.parametrize("kept", [0.9, 0.5])
def test_lost_samples_and_jitter_do_not_matter(kept):
    rng = np.random.default_rng(4)
    samples = moved(CUBIC, time=np.arange(3000) * 1e-3)
    chosen = rng.random(3000) < kept
    samples = Samples(*(each[chosen] for each in samples[:4]))
    samples = samples._replace(time=samples.time + rng.uniform(-2e-4, 2e-4, len(samples.time)))
    assert share(CUBIC, samples).unexplained < 0.1


def swung(weight=1.0, pushed=0.0):
    """Samples of a pendulum that follows two sines; its weight over that of the file, and torques of a person."""
    link, rng = PENDULUM.link, np.random.default_rng(3)

    def angle(t):
        return 0.9 * np.sin(3.0 * t) + 0.5 * np.sin(7.0 * t)

    t = MOTION - 0.5 * PERIOD
    speed, bend = 2.7 * np.cos(3.0 * t) + 3.5 * np.cos(7.0 * t), -8.1 * np.sin(3.0 * t) - 24.5 * np.sin(7.0 * t)
    tau = link.inertia * bend + link.viscous_friction * speed + link.coulomb_friction * np.sign(speed)
    tau += weight * link.gravity_torque * np.sin(angle(t) - link.gravity_angle) + pushed * np.sin(2.0 * t)
    tau += 0.01 * rng.normal(size=len(t))
    return Samples(MOTION, angle(MOTION), np.empty((len(t), 0)), tau[:, None])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda s: s._replace(torque=-s.torque), "opposite signs of external_torque (column 'torque'), q"),
        (lambda s: s._replace(q=-s.q), "opposite signs of external_torque (column 'torque'), q"),
        (lambda s: s._replace(torque=1e3 * s.torque), "external_torque (column 'torque') in N mm"),
        (lambda s: s._replace(q=np.degrees(s.q)), "q (column 'position') in degrees"),
    ],
)
def test_a_recording_of_a_rigid_link_proves_wrong_signs_and_units(change, words):
    assert faulty_time(PENDULUM, swung()) is None
    found = faulty_time(PENDULUM, change(swung()))
    assert found is not None and words in found.fault.text and found.fault.proven


def held():
    """A person pushes the pendulum six times against its drive, a weak spring and damper."""
    link, angle, speed = PENDULUM.link, 0.0, 0.0
    time, motion = np.arange(10_000) * PERIOD, []
    slips = PERIOD * link.coulomb_friction / link.inertia
    for t in time:
        hand = 1.7 * np.sign(np.sin(2.0 * np.pi * t / 6.0)) * (t % 3.0 > 0.9)
        motion.append((angle, -0.7 * angle - 0.07 * speed))
        torque = motion[-1][1] + hand - link.gravity_torque * np.sin(angle) - link.viscous_friction * speed
        free = speed + PERIOD * torque / link.inertia
        speed = np.sign(free) * max(abs(free) - slips, 0.0)
        angle += PERIOD * speed
    q, tau = np.array(motion).T
    return Samples(time, q, np.empty((len(time), 0)), tau[:, None])


@pytest.mark.parametrize(
    "sound",
    [swung(weight=4.0), swung(pushed=10.0), swung()._replace(torque=np.zeros((len(MOTION), 1))), held()],
    ids=["payload", "pushed", "moved by its neighbour", "moved by hand"],
)
def test_what_loads_a_rigid_link_is_no_fault_of_its_signals(sound):
    assert recorded_equations(PENDULUM)[0].share(sound.between(0.9, 1.9)).impossible
    assert faulty_time(PENDULUM, sound) is None
    assert fault_of(PENDULUM, sound.between(0.9, 1.9)) is None  # nothing is said of it while it runs


@pytest.mark.parametrize("where", ["commands", "measured"])
def test_torques_of_the_other_joints_of_an_arm_belong_to_the_equation_of_a_link(where):
    sound = swung()
    load, units = 30.0 * np.sin(5.0 * MOTION), {"q": "rad", "tau": "N m", "external_torque": "N m", "arm_torque": "N m"}
    driven = sound.torque[:, 0] + load
    channels = {"external_torque": driven} if where == "commands" else {}
    measured = {"q": sound.q} | ({"tau": driven[:, None]} if where == "measured" else {})
    commands = Signals(MOTION, {**channels, "arm_torque": -load}, units, frozenset({"arm_torque", *channels}))
    samples = Samples.of_signals(Signals(MOTION, measured, units), PENDULUM, commands)
    assert samples is not None and samples.torque[:, 0] == pytest.approx(sound.torque[:, 0], abs=1e-12)
    assert faulty_time(PENDULUM, samples) is None


@pytest.mark.parametrize("device", [CUBIC, QBMOVE, ELASTIC], ids=lambda each: each.name)
@pytest.mark.parametrize(("bits", "pace"), [(12, 1.0), (10, 1.0), (10, 0.6), (10, 0.4)])
def test_a_coarse_encoder_that_the_file_states_is_no_fault(device, bits, pace):
    """A tenth of a second holds a few encoder steps only; their direction is known, and damping acts."""
    step = 2.0 * np.pi / 2**bits
    declared = device.model_copy(
        update={"sensors": device.sensors.model_copy(update={"link_quantum": step, "motor_quantum": step})}
    )
    sound = moved(device, noise=0.02, time=np.arange(10000) * 1e-3, pace=pace)
    coarse = sound._replace(q=np.round(sound.q / step) * step, theta=np.round(sound.theta / step) * step)
    assert faulty_time(declared, coarse) is None
    found = faulty_time(declared, coarse._replace(torque=-coarse.torque))
    assert found is not None and found.fault.proven


def test_a_motor_that_creeps_through_its_friction_is_no_fault():
    """Before it slides, the declared dry friction may point anywhere, whatever the direction of motion."""
    sound = moved(QBMOVE, noise=0.01)
    motor = QBMOVE.motors[0]
    creep, q = 0.02 + 8e-4 * np.sin(12.0 * MOTION), 0.35 + 0.02 * np.sin(4.0 * MOTION)
    theta = np.column_stack([creep, sound.theta[:, 1]])
    held = 0.9 * motor.coulomb_friction * np.sin(12.0 * MOTION)  # as of a bristle, in phase with the travel
    noise = 1e-3 * np.random.default_rng(0).normal(size=len(q))
    samples = sound._replace(q=q, theta=theta)

    def of_motor_1(torque):
        both = np.column_stack([held - QBMOVE.springs[0].torque(q - creep) + torque, sound.torque[:, 1]])
        return equations_of(QBMOVE)[0].share(samples._replace(torque=both).between(0.9, 1.9))

    assert not of_motor_1(noise).impossible
    assert of_motor_1(noise + 0.2).impossible


@pytest.mark.parametrize("travel", [5e-3, 1e-2])
def test_declared_friction_that_builds_up_with_travel_is_no_fault(travel):
    """Dry friction of the size of the load turns with the motion, some mrad after it."""
    friction = 0.15
    motor = QBMOVE.motors[0].model_copy(update={"coulomb_friction": friction})
    device = QBMOVE.model_copy(update={"motors": (motor, QBMOVE.motors[1])})
    sound, theta = moved(QBMOVE, noise=0.01), 0.25 + 0.02 * np.sin(7.0 * MOTION) + 0.015 * np.sin(17.0 * MOTION)
    built, q = np.zeros(len(theta)), 0.1 * np.sin(5.0 * MOTION)
    for k in range(1, len(theta)):  # Dahl's model
        step = theta[k] - theta[k - 1]
        built[k] = np.sign(step) + (built[k - 1] - np.sign(step)) * np.exp(-abs(step) / travel)
    speed = np.gradient(theta, MOTION)
    torque = motor.inertia * np.gradient(speed, MOTION) + motor.viscous_friction * speed + friction * built
    torque = torque - QBMOVE.springs[0].torque(q - theta)
    samples = sound._replace(
        q=q, theta=np.column_stack([theta, sound.theta[:, 1]]), torque=np.column_stack([torque, sound.torque[:, 1]])
    )
    for begin in np.arange(0.0, MOTION[-1] - 1.0, 0.25):
        each = equations_of(device)[0].share(samples.between(begin, begin + 1.0))
        assert each.unexplained < 0.25
        assert (
            equations_of(device)[0]
            .share(samples._replace(torque=-samples.torque).between(begin, begin + 1.0))
            .impossible
        )


@pytest.mark.parametrize("device", [QBMOVE, CUBIC], ids=lambda each: each.name)
def test_a_motion_that_has_only_begun_is_no_fault(device):
    """Both motors leave a rest at one second against each other, so that the link repeats one number."""
    start, size, w = 1.0, 0.1, 40.0
    time = np.arange(800) * PERIOD
    middle = time - 0.5 * PERIOD

    def since(t):
        return np.maximum(t - start, 0.0)

    theta, torque = [], []
    for sign, motor, spring in zip((1.0, -1.0), device.motors, device.springs, strict=True):
        base, ago, later = 0.3 * spring.max_deflection, since(time), since(middle)
        angle = sign * (base + size * (1.0 - (1.0 + w * ago) * np.exp(-w * ago)))
        then = sign * (base + size * (1.0 - (1.0 + w * later) * np.exp(-w * later)))
        rate = sign * size * w**2 * later * np.exp(-w * later)
        bend = sign * size * w**2 * (1.0 - w * later) * np.exp(-w * later) * (later > 0.0)
        theta.append(np.round(angle / 1e-4) * 1e-4)
        torque.append(motor.inertia * bend + motor.viscous_friction * rate - spring.torque(-then))
    samples = Samples(time, np.zeros(len(time)), np.column_stack(theta), np.column_stack(torque))
    for end in start + np.arange(0.01, 0.5, 0.01):
        interval = samples.between(end - 1.0, end)
        assert not any(each.share(interval).impossible for each in equations_of(device)), f"{end:.2f} s"


@pytest.mark.parametrize(("rotor", "spring", "size"), [(60.0, 0.0, 1.0), (0.0, 40.0, 0.1)], ids=["rotor", "spring"])
def test_what_acts_beside_a_link_is_no_wrong_unit(rotor, spring, size):
    """An angle divided by 57 leaves all torque to friction, which takes up any torque where it counts as at rest."""
    link = PENDULUM.link.model_copy(update={"gravity_torque": 0.0, "coulomb_friction": 1.0})
    t, rng = MOTION - 0.5 * PERIOD, np.random.default_rng(3)
    angle = size * (0.9 * np.sin(3.0 * t) + 0.5 * np.sin(7.0 * t))
    speed = size * (2.7 * np.cos(3.0 * t) + 3.5 * np.cos(7.0 * t))
    bend = -size * (8.1 * np.sin(3.0 * t) + 24.5 * np.sin(7.0 * t))
    tau = (1.0 + rotor) * link.inertia * bend + spring * angle + link.viscous_friction * speed + np.sign(speed)
    tau += 0.01 * rng.normal(size=len(t))
    samples = Samples(MOTION, angle, np.empty((len(t), 0)), tau[:, None])
    assert faulty_time(PENDULUM.model_copy(update={"link": link}), samples) is None


def test_a_message_has_no_columns():
    """What is named of live samples are the channels, also where the device file assigns columns of recordings."""
    wire = CUBIC.wire.model_copy(update={"columns": {"tau_1": WireColumn(column="m1")}})
    samples = moved(CUBIC).between(0.9, 1.9)
    reversed_torque = samples._replace(torque=samples.torque * np.array([-1.0, 1.0]))
    for device, words in ((CUBIC, "wrong sign of tau_1;"), (CUBIC.model_copy(update={"wire": wire}), "of tau_1;")):
        fault = fault_of(device, reversed_torque)
        assert fault is not None and words in fault.text
