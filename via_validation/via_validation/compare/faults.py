"""Faulty channels and sound variations of simulated joints: what the status of every estimator says of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from via_core.devices import Device
from via_core.faults import fault_of
from via_core.modulated_rows import Samples, Share
from via_core.plausibility import equations_of, interval_of, worst
from via_core.signals import Array, Signals
from via_core.status import Status
from via_estimators.methods import estimator_for, methods_for
from via_sim.effects import Effect
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import InitialConditions, simulate

DEVICES = ("cubic_demo", "qbmove_a", "dlr_bavs", "visco_elastic_demo", "compact_vpda", "maccepavd")
DURATION, ONSET, RATE = 8.0, 2.0, 1000.0  # [s], [s] of a fault that begins during the recording, [Hz]
SERVO_SAMPLES, SERVO_COMMANDS = 200.0, 50.0  # [Hz] of joints driven by servos, as that of the MACCEPA-VD
LATE = 2.0  # [s] after the onset of a fault from which samples count
SIZE = 0.15  # torques, over the spring torque at the stop
Channels = dict[str, Array]


class Fault(NamedTuple):
    """A change of recorded channels, the time from which it acts [s], and words of its name."""

    change: Callable[[Channels], Channels]
    onset: float
    words: str


def torques_of(device: Device, time: Array) -> Channels:
    """Commands of several tones: motor torques, servo angles, or a torque on the link of a joint with a damper."""
    first, second, third, fourth = (
        np.sin(2.0 * np.pi * f * time + a) for f, a in ((0.7, 0.0), (1.9, 0.0), (1.1, 0.0), (2.3, 1.0))
    )
    if not device.n_motors:
        return {"external_torque": 4.0 * first + 2.0 * second, "damping": np.full(len(time), 0.5)}
    if device.drive == "servo":
        held = np.floor(time * SERVO_COMMANDS + 1e-9) / SERVO_COMMANDS
        slow, fast = np.sin(2.0 * np.pi * 0.8 * held), np.sin(2.0 * np.pi * 1.9 * held)
        return {"equilibrium": 0.5 * slow + 0.35 * fast, "preset": np.full(len(time), 0.6)}
    size = np.clip(2.0 * time, 0.0, 1.0) * SIZE * float(device.springs[0].torque(device.springs[0].max_deflection))
    both = [size * (1.0 + 0.6 * first + 0.3 * second), -size * (1.0 + 0.6 * third + 0.3 * fourth)]
    return {"motor": np.column_stack(both[: device.n_motors])}


def moved(device: Device, real: Device | None = None, rate: float | None = None, **sensors: float) -> Signals:
    """Measured signals of the joint `real`, by default `device` itself, with the sensors of the file, some changed."""
    time = np.arange(int(RATE * DURATION) + 1) / RATE
    channels = torques_of(device, time)
    commands = Signals(time, channels, dict.fromkeys(channels, "-"), frozenset(channels))
    rate = rate or (SERVO_SAMPLES if device.drive == "servo" else RATE)
    given = replace(Sensors.of_device(device), velocity_noise=0.005, rate=rate, **sensors)
    plant = JointPlant.from_device(real or device)
    if device.drive == "servo":
        plant = plant.with_effects(servo_effects(real or device))
    measured = simulate(plant, commands, DURATION, RATE, given, InitialConditions(seed=3)).measured
    if device.drive != "servo":
        return measured
    held = {name: channels[name][np.rint(measured.time * RATE).astype(int)] for name in ("equilibrium", "preset")}
    units = {**measured.units, "equilibrium": "rad", "preset": "rad"}
    return Signals(measured.time, {**measured.channels, **held}, units, measured.held | set(held))


def servo_effects(device: Device) -> tuple[Effect, ...]:
    """Dead time and speed limit of the servos as observed, which the nominal joint does not have."""
    observed, found = device.observed, []
    if observed.servo_dead_time > 0.0:
        found.append(Effect("actuator_delay", "command", {"delay": observed.servo_dead_time}))
    if observed.servo_speed_limit is not None:
        found.append(Effect("torque_saturation", "motor", {"limit": observed.servo_speed_limit}, motor=1))
    return tuple(found)


def _column(name: str, change: Callable[[Array], Array]) -> Callable[[Channels], Channels]:
    """`change` of column `name`, such as 'tau_1', or of a whole channel, 'tau'."""
    channel, number = (name[:-2], int(name[-1])) if name[-1].isdigit() else (name, 0)

    def apply(channels: Channels) -> Channels:
        values = channels[channel].copy()
        at: Any = (slice(None), number - 1) if number else ...
        values[at] = change(values[at])
        return {**channels, channel: values}

    return apply


def _freeze(values: Array) -> Array:
    onset = round(ONSET / DURATION * (len(values) - 1))
    return np.concatenate([values[:onset], np.broadcast_to(values[onset], values[onset:].shape)])


def faults_of(device: Device) -> Mapping[str, Fault]:
    """Name -> fault of the device's channels."""
    if device.drive == "servo":
        return _faults_of_servo()
    tau, several = ("tau", device.n_motors == 2) if device.n_motors else ("tau_link", False)
    one = f"{tau}_1" if device.n_motors else tau
    found = {
        "torques reversed": Fault(_column(tau, np.negative), 0.0, f"wrong sign of {one}"),
        "no torque": Fault(_column(tau, np.zeros_like), 0.0, "zero throughout"),
        "torque frozen": Fault(_column(one, _freeze), ONSET, f"{one}: one number repeated"),
        "N mm as N m": Fault(_column(tau, lambda values: 1e3 * values), 0.0, "in N mm"),
        "link encoder frozen": Fault(_column("q", _freeze), ONSET, "q: one number repeated"),
    }
    if device.n_motors:
        found["motor encoder frozen"] = Fault(_column("theta_1", _freeze), ONSET, "theta_1: one number repeated")
        found["link angle reversed"] = Fault(_column("q", np.negative), 0.0, "wrong sign of q")
    if several:
        found["one torque reversed"] = Fault(_column("tau_1", np.negative), 0.0, "wrong sign of tau_1;")
        found["torques exchanged"] = Fault(_column("tau", lambda tau: tau[:, ::-1]), 0.0, "are exchanged")
    return found


