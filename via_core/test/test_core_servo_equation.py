"""The link equation with a servo model: links that follow their commands, and links that cannot."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from via_core.devices import load_device
from via_core.faults import fault_of, faulty_time
from via_core.modulated_rows import Samples
from via_core.plausibility import equations_of, interval_of
from via_core.servo_equation import IMPOSSIBLE, _follow

DEVICE = load_device("maccepavd")
(EQUATION,) = equations_of(DEVICE)
FILE = np.array([25.0, 6.5, 0.045])  # bandwidth, speed limit, dead time
TIME = np.arange(0.0, 4.1, 5e-3)


def moved(inertia=1.0, servo=(1.0, 1.0, 1.0), gain=1.0, friction=0.0, hold=None):
    """Samples of the link under two tones; factors of the numbers of the file, friction in N m."""
    fine = np.arange(0.0, 4.1, 1e-3)
    command = 0.5 * np.sin(5.0 * fine) + 0.35 * np.sin(12.0 * fine)
    theta = _follow(fine, command, FILE * servo)
    spring, link = DEVICE.springs[0], DEVICE.link

    def rates(time, x):
        load = gain * float(spring.torque(x[0] - np.interp(time, fine, theta), 0.6))
        drag = 0.012 * x[1] + friction * np.tanh(x[1] / 0.02)
        return [x[1], -(load + drag) / (inertia * link.inertia)]

    q = solve_ivp(rates, (0.0, 4.1), [0.0, 0.0], "RK45", TIME, rtol=1e-6, max_step=5e-3).y[0]
    step = DEVICE.sensors.link_quantum
    commands = np.column_stack([np.interp(TIME, fine, command), np.full(len(TIME), 0.6)])
    return Samples(TIME, step * np.round(q / step), np.full((len(TIME), 2), np.nan), np.empty((len(TIME), 0)), commands)


def share(samples, end=3.9):
    return EQUATION.share(samples.between(end - EQUATION.interval, end))


@pytest.fixture(scope="module")
def sound():
    return moved()


@pytest.mark.parametrize(
    "changes",
    [{}, {"inertia": 2.0}, {"servo": (0.6, 1.0, 1.0)}, {"servo": (1.0, 0.46, 1.0)}, {"gain": 0.7}, {"friction": 0.03}],
    ids=str,
)
def test_a_link_near_its_file_is_possible(changes):
    found = share(moved(**changes))
    assert found.known and found.unexplained < 0.75 * IMPOSSIBLE


def of_command(samples, change):
    return samples._replace(command=np.column_stack([change(samples.command[:, 0]), samples.command[:, 1]]))


FAULTS = {
    "q reversed": (lambda s: s._replace(q=-s.q), "opposite signs", True),
    "q frozen": (lambda s: s._replace(q=0.0 * s.q + s.q[100]), "q: one number repeated", False),
    "q zero": (lambda s: s._replace(q=0.0 * s.q), "q: zero throughout", False),
    "q in degrees": (lambda s: s._replace(q=np.degrees(s.q)), "q in degrees", True),
    "command reversed": (lambda s: of_command(s, np.negative), "opposite signs", True),
    "command frozen": (lambda s: of_command(s, lambda u: 0.0 * u + u[100]), "equilibrium: one number repeated", False),
    "command zero": (lambda s: of_command(s, np.zeros_like), "equilibrium: zero throughout", False),
    "command in degrees": (lambda s: of_command(s, np.degrees), "equilibrium in degrees", True),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_found_and_named(name, sound):
    change, words, proven = FAULTS[name]
    assert fault_of(DEVICE, sound.between(1.9, 3.9)) is None and faulty_time(DEVICE, sound) is None
    fault = fault_of(DEVICE, change(sound).between(1.9, 3.9))
    assert fault is not None and words in fault.text and fault.proven == proven
    whole = faulty_time(DEVICE, change(sound))
    assert whole is not None and whole.fault.text == fault.text


def test_a_unit_that_is_wrong_for_a_short_time_is_no_proven_unit(sound):
    late = sound.time > 2.0
    whole = faulty_time(DEVICE, sound._replace(q=np.where(late, np.degrees(sound.q), sound.q)))
    assert whole is not None and whole.share < 1.0
    assert not whole.fault.proven and "does not follow its servo" in whole.fault.text


def test_a_link_that_does_not_belong_to_its_commands_has_no_name(sound):
    rng = np.random.default_rng(4)
    other = np.convolve(rng.normal(size=len(TIME)), np.ones(40) / 10.0, "same")
    fault = fault_of(DEVICE, of_command(sound, lambda _: other).between(1.9, 3.9))
    assert fault is not None and "does not follow its servo" in fault.text and not fault.proven


def test_rest_short_intervals_and_missing_commands_are_unknown_or_possible(sound):
    rest = sound._replace(q=0.0 * sound.q, command=0.0 * sound.command)
    assert not share(rest).known and not share(rest).impossible
    assert not EQUATION.share(sound.between(0.0, 0.3)).known
    unknown = of_command(sound, lambda u: np.nan * u)
    assert not share(unknown).known and faulty_time(DEVICE, unknown) is None


def test_a_link_held_by_dry_friction_below_its_bound_is_possible(sound):
    held = sound._replace(q=0.0 * sound.q, command=sound.command * [0.15, 1.0])
    assert not share(held).impossible


def test_gravity_is_part_of_the_load():
    """The shoulder of the two-link arm hangs; its equation exists, one without a servo has the interval of a second."""
    (hanging,) = equations_of(load_device("maccepa_2link_shoulder"))
    assert hanging.interval == interval_of((hanging,)) == EQUATION.interval
    assert interval_of(equations_of(load_device("cubic_demo"))) == 1.0
