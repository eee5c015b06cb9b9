"""Which reading of the angle a drive answered to: tells an angle that is stamped late from a command that acts late.

On a rigid joint the two leave one and the same record of the motion, u(t - d) -> q(t) and u(t) -> q(t - d). What tells
them apart is the drive's own controller. It computed every command from a reading, and a reading is the angle and what
rounding to the encoder's step made of it, which is as good as chance and known to nobody who did not read it:

    u_k = smooth + sum_j w_j r_(k-j),   r = Q(q)

Where the log's angle is stamped as it was read, the command follows these very roundings, whether or not it acts late.
Where the angle is stamped `late`, the drive read Q(q(t_k)) and the log holds Q(q(t_k - late)), rounded anew. The former
is made again, by a polynomial through the samples about t_k + late, rounded, and readings up to then are added: those
of an angle stamped right tell nothing of u_k, for it acts later. The polynomial stands beside its rounding, so that no
motion, only the rounding itself, can speak for a late stamp. Third differences are compared, in which rounding is
large and motion small; each half of a log is predicted by the fit to the other. What comes first as a test of what
answers to what: C. W. J. Granger, Investigating causal relations by econometric models (Econometrica, 1969).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.signal import savgol_coeffs
from via_core.signals import Array
from via_sim.readings import MAX_SKEW

from via_gap.candidates.location import Location
from via_gap.logs.findings import Finding
from via_gap.logs.log import JointLog
from via_gap.residual.segments import quantum
from via_gap.selection.evidence import Evaluation

LATE_COMMAND = Location("actuator_delay", "command", 0)
LATE_ANGLE = Location("channel_skew", "timing", 0)
DIFFERENCES = 3
ANSWER = range(9)  # samples over which a controller answers: a filtered speed
WINDOW, DEGREE = 13, 5  # samples and degree of the polynomial
AHEAD = 3  # newest readings before `late` that are added
ABOUT = np.linspace(-0.06, 0.06, 13)  # of a sample, about the lateness fitted: the rounding is that sharp
ON_TIME = 0.1  # of a sample's period within which a command belongs to its stamp
FULL = 0.999  # of the largest command: a drive at its limit answers to nothing
OUTLIER = 9.0  # times the median: the wish itself stepped
LEAST, MOST = 500, 12000  # samples
ANSWERS = 0.5  # share of the differences' square left by readings, under which the drive is seen to answer
WHOLLY = 0.03  # the same, under which nothing is left that a later reading could tell
LATER = 0.95  # of what the smooth angle leaves, under which a later rounding is in the commands: 0.70 to 0.84, else 1


def stamped_late(logs: Sequence[JointLog], late: float) -> bool | None:
    """Whether the link's angle is stamped `late` [s] after it was read; None where the commands do not tell."""
    told = [each for log in logs if (each := _left(log, late)) is not None]
    if not told:
        return None
    at_once, smooth, later = np.mean(told, axis=0)
    if at_once > WHOLLY and later < LATER * smooth:
        return True
    return False if at_once < ANSWERS else None


def separate_delays(logs: Sequence[JointLog], models: Sequence[Evaluation]) -> tuple[list[Evaluation], list[Finding]]:
    """The models in which, of a late command and a late angle, only the one is left that the drive's answers allow.

    On a rigid joint alone: elsewhere the other angles tell. What was fitted as the one holds for the other.
    """
    fits = [each.fit for each in models if {LATE_COMMAND, LATE_ANGLE} & {*each.fit.locations}]
    if not fits or logs[0].device.n_motors:
        return list(models), []
    best = min(fits, key=lambda fit: (-len(fit.residual), fit.loss))
    where = next(i for i, location in enumerate(best.locations) if location in (LATE_COMMAND, LATE_ANGLE))
    delay = best.effects[where].parameters["delay"]
    late = stamped_late(logs, delay)
    if late is None or delay > MAX_SKEW:
        return list(models), []
    wrong, right = (LATE_COMMAND, LATE_ANGLE) if late else (LATE_ANGLE, LATE_COMMAND)
    text = (
        "commands answer to readings that the log holds only later: the link angle is stamped late"
        if late
        else "commands answer to the link angle as it is stamped: it is not late, a delay is one of the command"
    )
    finding = Finding(log=logs[0].name, check="answers", signal="q", severity="note", value=float(late), text=text)
    return _renamed(models, wrong, right), [finding]


