"""Names of the faults behind signals that their device cannot produce (via_core.plausibility).

A fault is named by the change of one channel, or of all channels of a kind, after which every torque equation of the
device holds: its sign, its unit, or an exchange with another one. A channel that repeats one number is named first.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from via_core.devices import Device
from via_core.modulated_rows import LEAST_SAMPLES, Equation, Samples, Share
from via_core.plausibility import LinkEquation, equations_of, interval_of, recorded_equations, worst
from via_core.signals import Array

UNITS = {"N mm": 1e-3, "N cm": 1e-2}  # torque units met in logs -> N m
ANGLES = {"degrees": np.pi / 180.0, "turns": 2.0 * np.pi}  # -> rad
FEW = 0.9  # [-] of the intervals of a sound recording are plausible
HALF = 0.5  # [-] of what is unexplained: a proven fault leaves less


class Fault(NamedTuple):
    """A suspected fault: the channels, one sentence with the remedy, and whether changed signals prove it.

    Equations that hold after one change of sign, unit or order prove a fault; a channel that repeats one number does
    not, since dry friction may hold a motor.
    """

    subject: str
    text: str
    proven: bool = False


def fault_of(device: Device, samples: Samples, suspected: bool = False) -> Fault | None:
    """The fault that makes the interval of the samples impossible; None where the samples are plausible.

    suspected  earlier samples were impossible: a channel that still repeats one number is named also where this
               interval alone would not show it
    """
    equations = equations_of(device)
    shares = [each.share(samples) for each in equations]
    impossible = any(each.impossible for each in shares)
    if not impossible and not suspected:
        return None
    frozen = _frozen(device, samples)
    if frozen is not None:
        return frozen
    if not impossible:
        return None
    found = []
    live = device.model_copy(update={"wire": device.wire.model_copy(update={"columns": {}})})  # messages have none
    for fault, change in _changes(live, samples):
        after = [each.share(change) for each in equations]
        if all(each.known and not each.impossible for each in after):
            found.append((worst(after).unexplained, fault._replace(proven=True)))
    if found:
        return min(found, key=lambda each: each[0])[1]
    return _unnamed(device, samples, [each.impossible for each in shares])


def _unnamed(device: Device, samples: Samples, impossible: list[bool]) -> Fault:
    """The fault that no single change explains; impossible: for each equation of the device."""
    if samples.command is not None:
        text = (
            "the link does not follow its servo through the spring: "
            "check commands, units, contacts and the numbers of the device file"
        )
        return Fault("q, equilibrium", text)
    subject = ", ".join(f"tau_{i + 1}" for i, each in enumerate(impossible) if each)
    text = (
        "the torques fit no motor and spring near those of the device file: "
        "check torque constants, units and the numbers of the device file"
    )
    return Fault(subject if device.n_motors else [name for name, _ in _channels(device, samples)][-1], text)


class FaultyTime(NamedTuple):
    """A fault over a whole recording: share of the intervals with motion that are impossible, first and last time."""

    fault: Fault
    share: float
    begin: float  # [s]
    end: float  # [s]


def faulty_time(device: Device, samples: Samples) -> FaultyTime | None:
    """The most frequent fault of a recording; None where at least FEW of the intervals with motion are plausible.

    Signs, units and the order of channels do not change during a recording. So a change that proves a fault has to
    explain the whole of it (`_undone`); otherwise it imitates what happened in some intervals, and the fault has no
    name. A link alone may be held, hit, loaded or not driven: only a proven fault counts.
    """
    equations = recorded_equations(device)
    if not equations or len(samples.time) < LEAST_SAMPLES:
        return None
    intervals = _intervals(samples, interval_of(equations))
    shares = [[each.share(interval) for each in equations] for _, _, interval in intervals]
    found = [worst(each) for each in shares]
    known = sum(each.known for each in found)
    faulty = [interval for interval, each in zip(intervals, found, strict=True) if each.impossible]
    if len(faulty) <= (1.0 - FEW) * known:
        return None
    of_link = any(isinstance(each, LinkEquation) for each in equations)
    fault = Counter(_frozen(device, interval) for _, _, interval in faulty).most_common(1)[0][0]
    if fault is None:
        fault = _undone(device, samples, equations, found)
    if of_link and not (fault and fault.proven):
        return None
    if fault is None:
        often = [sum(each.impossible for each in column) > (1.0 - FEW) * known for column in zip(*shares, strict=True)]
        fault = _unnamed(device, samples, often if any(often) else [True] * len(often))
    return FaultyTime(fault, len(faulty) / known, faulty[0][0], faulty[-1][1])


def _undone(device: Device, samples: Samples, equations: Sequence[Equation], before: Sequence[Share]) -> Fault | None:
    """The fault without which the recording is sound and least of it unexplained, if that is at most HALF as much.

    before  shares of the recording as it is, per interval. An interval that is unknown after a change, as torques
            below their noise are, counts as before. What a load explains without a change proves no fault.
    """
    relaxed = [each.relaxed() for each in equations]
    as_recorded = _intervals(samples, interval_of(equations))
    loaded = [worst([each.share(interval) for each in relaxed]) for _, _, interval in as_recorded]
    whole, best, proven = min(_pooled(before), _pooled(loaded)), HALF, None
    furthest = float(np.nanmax(np.abs(samples.q))) or 1.0
    for fault, change in _changes(device, samples):
        intervals, unit = _intervals(change, interval_of(equations)), float(np.nanmax(np.abs(change.q)) / furthest)
        changed = [each.with_unit(unit) for each in equations]  # else a motion of a few steps would count as rest
        after = [worst([each.share(interval) for each in changed]) for _, _, interval in intervals]
        left = _pooled([new if new.known else old for old, new in zip(before, after, strict=True)])
        sound = sum(each.impossible for each in after) <= (1.0 - FEW) * sum(each.known for each in after)
        if sound and left < best * whole:
            best, proven = left / whole, fault._replace(proven=True)
    return proven


def _pooled(shares: Sequence[Share]) -> float:
    """Root mean square of what the known intervals leave unexplained; infinite if none is known."""
    known = [each.unexplained**2 for each in shares if each.known]
    return float(np.sqrt(np.mean(known))) if known else np.inf


def _intervals(samples: Samples, length: float) -> list[tuple[float, float, Samples]]:
    """Begin, end [s] and samples of successive intervals of `length` [s], without those in a gap of the recording."""
    ends = np.arange(samples.time[0] + length, samples.time[-1] + 1e-9, length)
    every = ((float(end) - length, float(end), samples.between(end - length, end)) for end in ends)
    return [each for each in every if len(each[2].time)]


def _channels(device: Device, samples: Samples) -> Iterator[tuple[str, Array]]:
    """Names and values (N,) of the channels; the torque of a rigid joint is named as the device file names it."""
    yield "q", samples.q
    if samples.command is not None:  # the logged angle of a servo is not used, and its preset may rest
        yield "equilibrium", samples.command[:, 0]
        return
    for i, column in enumerate(samples.theta.T):
        yield f"theta_{i + 1}", column
    own = next((name for name in ("external_torque", "tau_1") if name in device.wire.columns), "tau")
    for i, column in enumerate(samples.torque.T):
        yield f"tau_{i + 1}" if device.n_motors else "tau_link" if device.damper else own, column


def _in_words(device: Device, channels: Sequence[str]) -> str:
    """Channels with the columns of a recording that the device file assigns to them."""
    columns = device.wire.columns
    return ", ".join(f"{name} (column '{columns[name].column}')" if name in columns else name for name in channels)


def _frozen(device: Device, samples: Samples) -> Fault | None:
    """The channels that repeat one number throughout; the preset of a serial joint may rest."""
    names = {name: column[0] for name, column in _channels(device, samples) if np.all(column == column[0])}
    if device.arrangement == "serial":
        names.pop("theta_2", None)
    if not names:
        return None
    subject, zero = ", ".join(names), all(value == 0.0 for value in names.values())
    what = "zero throughout" if zero else "one number repeated while torques or angles beside it change"
    remedy = "check sensor, driver and connection, or leave the channel out"
    if all(name.startswith("theta") for name in names):
        remedy += "; if dry friction holds the motor, declare its coulomb_friction"
    return Fault(subject, f"{subject}: {what}; {remedy}")


def _changes(device: Device, samples: Samples) -> Iterator[tuple[Fault, Samples]]:
    """Each fault with the samples as they would be without it."""
    if samples.command is not None:
        yield from _changes_of_servo(device, samples, samples.command)
        return
    q, theta, torque = samples.q, samples.theta, samples.torque
    names = [name for name, _ in _channels(device, samples)]
    angles, tau = names[: 1 + theta.shape[1]], names[1 + theta.shape[1] :]

    def fault(channels: list[str], text: str) -> Fault:
        return Fault(", ".join(channels), text.format(_in_words(device, channels)))

    def turned(values: Array, columns: list[int]) -> Array:
        return values * np.where(np.isin(np.arange(values.shape[1]), columns), -1.0, 1.0)

    wrong = "wrong sign of {}; reverse it in the driver or by `scale: -1` under wire.columns"
    for columns in [[i] for i in range(len(tau))] + ([[0, 1]] if len(tau) == 2 else []):
        subject = [tau[i] for i in columns]
        if not device.n_motors and not device.damper:  # of a rigid link, only its relation to the angle is known
            subject, wrong = [*tau, "q"], "opposite signs of {}; reverse one of them (`scale: -1` under wire.columns)"
        yield fault(subject, wrong), samples._replace(torque=turned(torque, columns))
    if device.n_motors:
        yield fault(["q"], wrong), samples._replace(q=-q)
        for columns in [[i] for i in range(theta.shape[1])] + ([[0, 1]] if theta.shape[1] == 2 else []):
            subject = [f"theta_{i + 1}" for i in columns]
            yield fault(subject, wrong), samples._replace(theta=turned(theta, columns))
    if theta.shape[1] == 2:
        swapped = "{0}_1 and {0}_2 are exchanged; exchange the two names or connectors"
        yield Fault("tau_1, tau_2", swapped.format("tau")), samples._replace(torque=torque[:, ::-1])
        yield Fault("theta_1, theta_2", swapped.format("theta")), samples._replace(theta=theta[:, ::-1])
    for unit, scale in UNITS.items():
        text = f"{{}} in {unit}, not in N m; convert (`scale: {scale:g}` under wire.columns)"
        yield fault(tau, text), samples._replace(torque=scale * torque)
    for unit, scale in ANGLES.items():
        text = f"{{}} in {unit}, not in rad; convert (`scale: {scale:.7g}` under wire.columns)"
        yield fault(angles, text), samples._replace(q=scale * q, theta=scale * theta)


def _changes_of_servo(device: Device, samples: Samples, command: Array) -> Iterator[tuple[Fault, Samples]]:
    """The same for a link angle and the commands of its servo: only their relation is known, not which one is wrong."""
    both, q, goal = "q, equilibrium", _in_words(device, ["q"]), _in_words(device, ["equilibrium"])
    text = f"{q} and {goal} have opposite signs; reverse one of them (`scale: -1` under wire.columns for q)"
    yield Fault(both, text), samples._replace(q=-samples.q)
    for unit, scale in ANGLES.items():
        text = f"{q} in {unit}, not in rad; convert (`scale: {scale:.7g}` under wire.columns)"
        yield Fault("q", text), samples._replace(q=scale * samples.q)
        text = f"{goal} in {unit}, not in rad; convert the command"
        yield Fault("equilibrium", text), samples._replace(command=command * np.array([scale, 1.0]))
