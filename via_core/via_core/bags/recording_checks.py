"""Physical plausibility checks of the recording of one joint against its device file.

Each check compares a number with a limit that follows from the device: encoder steps, servo bandwidth, spring torque
and inertia. Errors mean that measurements and commands do not belong together or that a sensor is faulty; warnings mark
intervals to leave out.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Literal

import numpy as np
from numba import njit

from via_core.bags.findings import Finding
from via_core.bags.losses import NOTABLE, losses
from via_core.device_parts import ServoMotor
from via_core.devices import Device
from via_core.faults import FEW, faulty_time
from via_core.modulated_rows import Samples
from via_core.servos import servo_step
from via_core.signals import Array, Mask, Signals
from via_core.stamps import ordered

LEAST_SAMPLES = 50
EARLIEST, LATEST = -1e8, 2e9  # [s] valid stamps: ROS counts to 2^31, and an import shifts negative ones
BAD_STAMP_SHARE = 0.01  # [-] largest share of samples left out for their stamps
GAP_PERIODS = 5.0  # a gap is longer than so many median periods
WINDOW = 9  # samples of the running median, robust against spikes and lost samples
STEADY_STEPS = 3  # largest error of a resting servo in encoder steps (MACCEPA-VD: good runs .8, wrong from 5.9)
MOVING_SHARE = 0.05  # [-] largest error of a moving servo, as share of the commanded travel
SPIKE_STEPS = 5  # a spike is more encoder steps than this off the running median
STALE_SAMPLES = 10  # stale: unchanged for so many samples while the model moves by more than SPIKE_STEPS
SAFETY = 3.0  # [-] factor on the largest step that spring torque and encoder explain
RATE = 0.2  # [-] of the rate in the device file: samples lost or late at random change the median step by less
TIMES = {"ms": 1e3, "us": 1e6, "ns": 1e9}  # units of time met in logs -> per second
COARSER = 5.0  # [-] largest accepted ratio of the encoder step in the data to that in the device file
FALLBACK_STEP = 5e-3  # [rad] encoder step (a quarter of a degree) where the device file has none


def check_samples(time: Array, columns: Mapping[str, Array]) -> tuple[Finding, ...]:
    """Findings on the table: its length, its stamps (N,) [s] and missing values (NaN)."""
    findings = []
    if len(time) < LEAST_SAMPLES:
        text = f"only {len(time)} samples, fewer than {LEAST_SAMPLES}"
        findings.append(Finding("error", "length", "recording", text, float(len(time)), float(LEAST_SAMPLES)))
    findings += _stamps(time)
    for name, values in columns.items():
        share = float(np.isnan(values).mean()) if len(values) else 0.0
        if share > 0.0:
            text = f"{share:.1%} of the samples are not measured"
            findings.append(Finding("error" if share == 1.0 else "warning", "not_measured", name, text, share))
        if np.isinf(values).any():
            text = f"{int(np.isinf(values).sum())} samples are infinite"
            findings.append(Finding("error", "infinite", name, text, float(np.isinf(values).mean()), 0.0))
    return tuple(findings)


def usable_stamps(time: Array) -> Mask:
    """Mask (N,) of the samples whose stamp [s] is valid in ROS, in order."""
    return ordered(np.where((time > EARLIEST) & (time < LATEST), time, np.nan)).kept


def _stamps(time: Array) -> list[Finding]:
    findings = []
    usable = usable_stamps(time)
    bad = int(np.count_nonzero(~usable))
    if bad:
        share = bad / len(time)
        severity: Literal["warning", "error"] = "error" if share > BAD_STAMP_SHARE else "warning"
        text = f"{bad} of {len(time)} stamps are invalid, repeated or out of order; those samples are left out"
        findings.append(Finding(severity, "stamps", "time", text, share, BAD_STAMP_SHARE))
    missing = losses(time[usable])
    if missing is not None:
        text = f"about {missing.lost} samples are missing by their stamps, up to {missing.longest} in a row"
        findings.append(Finding("warning", "missing", "time", text, missing.share, NOTABLE))
    dt = np.diff(time[usable])
    if len(dt) >= LEAST_SAMPLES and dt.max() > GAP_PERIODS * np.median(dt):
        worst = int(np.argmax(dt))
        text = f"a gap of {dt[worst]:.4f} s at {time[usable][worst]:.4f} s; the median period is {np.median(dt):.4f} s"
        findings.append(Finding("warning", "gap", "time", text, float(dt[worst]), float(GAP_PERIODS * np.median(dt))))
    return findings


def check_recording(measured: Signals, commands: Signals | None, device: Device) -> tuple[Finding, ...]:
    """Findings on the motion of one joint; channels named as in `joint_signals`."""
    if "q" not in measured:
        return (Finding("error", "not_measured", "q", "the joint angle was never measured", 1.0),)
    if len(measured) < LEAST_SAMPLES:
        return ()
    findings = [*_rate(measured.time, device), *_angle_steps(measured, commands, device)]
    if device.drive == "servo" and commands is not None and len(commands) and "theta" in measured:
        findings += _servos(measured, commands, device)
    return (*findings, *_faults(measured, commands, device))


def sampling_rate(time: Array) -> float:
    """Rate [Hz] at which samples with stamps (N,) [s] come, by the median of their steps; NaN if they are few."""
    time = time[usable_stamps(time)]
    return 1.0 / float(np.median(np.diff(time))) if len(time) >= LEAST_SAMPLES else np.nan


def rate_remark(rate: float, device: Device) -> str:
    """One sentence if samples come at another rate [Hz] than the device file says; else, and for NaN, empty."""
    filed, unit = device.sensors.rate, _unit_of_time(rate, device)
    if not abs(rate / filed - 1.0) > RATE:
        return ""
    remedy = f": their time is in {unit}, not in s" if unit else ""
    return f"samples come at {rate:.4g} Hz, the device file says {filed:.4g} Hz{remedy}"


def _unit_of_time(rate: float, device: Device) -> str:
    """The unit of time, other than s, in which samples come at the rate of the device file; empty if there is none."""
    return next((name for name, n in TIMES.items() if abs(rate * n / device.sensors.rate - 1.0) <= RATE), "")


def _rate(time: Array, device: Device) -> list[Finding]:
    rate = sampling_rate(time)
    text = rate_remark(rate, device)
    severity: Literal["warning", "error"] = "error" if _unit_of_time(rate, device) else "warning"
    return [Finding(severity, "rate", "time", text, abs(rate / device.sensors.rate - 1.0), RATE)] if text else []


def _faults(measured: Signals, commands: Signals | None, device: Device) -> list[Finding]:
    """Finding for channels that no device near the device file explains."""
    samples = Samples.of_signals(measured, device, commands)
    found = None if samples is None else faulty_time(device, samples)
    if found is None:
        return []
    text = (
        f"{found.fault.text} ({found.share:.0%} of the time with motion, from {found.begin:.1f} to {found.end:.1f} s)"
    )
    return [Finding("error", "implausible", found.fault.subject, text, found.share, 1.0 - FEW)]


def _angle_steps(measured: Signals, commands: Signals | None, device: Device) -> list[Finding]:
    """Finding for a step of the joint angle that is too large compared with its neighbours.

    A step exceeds the faster of its neighbours by at most tau_max dt^2 / M plus two encoder steps of rounding. An
    impact stops a link and does not accelerate it, so it passes.
    """
    known = np.isfinite(measured["q"])
    time, q = measured.time[known], measured["q"][known]
    torque = _strongest_torque(commands, device)
    if torque == 0.0 or len(q) < LEAST_SAMPLES:
        return []
    step, dt = np.abs(np.diff(q)), np.diff(time)
    beside = np.maximum(step[:-2] / dt[:-2], step[2:] / dt[2:]) * dt[1:-1]
    excess = step[1:-1] - beside
    named = device.sensors.link_quantum or FALLBACK_STEP
    quantum = min(max(_smallest_step(q), named), COARSER * named)
    limit = SAFETY * (torque / device.link.inertia * dt[1:-1] ** 2 + 2.0 * quantum)
    worst = int(np.argmax(excess / limit))
    if excess[worst] <= limit[worst]:
        return []
    return [
        Finding(
            "error",
            "angle_step",
            "q",
            f"the joint angle jumps {step[worst + 1]:.3f} rad in {dt[worst + 1] * 1e3:.1f} ms at "
            f"{time[worst + 1]:.3f} s, {excess[worst]:.3f} rad more than the neighbouring steps; the largest spring "
            f"torque ({torque:.2f} N m) and the encoder ({quantum:.4f} rad) allow {limit[worst]:.3f} rad",
            float(excess[worst]),
            float(limit[worst]),
        )
    ]


def _strongest_torque(commands: Signals | None, device: Device) -> float:
    """Largest torque [N m] on the link from springs within their stops, at the largest preset used, plus gravity."""
    preset = 0.0
    if commands is not None and "preset" in commands and np.isfinite(commands["preset"]).any():
        preset = float(np.nanmax(np.abs(commands["preset"])))
    torque = 0.0
    for spring in device.springs:
        phi = np.linspace(-spring.max_deflection, spring.max_deflection, 401)
        torque += float(np.abs(spring.torque(phi, preset)).max())
    return torque + device.link.gravity_torque if torque else 0.0


def _smallest_step(q: Array) -> float:
    """Encoder step [rad] seen in the data: the smallest change above rounding, 0 without motion."""
    steps = np.abs(np.diff(q))
    steps = steps[steps > 1e-9]
    return float(steps.min()) if steps.size else 0.0


def _servos(measured: Signals, commands: Signals, device: Device) -> list[Finding]:
    wanted = _motor_commands(commands, device)
    findings = []
    for i, motor in enumerate(device.motors):
        theta = measured["theta"][:, i]
        known = np.isfinite(theta)
        if (
            not isinstance(motor, ServoMotor)
            or wanted is None
            or not np.isfinite(wanted[:, i]).any()
            or known.sum() < LEAST_SAMPLES
        ):
            continue
        subject = f"theta_{i + 1}"
        time, angle = measured.time[known], theta[known]
        clean = _running_median(angle)
        defined = np.isfinite(wanted[:, i])
        reference = wanted[defined, i]
        model = servo_response(time, commands.time[defined], reference, float(clean[0]), motor.bandwidth)
        quantum = device.sensors.motor_quantum or FALLBACK_STEP
        findings += _servo_response(time, clean, model, reference, quantum, subject)
        findings += _spikes(angle, clean, quantum, subject)
        findings += _stale(time, angle, model, quantum, subject)
    return findings


def _motor_commands(commands: Signals, device: Device) -> Array | None:
    """Commanded motor angles (n, m) [rad], None without any."""
    if "motor" in commands and commands.units["motor"] == "rad":
        return commands["motor"]
    if "equilibrium" not in commands:
        return None
    return device.motor_angles(commands["equilibrium"], commands.channels.get("preset", 0.0))


def _servo_response(
    time: Array, clean: Array, model: Array, reference: Array, quantum: float, subject: str
) -> list[Finding]:
    """Finding for a measured angle that deviates from the exact response to the logged command, at rest if possible."""
    error = np.abs(clean - model)
    compared = np.abs(np.gradient(model, time)) < quantum / np.median(np.diff(time)) / WINDOW
    limit = STEADY_STEPS * quantum
    state = "resting"
    if compared.mean() < 0.1:
        compared = np.ones(len(time), dtype=np.bool_)
        limit += MOVING_SHARE * float(np.ptp(reference))
        state = "moving"
    value = float(np.median(error[compared]))
    if value <= limit:
        return []
    return [
        Finding(
            "error",
            "servo_response",
            subject,
            f"the {state} servo is {value:.3f} rad (median) off its response to the logged command, "
            f"more than {limit:.3f} rad: these measurements were recorded under another command",
            value,
            limit,
        )
    ]


def _spikes(angle: Array, clean: Array, quantum: float, subject: str) -> list[Finding]:
    off = np.abs(angle - clean)
    spikes = int(np.count_nonzero(off > SPIKE_STEPS * quantum))
    if spikes == 0:
        return []
    share = spikes / len(angle)
    text = f"{spikes} of {len(angle)} values are spikes, up to {off.max():.2f} rad off"
    return [Finding("warning", "spikes", subject, text, share)]


def _stale(time: Array, angle: Array, model: Array, quantum: float, subject: str) -> list[Finding]:
    edges = np.flatnonzero(np.concatenate([[True], np.diff(angle) != 0.0, [True]]))
    stale, longest = 0, 0.0
    for begin, end in pairwise(edges.tolist()):
        if end - begin >= STALE_SAMPLES and np.ptp(model[begin:end]) > SPIKE_STEPS * quantum:
            stale += end - begin
            longest = max(longest, float(time[end - 1] - time[begin]))
    if stale == 0:
        return []
    text = f"{stale / len(angle):.0%} of the values are stale while the servo must have moved, up to {longest:.2f} s"
    return [Finding("warning", "stale", subject, text, stale / len(angle))]


def _running_median(values: Array) -> Array:
    padded = np.pad(values, WINDOW // 2, mode="edge")
    return np.median(np.lib.stride_tricks.sliding_window_view(padded, WINDOW), axis=1)


@njit(cache=True)
def servo_response(
    time: Array,
    command_time: Array,
    command: Array,
    start: float,
    bandwidth: float,
) -> Array:
    """Exact angle (N,) [rad] of a servo under each `command` [rad] from its `command_time` [s] on; `bandwidth` [rad/s].

    The servo rests at `start` [rad] until the first command.
    """
    angle, speed = start, 0.0
    out = np.empty(len(time))
    active, now = -1, time[0]
    for k in range(len(time)):
        while active + 1 < len(command) and command_time[active + 1] <= time[k]:
            at = max(command_time[active + 1], now)
            if active >= 0:
                angle, speed = servo_step(angle, speed, command[active], bandwidth, at - now)
            now = at
            active += 1
        if active >= 0:
            angle, speed = servo_step(angle, speed, command[active], bandwidth, time[k] - now)
        now = time[k]
        out[k] = angle
    return out
