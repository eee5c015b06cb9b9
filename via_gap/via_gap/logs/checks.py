"""Data checks before anything is fitted. A finding refuses the log, downgrades it, or is a note.

Of the model, only names, rates and steps of the device's sensors and the torque equations of its motors are used.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from via_core.device_parts import TorqueMotor
from via_core.encoder_steps import step_of
from via_core.faults import faulty_time
from via_core.modulated_rows import Samples

from via_gap.logs.breaks import LEFT
from via_gap.logs.findings import Finding, worst_first
from via_gap.logs.log import ERRATIC, JointLog, jumps

SHORTEST = 0.5  # [s] two segments; short recordings are fitted together
SLOWEST = 50.0  # [Hz]
COARSE = 1.5  # times the filed step: a coarser encoder
AROUND = 5  # samples to either side of a pass, for its speed
GAINED = 0.1  # of the largest speed: more than its noise
OFTEN = 0.25  # of the passes: a joint that a hand lifts between free swings is faster less often


def check_log(log: JointLog) -> list[Finding]:
    """All findings on a log, worst first."""
    checks = (_stamps, _channels, _steps, _torques, _undriven, _alignment, _faults)
    return worst_first(finding for check in checks for finding in check(log))


def _stamps(log: JointLog) -> Iterator[Finding]:
    steps = np.diff(log.measured.time)
    period = float(np.median(steps))
    rate, filed = 1.0 / period, log.device.sensors.rate
    if log.duration < SHORTEST:
        text = f"only {log.duration:.2g} s long: record for longer"
        yield log.finding("duration", "time", "refuse", log.duration, text)
    if rate < SLOWEST:
        text = f"{rate:.3g} Hz are too slow for the motion of a joint: record at {SLOWEST:g} Hz or more"
        yield log.finding("rate", "time", "refuse", rate, text)
    elif abs(rate / filed - 1.0) > 0.1:
        yield log.finding("rate", "time", "note", rate, f"sampled at {rate:.4g} Hz, not {filed:.4g} Hz as filed")
    for count, what in zip(log.dropped, ("repeat another", "are out of order"), strict=True):
        if count:
            text = f"{count} samples whose stamps {what} were dropped"
            yield log.finding("duplicates", "time", "note", count, text)
    for begin, length in log.breaks:
        text = f"no sample for {length:.4g} s from {begin:.4g} s on: later times are counted as if it were {LEFT:g} s"
        yield log.finding("break", "time", "note", length, text)
    for channel, count in log.passed.items():
        text = f"the angle starts again after a turn, {count} times; read as continuous"
        yield log.finding("turn", channel, "note", count, text)


def _channels(log: JointLog) -> Iterator[Finding]:
    if not log.drivable:
        text = "neither commands nor motor torques were recorded, so that nothing can be simulated: record the commands"
        text += log.hint
        yield log.finding("drive", "commands", "refuse", 0.0, text)
    for name, values, _ in log.angles:
        seen = np.isfinite(values)
        share = float(np.mean(seen))
        if share < 0.9 and name == "q":
            text = f"the link angle is missing in {100 * (1 - share):.0f} % of the samples: check its encoder"
            yield log.finding("missing", name, "refuse" if share < 0.5 else "downgrade", 1.0 - share, text)
        there = values[seen]
        if there.size < 2:
            continue
        if np.ptp(there) == 0.0:
            text = f"{name} never changes: check that the joint moves and that this angle is recorded"
            yield log.finding("stale", name, "refuse" if name == "q" else "downgrade", 0.0, text)
            continue
        share = jumps(there)
        if share > 0.0:
            used = "this encoder is not used" if share > ERRATIC and name != "q" else "used as it is"
            text = f"{round(share * there.size)} single samples of {name} jump away and back: {used}"
            yield log.finding("outliers", name, "downgrade", share * there.size, text)


def _steps(log: JointLog) -> Iterator[Finding]:
    for name, values, filed in log.angles:
        step = step_of(values)
        if step > 0.0 and filed is not None and step > COARSE * filed:
            text = f"{name} has encoder steps of {step:.4g} rad, not {filed:.4g} rad as filed"
            yield log.finding("quantisation", name, "note", step, text)


def _torques(log: JointLog) -> Iterator[Finding]:
    device = log.device
    if device.drive != "torque" or not device.n_motors or "tau" not in log.measured:
        return
    for i, motor in enumerate(device.motors):
        tau = log.measured["tau"][:, i]
        seen = np.isfinite(tau)
        if seen.sum() < 20:
            continue
        if np.ptp(tau[seen]) == 0.0:
            yield log.finding("stale", f"tau_{i + 1}", "downgrade", 0.0, f"tau_{i + 1} never changes")
            continue
        limit = motor.torque_limit if isinstance(motor, TorqueMotor) else None
        top = float(np.max(np.abs(tau[seen])))
        clipped = float(np.mean(np.abs(tau[seen]) > 0.999 * top))
        if clipped > 0.02 or (limit is not None and float(np.mean(np.abs(tau[seen]) >= 0.999 * limit)) > 0.02):
            text = f"the torque of motor {i + 1} is at its largest value in {100 * clipped:.0f} % of the samples"
            yield log.finding("saturation", f"tau_{i + 1}", "note", clipped, text)


def _undriven(log: JointLog) -> Iterator[Finding]:
    """A rigid joint whose drive has one torque throughout, but which gains energy.

    Under gravity, springs, any friction and a constant torque, a joint never passes an angle faster than before. A
    joint of an arm, or beside a known neighbour, gains energy from the others.
    """
    torque = log.torque
    if log.commands is not None and {"arm_torque", "neighbour"} & log.commands.channels.keys():
        return
    if log.device.n_motors or torque is None or not np.isfinite(torque).any() or np.ptp(torque[np.isfinite(torque)]):
        return
    there = np.isfinite(log.measured["q"])
    time, q = log.measured.time[there], log.measured["q"][there]
    passes = np.flatnonzero(np.diff(np.sign(q - np.median(q))) != 0)
    passes = passes[(passes >= AROUND) & (passes < len(q) - AROUND)]
    speed = np.abs((q[passes + AROUND] - q[passes - AROUND]) / (time[passes + AROUND] - time[passes - AROUND]))
    if len(speed) < 2 or np.mean(np.diff(speed) > GAINED * speed.max()) < OFTEN:
        return
    value = float(torque[np.isfinite(torque)][0])
    text = (
        f"the torque of the drive is {value:.3g} N m in all samples, but the joint passes the same angle faster than "
        "before: something drives it. Record the torque of the drive, or let the joint swing freely"
    )
    yield log.finding("undriven", "tau", "refuse", value, text)


def _faults(log: JointLog) -> Iterator[Finding]:
    """A sign, unit or order of channels that is wrong; unproven faults are left to the diagnosis."""
    samples = Samples.of_signals(log.measured, log.device, log.commands)
    found = None if samples is None else faulty_time(log.device, samples)
    if found is not None and found.fault.proven:
        yield log.finding("implausible", found.fault.subject, "refuse", found.share, found.fault.text)


def _alignment(log: JointLog) -> Iterator[Finding]:
    """Measured torques that lag commanded ones."""
    if not log.torque_seen or log.device.drive != "torque":
        return
    # Samples; the torque of a sample is that of the tick which ended there.
    sent = {late: commands for late in range(-2, 8) if (commands := log.motor_commands(late)) is not None}
    for i in range(log.device.n_motors if sent else 0):
        tau = log.measured["tau"][:, i]
        seen = np.isfinite(tau)
        errors = {late: float(np.var(tau[seen] - commands[seen, i])) for late, commands in sent.items()}
        best = min(errors, key=lambda late: errors[late])
        if best != 0 and errors[best] < 0.5 * errors[0] and errors[best] < 0.1 * float(np.var(tau[seen])):
            late = best * float(np.median(np.diff(log.measured.time)))
            text = f"tau_{i + 1} follows its command {1e3 * late:.3g} ms later than it should"
            yield log.finding("skew", f"tau_{i + 1}", "note", late, text)
