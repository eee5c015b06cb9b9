"""Sensor errors are found in the measurements: planted values are recovered, and none is found without an error."""

from dataclasses import replace

import numpy as np
import pytest
from gap_logs import flexible, log_of
from via_core.signals import Signals
from via_gap.diagnosis import diagnose
from via_gap.logs.log import JointLog
from via_gap.sensors.sensor_errors import sensor_errors
from via_sim.effects import Effect


def without(log: JointLog, *names: str) -> JointLog:
    kept = {name: values for name, values in log.measured.channels.items() if name not in names}
    return replace(log, measured=Signals(log.measured.time, kept, {name: log.measured.units[name] for name in kept}))


@pytest.mark.parametrize(
    "effect",
    [
        Effect("encoder_quantisation", "sensor", {"quantum": 4.1e-4}),
        Effect("encoder_quantisation", "sensor", {"quantum": 2.3e-3}, 1),
        Effect("torque_gain", "sensor", {"gain": 0.8}, 1),
        Effect("torque_bias", "sensor", {"torque": -0.004}, 1),
    ],
    ids=lambda effect: f"{effect.name}-{effect.motor}",
)
def test_a_planted_misreading_is_found_with_its_value(effect: Effect) -> None:
    (found,) = sensor_errors([log_of(flexible(), (effect,), seed=31, duration=6.0)])
    assert (found.effect.name, found.effect.site, found.effect.motor) == (effect.name, "sensor", effect.motor)
    for name, value in effect.parameters.items():
        assert found.effect.parameters[name] == pytest.approx(value, rel=0.02)
    assert found.left < 0.5


def test_sound_sensors_and_a_weak_motor_read_right() -> None:
    assert sensor_errors([log_of(flexible(), (), seed=32, duration=6.0)]) == ()
    weak = Effect("torque_gain", "motor", {"gain": 0.8}, 1)
    assert sensor_errors([log_of(flexible(), (weak,), seed=32, duration=6.0)]) == ()


def test_what_was_not_recorded_shows_nothing() -> None:
    log = log_of(flexible(), (Effect("torque_gain", "sensor", {"gain": 0.8}, 1),), seed=31, duration=6.0)
    assert len(sensor_errors([log])) == 1
    assert sensor_errors([without(log, "tau")]) == ()
    assert sensor_errors([replace(log, commands=None)]) == ()


def test_it_stands_beside_what_was_named_and_alone_where_there_was_no_gap() -> None:
    wrong = Effect("torque_bias", "sensor", {"torque": 0.1}, 1)
    log = log_of(flexible(), (wrong,), seed=31, duration=10.0)
    alone = diagnose([log], log.device)
    assert (alone.verdict, alone.causes[0].effect, alone.where[0].site) == ("effect", "torque_bias", "sensor")
    assert alone.repair()[0].parameters["torque"] == pytest.approx(0.1, rel=0.02)


def test_a_torque_that_does_not_follow_its_command_tells_of_no_sensor() -> None:
    log = log_of(flexible(), (), seed=32, duration=6.0)
    tau = np.roll(log.measured["tau"], 700, axis=0)
    channels = {**log.measured.channels, "tau": tau}
    moved = replace(log, measured=Signals(log.measured.time, channels, log.measured.units))
    assert sensor_errors([moved]) == ()


@pytest.mark.parametrize("gain", [1.0, 0.8])
def test_commands_that_jitter_between_samples_are_no_error_of_the_torque_sensor(gain: float):
    """The regression on a command with noise has too small a gain: .9 here for a sound sensor."""
    log = log_of(flexible(), (), seed=32, duration=6.0)
    sent, tau = log.commands["motor"], log.measured["tau"]
    noise = np.random.default_rng(3).normal(0.0, 0.33 * sent.std(), sent.shape)
    channels = {**log.commands.channels, "motor": sent + noise}
    jittery = Signals(log.commands.time, channels, log.commands.units, log.commands.held)
    measured = Signals(log.measured.time, {**log.measured.channels, "tau": gain * tau}, log.measured.units)
    found = sensor_errors([replace(log, commands=jittery, measured=measured)])
    if gain == 1.0:
        assert found == ()
    else:
        (error,) = found
        assert abs(error.effect.parameters["gain"] - gain) < 2.0 * error.sd["gain"] < 0.15