def _faults_of_servo() -> Mapping[str, Fault]:
    degrees = 180.0 / np.pi
    return {
        "link angle reversed": Fault(_column("q", np.negative), 0.0, "opposite signs"),
        "link encoder frozen": Fault(_column("q", _freeze), ONSET, "q: one number repeated"),
        "link angle zero": Fault(_column("q", np.zeros_like), 0.0, "q: zero throughout"),
        "link angle in degrees": Fault(_column("q", lambda q: degrees * q), 0.0, "q in degrees"),
        "command frozen": Fault(_column("equilibrium", _freeze), ONSET, "equilibrium: one number repeated"),
        "command zero": Fault(_column("equilibrium", np.zeros_like), 0.0, "equilibrium: zero throughout"),
        "command reversed": Fault(_column("equilibrium", np.negative), 0.0, "opposite signs"),
        "command in degrees": Fault(_column("equilibrium", lambda u: degrees * u), 0.0, "equilibrium in degrees"),
    }


def with_fault(measured: Signals, fault: Fault) -> Signals:
    """The recording as it would be with the fault."""
    return Signals(measured.time, fault.change(dict(measured.channels)), measured.units, measured.held)


def _thinned(device: Device, share: float) -> Signals:
    full = moved(device)
    kept = np.random.default_rng(1).random(len(full)) > share
    return Signals(full.time[kept], {n: v[kept] for n, v in full.channels.items()}, full.units, full.held)


def _with_link(device: Device, **changed: float) -> Device:
    return device.model_copy(update={"link": device.link.model_copy(update=changed)})


def _with_motors(device: Device, change: Callable[[Any], dict[str, float]]) -> Device:
    """The device with what `change` makes of each motor's numbers."""
    motors = tuple(motor.model_copy(update=change(motor)) for motor in device.motors)
    return device.model_copy(update={"motors": motors})


def _variations_of_servo(device: Device) -> Mapping[str, Callable[[], Signals]]:
    observed, typical = (
        device.observed,
        device.springs[0].torque(np.linspace(0.0, device.springs[0].max_deflection)),
    )

    def servos(bandwidth: float, **seen: float | None) -> Device:
        changed = _with_motors(device, lambda motor: {"bandwidth": bandwidth * motor.bandwidth})
        return changed.model_copy(update={"observed": observed.model_copy(update=seen)})

    slow = 0.46 * observed.servo_speed_limit if observed.servo_speed_limit is not None else None
    return {
        "as filed": lambda: moved(device),
        "link inertia x 2": lambda: moved(device, _with_link(device, inertia=2.0 * device.link.inertia)),
        "bandwidth x .6": lambda: moved(device, servos(0.6)),
        "speed limit x .46": lambda: moved(device, servos(1.0, servo_speed_limit=slow)),
        "no dead time, no speed limit": lambda: moved(device, servos(1.0, servo_dead_time=0.0, servo_speed_limit=None)),
        "dry friction 20 % of the torque": lambda: moved(
            device, _with_link(device, coulomb_friction=0.2 * float(np.mean(np.abs(typical))))
        ),
        "100 Hz": lambda: moved(device, rate=100.0),
        "10 % of the samples lost": lambda: _thinned(device, 0.1),
        "half of the samples lost": lambda: _thinned(device, 0.5),
    }


