"""Quality of a recording: findings, usable time, and the reason if it cannot be diagnosed.

Limits follow from the noise of the log or from the error that a fault causes; constants state their reason.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import log as ln
from math import sqrt
from typing import NamedTuple

import numpy as np
from scipy.signal import savgol_filter
from via_core.signals import Array, Indices, Mask

from via_gap.logs.angle_torque import left_by_angles
from via_gap.logs.even_clock import evened, typical_speed
from via_gap.logs.findings import Finding, Severity, worst_first
from via_gap.logs.log import JointLog
from via_gap.logs.noise import STANDARD_ERRORS, LogNoise, log_noise

Interval = tuple[float, float]
SEGMENT = 0.25  # [s] length of a segment of a torque-driven joint, which drifts
# [s] by the drive. With a position drive, a wrong start decays within the settling time of the loop; with servos, a
# joint does not drift.
SPANS = {"torque": SEGMENT, "position": 0.75, "servo": 1.5}
TOLERANCE = 0.05  # relative error of device parameters that the motion has to show
MISSED = 1.5  # periods from which an interval contains a missed sample or command
REGULAR = 0.5  # share of command intervals near the median from which commands are periodic
SHORT = 0.1  # of a segment: longest gap in the commands whose effect on it is linear in the commands it lacks
MUCH = 0.1  # share of the time: standard errors grow by 5 % without it
HALF = 0.5
WORTH = 1.0  # jitter error over noise: from here jitter is the larger part of the variance


@dataclass(frozen=True)
class Quality:
    """Quality of one log.

    log  the log itself, with the stamps to use
    """

    log: JointLog
    findings: tuple[Finding, ...]  # worst first
    usable: tuple[Interval, ...]  # (begin, end) [s] on the log's clock of the intervals that may be compared
    noise: LogNoise
    cannot_tell: str = ""  # why the log cannot be diagnosed and what to record instead; empty: it can
    # (begin, end) [s] of the commands before and after each short gap: unknown commands, part of the noise
    command_gaps: tuple[Interval, ...] = ()
    # (begin, end) [s] of the samples before and after each gap that interpolation cannot bridge
    sample_gaps: tuple[Interval, ...] = ()

    @property
    def seconds(self) -> float:
        """[s] that may be used."""
        return float(sum(end - begin for begin, end in self.usable))


class _Found(NamedTuple):
    finding: Finding
    cut: tuple[Interval, ...] = ()
    command_gaps: tuple[Interval, ...] = ()
    sample_gaps: tuple[Interval, ...] = ()


def assessed(log: JointLog) -> Quality:
    """Quality of a log with the noise that is measured in it; with corrected stamps, if they are wrong."""
    noise = log_noise(log)
    even = evened(log, noise.channels["q"].sd)
    return assess(even, noise if even is log else log_noise(even))


def assess(log: JointLog, noise: LogNoise) -> Quality:
    """The quality of a log whose noise was estimated by `via_gap.logs.noise.log_noise`."""
    found = [
        *_samples(log, noise),
        *_commands(log),
        *_jitter(log, noise),
        *_drive(log),
        *_motion(log, noise),
        *_pinned(log, noise),
        *_fast_torque(log, noise),
        *_torque_of_angle(log, noise),
    ]
    findings = worst_first(each.finding for each in found)
    whole = (float(log.measured.time[0]), float(log.measured.time[-1]))
    usable = _without(whole, [cut for each in found for cut in each.cut])
    refused = [f.text for f in findings if f.severity == "refuse"]
    if not refused and sum(end - begin for begin, end in usable) < SEGMENT:
        refused = ["no usable interval of the log is long enough: record it again on a machine with less load"]
    commands = tuple(gap for each in found for gap in each.command_gaps)
    samples = tuple(gap for each in found for gap in each.sample_gaps)
    return Quality(
        log, tuple(findings), tuple(usable), noise, " ".join(f"{text}." for text in refused), commands, samples
    )


def _without(whole: Interval, cuts: Sequence[Interval]) -> list[Interval]:
    """An interval without others."""
    left, begin = [], whole[0]
    for start, stop in sorted(cuts):
        if start > begin:
            left.append((begin, min(start, whole[1])))
        begin = max(begin, stop)
    if begin < whole[1]:
        left.append((begin, whole[1]))
    return left


def _spans(time: Array, which: Mask) -> tuple[Interval, ...]:
    """Intervals of neighbouring samples for which `which` (N,) holds."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], which, [False])).astype(int)))
    return tuple((float(time[a]), float(time[b - 1])) for a, b in edges.reshape(-1, 2))