def _renamed(found: Sequence[Evaluation], wrong: Location, right: Location) -> list[Evaluation]:
    """The same with the one location in place of the other, best first; none is there twice."""
    kept = [each for each in found if wrong not in each.fit.locations]
    there = {frozenset(each.fit.locations) for each in kept}
    for each in found:
        locations = frozenset(right if location == wrong else location for location in each.fit.locations)
        if wrong not in each.fit.locations or right in each.fit.locations or locations in there:
            continue
        effects = zip(each.fit.locations, each.fit.effects, strict=True)
        named = tuple(right.effect(effect.parameters) if location == wrong else effect for location, effect in effects)
        kept.append(replace(each, fit=replace(each.fit, effects=named)))
        there.add(locations)
    return sorted(kept, key=lambda each: each.score)


def _left(log: JointLog, late: float) -> tuple[float, float, float] | None:
    """Share of the commands' third differences that is left by readings as they are stamped; by these and a smooth
    angle `late` [s] later; and by its rounding as well. None where too little can be compared."""
    if log.commands is None or "external_torque" not in log.commands:
        return None
    period = float(np.median(np.diff(log.measured.time)))
    step, samples = quantum(log, 0), late / period
    angle, command = _regular(log, period)
    if step <= 0.0 or np.isfinite(angle * command).sum() < LEAST:
        return None
    wanted = np.diff(command, DIFFERENCES)
    limited = np.abs(command) >= FULL * np.nanmax(np.abs(command))
    wanted[np.convolve(limited, np.ones(DIFFERENCES + 1))[DIFFERENCES:-DIFFERENCES] > 0.0] = np.nan
    wanted[np.abs(wanted) > OUTLIER * np.nanmedian(np.abs(wanted))] = np.nan
    answered = [wanted, *_lags(angle)]
    at_once = _unexplained(answered)
    if at_once is None or at_once < WHOLLY:
        return None if at_once is None else (at_once, at_once, at_once)
    first = int(np.floor(samples + ABOUT[-1]))
    newest = [_later(np.diff(angle, DIFFERENCES), first - i) for i in range(min(first, AHEAD))]
    found = []
    for share in samples + ABOUT:
        smooth = _later(_between(angle, share - np.floor(share)), int(np.floor(share)))
        beside = [*answered, *_lags(smooth)]
        moved, rounded = _unexplained(beside), _unexplained([*beside, *newest, *_lags(step * np.rint(smooth / step))])
        if moved is not None and rounded is not None:
            found.append((at_once, moved, rounded))
    return min(found, key=lambda each: each[2] / each[1], default=None)


def _regular(log: JointLog, period: float) -> tuple[Array, Array]:
    """Angle [rad] and command [N m] (N,) at every period of the log; NaN where a sample or its command is missing."""
    assert log.commands is not None
    columns = []
    origin = log.measured.time[0]
    count = round(log.duration / period) + 1
    for time, values in (
        (log.measured.time, log.measured["q"]),
        (log.commands.time, log.commands["external_torque"]),
    ):
        sample = np.rint((time - origin) / period).astype(np.intp)
        there = (np.abs(time - origin - sample * period) < ON_TIME * period) & (sample >= 0) & (sample < count)
        column = np.full(count, np.nan)
        column[sample[there]] = values[there]
        columns.append(column)
    return columns[0], columns[1]


def _between(angle: Array, share: float) -> Array:
    """(N,) [rad] of the polynomial about every sample, `share` of a sample later; NaN at the ends."""
    half = WINDOW // 2
    weights = savgol_coeffs(WINDOW, DEGREE, pos=half + share, use="dot")
    smooth = np.convolve(angle, weights[::-1], "same")
    smooth[:half] = smooth[-half:] = np.nan
    return smooth


def _later(values: Array, samples: int) -> Array:
    """(N,) what values are some samples later, earlier where negative; NaN where there is nothing."""
    moved = np.full_like(values, np.nan)
    if samples >= 0:
        moved[: len(values) - samples] = values[samples:]
    else:
        moved[-samples:] = values[:samples]
    return moved


def _lags(angle: Array) -> list[Array]:
    """Third differences of an angle over the samples that a controller answers to."""
    moved = np.diff(angle, DIFFERENCES)
    return [_later(moved, -lag) for lag in ANSWER]


def _unexplained(columns: Sequence[Array]) -> float | None:
    """Share of the square of the first column that the others leave, each half fitted on the other. None: too few."""
    table = np.column_stack(columns)
    table = table[np.isfinite(table).all(axis=1)][:MOST]
    if len(table) < LEAST:
        return None
    half, left = len(table) // 2, 0.0
    for fitted, held in ((table[:half], table[half:]), (table[half:], table[:half])):
        weights = np.linalg.lstsq(fitted[:, 1:], fitted[:, 0], rcond=None)[0]
        left += float(np.sum((held[:, 0] - held[:, 1:] @ weights) ** 2))
    return left / max(float(table[:, 0] @ table[:, 0]), 1e-300)