def variations_of(device: Device) -> Mapping[str, Callable[[], Signals]]:
    """Name -> recording of a sound joint that differs from its device file."""
    if device.drive == "servo":
        return _variations_of_servo(device)

    def motors(change: Callable[[Any], dict[str, float]]) -> Signals:
        return moved(device, _with_motors(device, change))

    def rough(torque: float) -> Signals:
        return motors(lambda _: {"coulomb_friction": torque})

    def torque(change: Callable[[Array], Array]) -> Signals:
        full = moved(device)
        return Signals(full.time, {**full.channels, "tau": change(full["tau"])}, full.units, full.held)

    def late(tau: Array) -> Array:
        return np.concatenate([np.repeat(tau[:1], 5, axis=0), tau[:-5]])

    typical = SIZE * float(device.springs[0].torque(device.springs[0].max_deflection)) if device.springs else 0.0
    return {
        "as filed": lambda: moved(device),
        "link inertia x 3": lambda: moved(device, _with_link(device, inertia=3.0 * device.link.inertia)),
        "motor inertia x 2": lambda: motors(lambda motor: {"inertia": 2.0 * motor.inertia}),
        "motor damping x 3": lambda: motors(lambda motor: {"viscous_friction": 3.0 * motor.viscous_friction}),
        "dry friction 10 % of the torque": lambda: rough(0.1 * typical),
        "dry friction 30 % of the torque": lambda: rough(0.3 * typical),
        "200 Hz": lambda: moved(device, rate=200.0),
        "torque noise 10 %": lambda: moved(device, torque_noise=0.1 * typical),
        "10 % of the samples lost": lambda: _thinned(device, 0.1),
        "half of the samples lost": lambda: _thinned(device, 0.5),
        "torque constant + 30 %": lambda: torque(lambda tau: 1.3 * tau),
        "torque 5 ms late": lambda: torque(late),
    }


@dataclass(frozen=True)
class FaultResult:
    """A fault on a device: share of OK samples by method, share of impossible intervals and of those with its name."""

    device: str
    fault: str
    ok: Mapping[str, float]
    impossible: float
    named: float
    unexplained: Array  # (n,) of the intervals after the onset
    limit: float  # of `unexplained`


@dataclass(frozen=True)
class SoundResult:
    """A sound variation: share of IMPLAUSIBLE samples of the default method, unexplained shares of the intervals."""

    device: str
    variation: str
    implausible: float
    unexplained: Array
    impossible: int  # intervals
    limit: float


def _shares(device: Device, measured: Signals, begin: float = 0.0) -> list[tuple[Samples, Share]]:
    """The intervals of a recording from `begin` [s] on, and what the most violated equation leaves unexplained."""
    samples, equations = Samples.of_signals(measured, device, measured), equations_of(device)
    assert samples is not None
    length = interval_of(equations)
    parts = [samples.between(end - length, end) for end in np.arange(begin + length, DURATION, length)]
    return [(part, worst([each.share(part) for each in equations])) for part in parts]


def fault_result(device: Device, name: str, measured: Signals) -> FaultResult:
    """The answers of every method of the device to one fault."""
    fault = faults_of(device)[name]
    faulty, ok = with_fault(measured, fault), {}
    for method in methods_for(device):
        estimates = estimator_for(device, method).run(faulty)
        late = faulty.time > fault.onset + LATE
        ok[method] = float(np.mean(estimates.status[late] == Status.OK))
    parts = _shares(device, faulty, fault.onset)
    shares = [share for _, share in parts]
    names = [fault_of(device, part) for part, share in parts if share.impossible]
    right = [each is not None and fault.words in each.text for each in names]
    return FaultResult(
        device.name,
        name,
        ok,
        float(np.mean([each.impossible for each in shares])),
        float(np.mean(right)) if right else 0.0,
        np.array([each.unexplained for each in shares]),
        shares[0].limit,
    )


def sound_result(device: Device, name: str) -> SoundResult:
    """The answers of the device's default method to one sound variation."""
    measured = variations_of(device)[name]()
    estimates = estimator_for(device).run(measured)
    shares = [share for _, share in _shares(device, measured)]
    return SoundResult(
        device.name,
        name,
        float(np.mean(estimates.status == Status.IMPLAUSIBLE)),
        np.array([each.unexplained for each in shares]),
        sum(each.impossible for each in shares),
        shares[0].limit,
    )