def _acceleration(log: JointLog, noise: LogNoise, half: int) -> tuple[Array, float]:
    """Second derivatives of parabolas over `half` samples of the link to either side, and their standard deviation."""
    q, period, n = log.measured["q"][np.isfinite(log.measured["q"])], noise.clock.period, 2 * half + 1
    bend = savgol_filter(q, n, 2, deriv=2, delta=period) if len(q) >= n else np.zeros(1)
    return bend, noise.channels["q"].sd * sqrt(720.0 / n**5) / period**2


def _samples(log: JointLog, noise: LogNoise) -> Iterator[_Found]:
    """Late samples. Linear interpolation over a gap g has an error of g^2 / 8 times the acceleration.

    Which is the 95 % quantile of that of parabolas over a tenth of a segment to either side.
    """
    time, period = log.measured.time, noise.clock.period
    steps = np.diff(time)
    late = steps > MISSED * period
    if not late.any():
        return
    accelerations, sd = _acceleration(log, noise, max(3, round(0.1 * SEGMENT / period)))
    bend = float(np.quantile(np.abs(accelerations), 0.95)) - STANDARD_ERRORS * sd  # without noise
    longest = max(MISSED * period, sqrt(8.0 * noise.channels["q"].sd / bend) if bend > 0.0 else np.inf)
    gone = np.flatnonzero(steps > longest)
    gaps = tuple((float(time[i]), float(time[i + 1])) for i in gone)
    lost = float(steps[gone].sum() / log.duration) if gone.size else 0.0
    share = float(np.mean(late))
    text = (
        f"{100 * share:.3g} % of the samples came late, the longest after {1e3 * steps.max():.3g} ms instead of "
        f"{1e3 * period:.3g} ms; {100 * lost:.3g} % of the time has no weight because gaps above "
        f"{1e3 * longest:.3g} ms hide motion: record on a machine with less load, or stamp samples in the driver"
    )
    severe = lost > MUCH or share > MUCH
    yield _Found(log.finding("late", "time", "downgrade" if severe else "note", share, text), (), (), gaps)


def _commands(log: JointLog) -> Iterator[_Found]:
    """Missing commands of a periodic sender."""
    if log.commands is None or len(log.commands) < 10:
        return
    time = log.commands.time
    steps = np.diff(time)
    period = float(np.median(steps))
    if float(np.mean(np.abs(steps - period) < HALF * period)) < REGULAR:
        return  # not periodic
    changed = np.zeros(len(steps), dtype=bool)
    for values in log.commands.channels.values():
        columns = values.reshape(len(values), -1)
        moved = np.abs(np.diff(columns, axis=0))
        usual = np.nanmedian(moved, axis=0)
        changed |= np.any(moved > usual, axis=1)
    gone = np.flatnonzero((steps > MISSED * period) & changed)
    if not gone.size:
        return
    longest, share = float(steps[gone].max()), float(steps[gone].sum() / max(log.duration, period))
    short = SHORT * SPANS[log.device.drive]
    long = gone[steps[gone] > short]
    lost = float(steps[long].sum() / max(log.duration, period))
    text = (
        f"{gone.size} times a command is missing for longer than {1e3 * MISSED * period:.3g} ms while commands change, "
        f"the longest for {1e3 * longest:.3g} ms; the commands in {100 * share:.2g} % of the time are unknown, which "
        f"counts as noise, and {100 * lost:.2g} % of the time is left out because the gap is longer than "
        f"{1e3 * short:.3g} ms: record commands where they are sent, with less load"
    )
    cut = tuple((float(time[i]), float(time[i + 1])) for i in long)
    bridged = tuple((float(time[i]), float(time[i + 1])) for i in gone if steps[i] <= short)
    severity: Severity = "downgrade" if lost > MUCH else "note"
    yield _Found(log.finding("command gaps", "commands", severity, 1e3 * longest, text), cut, bridged)


