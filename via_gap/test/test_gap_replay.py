"""The measured gap: zero against the model itself, as large as planted, and honest about logs that cannot be used."""

import numpy as np
import pytest
from via_core.devices import load_device
from via_core.errors import SignalError
from via_core.signals import Signals
from via_gap.logs.replay import gap_to, pooled, simulated_log
from via_sim.effects import Effect
from via_sim.plants import JointPlant
from via_sim.simulate import InitialConditions, simulate

HELD = frozenset({"equilibrium", "preset", "damping"})
UNITS = {"equilibrium": "rad", "preset": "rad", "damping": "-", "q": "rad", "theta": "rad"}
FRICTION = Effect("coulomb_friction", "link", parameters={"torque": 0.02})


def measure_gap(device, measured, commands, effects=()):
    return gap_to(simulated_log(device, measured, commands, effects), measured)


def commands(start: float = 0.0) -> Signals:
    time = start + 0.02 * np.arange(75)
    swing = np.where(np.arange(75) < 30, 0.6, -0.4)
    steady = np.ones(75)
    return Signals(time, {"equilibrium": swing, "preset": 0.5 * steady, "damping": 0.3 * steady}, UNITS, HELD)


def log_of(effects=(), start: float = 0.0, early: float = 0.0, read: bool = False) -> Signals:
    """What was, or is `read`, at 250 Hz of the MACCEPA-VD model from `early` [s] before the first command, at rest."""
    device = load_device("maccepavd")
    run = simulate(
        JointPlant.from_device(device).with_effects(effects),
        commands(start),
        1.48,
        1000.0,
        initial=InitialConditions([0.1, 0.1, 0.5, 0.0, 0.0, 0.0], time=start - early),
    )
    truth = run.measured if read else run.truth
    theta = truth["theta"].copy()
    theta[:, 1] = np.nan  # the preset motor is not measured: its first command says where it starts
    return Signals(truth.time[::4], {"q": truth["q"][::4], "theta": theta[::4]}, UNITS)


@pytest.mark.parametrize(("start", "early"), [(0.0, 0.0), (12.0, 0.0), (3.0, 0.004)])
def test_no_gap_against_the_model_itself(start, early):
    gap = measure_gap(load_device("maccepavd"), log_of(start=start, early=early), commands(start))
    # the start is read off moving samples: 36 ms of servo motion at the most
    assert gap.nrmse < 0.02
    assert np.array_equal(gap.time, log_of(start=start, early=early).time)


def test_a_withheld_effect_shows_and_goes_when_it_is_added():
    device, real = load_device("maccepavd"), log_of(effects=[FRICTION])
    before = measure_gap(device, real, commands()).nrmse
    after = measure_gap(device, real, commands(), effects=[FRICTION]).nrmse
    assert before > 0.1
    assert after < 0.02


@pytest.mark.parametrize(
    "error",
    [
        Effect("encoder_offset", "sensor", {"offset": 0.1}),
        Effect("encoder_eccentricity", "sensor", {"amplitude": 0.2, "phase": 0.3}),
        Effect("channel_skew", "timing", {"delay": 0.05}),
    ],
    ids=lambda effect: effect.name,
)
def test_what_an_encoder_reads_is_compared_not_what_was(error):
    device, real = load_device("maccepavd"), log_of(effects=[error], read=True)
    assert measure_gap(device, real, commands()).nrmse > 0.05
    assert measure_gap(device, real, commands(), effects=[error]).nrmse < 0.02


def test_nrmse_is_that_of_a_planted_offset():
    device, real = load_device("maccepavd"), log_of()
    simulated = np.interp(real.time, *(lambda t: (t.time, t["q"]))(simulated_log(device, real, commands())))
    moved = Signals(real.time, {"q": simulated + 0.05, "theta": real["theta"]}, UNITS)
    gap = measure_gap(device, moved, commands())
    error = gap.measured - gap.simulated
    assert gap.nrmse == pytest.approx(np.sqrt(np.mean(error**2)) / np.std(moved["q"]))


def test_missing_angles_are_left_out_not_filled():
    device, real = load_device("maccepavd"), log_of()
    q = real["q"].copy()
    q[100:120] = np.nan
    gap = measure_gap(device, Signals(real.time, {"q": q, "theta": real["theta"]}, UNITS), commands())
    assert len(gap.time) == len(real) - 20
    assert np.isfinite(gap.nrmse)


def test_commands_of_a_log_that_began_between_ticks_still_change_on_ticks():
    real = log_of(start=3.0, early=0.02)
    moved = Signals(real.time[4:] + 0.4e-3, {"q": real["q"][4:], "theta": real["theta"][4:]}, UNITS)
    assert moved.time[0] == pytest.approx(2.9964)  # 3.6 ms before the first command
    time = simulated_log(load_device("maccepavd"), moved, commands(3.0)).time
    assert np.min(np.abs(time - 3.0)) < 1e-9
    assert time[0] <= moved.time[0] and time[-1] >= moved.time[-1]


def test_one_spike_at_the_start_is_outvoted():
    device, real = load_device("maccepavd"), log_of()
    q, theta = real["q"].copy(), real["theta"].copy()
    q[0] += 0.5
    theta[0, 0] -= 0.5
    spiked = simulated_log(device, Signals(real.time, {"q": q, "theta": theta}, UNITS), commands())
    assert spiked["q"][0] == pytest.approx(0.1, abs=0.02)
    assert spiked["theta"][0, 0] == pytest.approx(0.1, abs=0.1)


def test_pooling_weighs_by_motion():
    device = load_device("maccepavd")
    gaps = [measure_gap(device, log_of(effects=e), commands()) for e in ([], [FRICTION])]
    low, high = sorted(gap.nrmse for gap in gaps)
    assert low < pooled(gaps) < high
    assert pooled(gaps[:1]) == pytest.approx(gaps[0].nrmse)


def test_logs_that_cannot_be_used():
    device, real = load_device("maccepavd"), log_of()
    none = Signals([], {"q": [], "theta": np.empty((0, 2))}, UNITS)
    bare = Signals(real.time, {"q": np.full(len(real), np.nan), "theta": real["theta"]}, UNITS)
    with pytest.raises(SignalError, match="no samples"):
        measure_gap(device, none, commands())
    with pytest.raises(SignalError, match="no commands"):
        measure_gap(device, real, commands().between(99.0, 100.0))
    with pytest.raises(SignalError, match="link angle"):
        measure_gap(device, bare, commands())
    with pytest.raises(SignalError, match="no log"):
        pooled([])