def _jitter(log: JointLog, noise: LogNoise) -> Iterator[_Found]:
    jitter, own = noise.jitter, noise.channels["q"]
    if log.restamped > 0.0:
        text = (
            f"time stamps are wrong by {1e3 * log.restamped:.2g} ms, as the motion shows; corrected towards an even "
            "clock. Stamp samples where they are measured"
        )
        yield _Found(log.finding("clock", "time", "note", 1e3 * log.restamped, text))
    if jitter <= 0.0:
        return
    typical = typical_speed(log)
    ratio = jitter * typical / own.sd
    if ratio < 1.0 / STANDARD_ERRORS:  # less than a tenth of the variance
        return
    are = "are still" if log.restamped > 0.0 else "are"
    text = (
        f"time stamps {are} wrong by {1e3 * jitter:.2g} ms, at {typical:.2g} rad/s {ratio:.2g} times the noise of the "
        "link angle; it is added to the noise: stamp samples where they are measured"
    )
    yield _Found(log.finding("jitter", "time", "downgrade" if ratio > WORTH else "note", 1e3 * jitter, text))


def _drive(log: JointLog) -> Iterator[_Found]:
    """Missing torque and command of a rigid joint."""
    if log.device.drive != "torque" or log.device.n_motors or log.torque_seen:
        return
    if log.commands is not None and "external_torque" in log.commands:
        return
    text = (
        "neither the drive torque nor its command was recorded: record the effort of the drive (tau_1) or its command "
        "(external_torque); if nothing drives the joint, record an external_torque of zero"
        f"{log.hint}"
    )
    yield _Found(log.finding("no torque", "tau_1", "refuse", 0.0, text))


def _moving(log: JointLog, noise: LogNoise) -> tuple[Indices, Indices, Mask]:
    """Samples with a link angle (n,), the segment of each (n,), and whether each segment moves (segments,).

    A segment moves if its range is twice that of noise, which is about 2 sqrt(2 ln n) sd for n normal values.
    """
    there = np.flatnonzero(np.isfinite(log.measured["q"]))
    time = log.measured.time[there]
    segment = ((time - time[0]) / SEGMENT).astype(np.intp)
    q, own = log.measured["q"][there], noise.channels["q"]
    count = int(segment[-1]) + 1
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(low, segment, q)
    np.maximum.at(high, segment, q)
    each = max(2.0, len(q) / count)
    limit = 4.0 * sqrt(2.0 * ln(each)) * own.white + STANDARD_ERRORS * own.quantum
    limit = max(limit, 4.0 * own.sd)
    return there, segment, high - low > limit


def _motion(log: JointLog, noise: LogNoise) -> Iterator[_Found]:
    """Too little motion to show a change of the device parameters by their tolerance.

    The change of a segment is TOLERANCE times its range r; with noise sd and m segments that move, that is
    TOLERANCE r sqrt(m) / sd standard errors.
    """
    there, segment, moves = _moving(log, noise)
    q, own = log.measured["q"][there], noise.channels["q"]
    ranges = np.array([np.ptp(q[segment == k]) if np.any(segment == k) else 0.0 for k in np.flatnonzero(moves)])
    shown = TOLERANCE * float(np.sqrt(np.sum(ranges**2))) / own.sd
    share = float(np.mean(moves))
    if shown < STANDARD_ERRORS:
        drive = noise.channels.get("tau_1")
        varies = drive and log.torque is not None and float(np.nanstd(log.torque[:, 0])) > STANDARD_ERRORS * drive.sd
        clamped = "its torque varies, so that a stop, a brake or a clamp may hold it: free the joint, and "
        text = (
            f"the link moves by {np.ptp(q):.2g} rad, {np.ptp(q) / own.sd:.2g} times its noise, and "
            f"{100 * share:.0f} % of the time: a change of {100 * TOLERANCE:.0f} % in the device shows by "
            f"{shown:.2g} standard errors; {clamped if varies else ''}move it further and for longer"
        )
        yield _Found(log.finding("too little motion", "q", "refuse", shown, text))
    elif share < HALF:
        text = f"the link moves {100 * share:.0f} % of the time: the rest shows neither inertia nor viscous friction"
        yield _Found(log.finding("still", "q", "note", share, text))


def _pinned(log: JointLog, noise: LogNoise) -> Iterator[_Found]:
    """A link that rests at one end of its range while the torque varies by more than in motion."""
    if log.device.n_motors or not log.torque_seen:
        return
    there, segment, moves = _moving(log, noise)
    if moves.all() or not moves.any():
        return
    q, tau = log.measured["q"][there], log.measured["tau"][there, 0]
    reach = max(STANDARD_ERRORS * noise.channels["q"].sd, noise.channels["q"].quantum)
    moved = _range(tau[moves[segment]])
    with np.errstate(invalid="ignore"):  # a segment without samples has no mean
        centre = np.bincount(segment, q) / np.bincount(segment)
    for name, end in (("lowest", float(q.min())), ("highest", float(q.max()))):
        rests = ~moves & (np.abs(centre - end) < reach)
        if rests.sum() < 2:
            continue
        varied = _range(tau[rests[segment]])
        if varied <= moved:
            continue
        share = float(np.mean(rests))
        text = (
            f"the link rests at its {name} angle of {end:.3g} rad for {100 * share:.0f} % of the time while its torque "
            f"varies by {varied:.2g} N m, more than the {moved:.2g} N m in motion: a stop or a clamp holds it. That "
            "time is left out: move the joint away from the stop"
        )
        cut = _spans(log.measured.time[there], rests[segment])
        yield _Found(log.finding("clamped", "q", "refuse" if share > HALF else "downgrade", share, text), cut)


def _range(values: Array) -> float:
    """Difference of the 90 % and 10 % quantiles, on which reaching and leaving a stop have no influence."""
    return float(np.nanquantile(values, 0.9) - np.nanquantile(values, 0.1))


def _torques(log: JointLog, noise: LogNoise) -> Iterator[tuple[str, Array]]:
    if log.device.drive != "torque" or log.torque is None:
        return
    for i, column in enumerate(log.torque.T):
        if f"tau_{i + 1}" in noise.channels and np.isfinite(column).mean() >= 0.9 and np.nanstd(column) > 0.0:
            yield f"tau_{i + 1}", column


def _fast_torque(log: JointLog, noise: LogNoise) -> Iterator[_Found]:
    """Torque with too little correlation c from sample to sample.

    The squared error of a zero-order hold is 2 (1 - c) times the variance of the torque, that of its mean is the
    variance. Below c = 1/2, the mean predicts the torque better than the last sample.
    """
    for name, column in _torques(log, noise):
        there = column[np.isfinite(column)]
        share = float(np.mean(np.diff(there) ** 2) / (2.0 * np.var(there)))
        if share > HALF:
            text = (
                f"{name} changes from sample to sample by {100 * sqrt(share):.0f} % of its overall variation: its "
                "drive is faster than the log, or it is mostly noise, and no simulation can be driven with it. Record "
                "at the rate of the drive, or the mean over each sample"
            )
            yield _Found(log.finding("decimated", name, "downgrade", share, text))


def _torque_of_angle(log: JointLog, noise: LogNoise) -> Iterator[_Found]:
    """Torque that is a function of the angles alone, up to less than a change of the device by its tolerance.

    If the torque on a rigid joint's inertia is larger than the rest, the recorded torque does not contain it; otherwise
    the motion is slow and the torque balances gravity.
    """
    bend, sd = _acceleration(log, noise, max(2, round(0.5 * SEGMENT / noise.clock.period)))
    for name, column in _torques(log, noise):
        if log.device.n_motors and not all(log.motors_seen):
            continue
        left = left_by_angles(log, column)
        if left is None:
            continue
        residual, variance = max(left[0], noise.channels[name].sd ** 2), left[1]
        share = 1.0 - residual / variance
        if residual >= TOLERANCE**2 * variance:
            continue
        text = (
            f"{name} is a function of the angle alone, which predicts {100 * share:.3g} % of its variance in held-out "
            "passes; "
        )
        if log.device.n_motors:
            text += "it shows the controller more than the joint: use a reference that varies"
            yield _Found(log.finding("torque of angle", name, "downgrade", share, text))
        elif log.device.link.inertia * sqrt(max(float(np.mean(bend**2)) - sd**2, 0.0)) > 2.0 * sqrt(residual):
            text += (
                "it does not distinguish inertia and friction from gravity: something else moved the joint (a hand, "
                "another joint), or the motion repeats one sine. Record motion made by the drive, with several speeds "
                "at each angle"
            )
            yield _Found(log.finding("torque of angle", name, "refuse", share, text))
        else:
            text += "the motion is so slow that it shows gravity only: move faster to see inertia and friction"
            yield _Found(log.finding("torque of angle", name, "downgrade", share, text))
