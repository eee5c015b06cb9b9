"""Separates an angle that is stamped late from a command that acts late, by the drive's own feedback.

On a rigid joint both produce the same record of the motion, u(t - d) -> q(t) and u(t) -> q(t - d). The controller
separates them. It computed every command from the encoder's measurements, each of which is the angle plus a rounding
error that is nearly random:

    u_k = smooth + sum_j w_j r_(k-j),   r = Q(q)

If the log's angle is stamped when it was measured, the command depends on these very rounding errors, whether or not it
acts late. If the angle is stamped `late`, the drive used Q(q(t_k)), but the log contains Q(q(t_k - late)), with other
rounding errors. The former is reconstructed from a polynomial through the samples around t_k + late. The regression
also contains the measurements up to then, and the polynomial without rounding, so that only the rounding errors
themselves can indicate a late stamp. An angle that is stamped in time is shown in the same way, by the rounding errors
of a polynomial around t_k: a command that moves the joint resembles the motion, whoever computed it. Third differences
are compared, in which rounding is large and motion small. Each half of a log is predicted by the fit to the other. It
is a test of Granger causality: C. W. J. Granger, Investigating causal relations by econometric models (Econometrica,
1969).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.signal import savgol_coeffs
from via_core.signals import Array
from via_sim.catalogue.sensor.channel_skew import MAX_SKEW

from via_gap.candidates.location import Location
from via_gap.logs.findings import Finding
from via_gap.logs.log import JointLog, quantum
from via_gap.selection.evidence import Evaluation
from via_gap.selection.verdict import Decision

LATE_COMMAND = Location("actuator_delay", "command", 0)
LATE_ANGLE = Location("channel_skew", "timing", 0)
IN_TIME = ("external_torque", "arm_torque")  # channels that act without the delay of the drive
DIFFERENCES = 3
LAGS = range(9)  # samples that a controller uses: it filters the speed
WINDOW, DEGREE = 13, 5  # samples and degree of the polynomial
AHEAD = 3  # newest measurements before `late` that are added
ABOUT = np.linspace(-0.06, 0.06, 13)  # samples around the fitted delay: rounding errors resolve it that finely
ON_TIME = 0.1  # of a sample's period within which a command belongs to its stamp
FULL = 0.999  # of the largest command: a drive at its limit ignores the measurements
OUTLIER = 9.0  # times the median: a step of the reference
LEAST, MOST = 500, 12000  # samples
COMPLETE = 0.03  # residual share of the squared differences with which nothing is left for later measurements
ROUNDED = 0.95  # of the share without some rounding errors: they were in the commands (observed: .23 to .84, else 1)


def stamped_late(logs: Sequence[JointLog], late: float) -> bool | None:
    """Whether the link's angle is stamped `late` [s] after its measurement; None where the commands do not show it."""
    shares = [each for log in logs if (each := _rounded(log, late)) is not None]
    if not shares:
        return None
    now, later = np.mean(shares, axis=0)
    if later < ROUNDED:
        return True
    return False if now < ROUNDED else None


def separate_delays(logs: Sequence[JointLog], models: Sequence[Evaluation]) -> tuple[list[Evaluation], list[Finding]]:
    """The models with only that one of late command and late angle that the drive's feedback allows, and a finding.

    Only for rigid joints: in others, the other angles separate the two. The fit of one is valid for the other.
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
        "commands depend on measurements that the log contains only later: the link angle is stamped late"
        if late
        else "commands depend on the link angle as it is stamped: the angle is not late, the command is"
    )
    return _renamed(models, wrong, right), [logs[0].finding("feedback", "q", "note", float(late), text)]


def with_late_angle(decision: Decision, log: JointLog) -> Decision:
    """The decision with a late angle as twin of a late command, if the log cannot separate them.

    With the link's angle alone and commands that all act late, both give the same record. As a candidate, a late angle
    would only make every model with a late command uncertain.
    """
    controlled = log.device.n_motors > 0 or log.device.drive == "position"
    of_loop = log.device.drive == "position" and log.torque_seen  # the drive's torque contains the angle in time
    sent = log.commands.channels if log.commands is not None else {}
    named = {each.kind.channel for each in decision.named} - {""}  # a neighbour acts only through a coupling
    others = any(len(np.unique(sent[name])) > 1 for name in (*IN_TIME, *named) if name in sent)  # also with NaN
    late = [model for (cause, _), model in zip(decision.shares, decision.models, strict=True) if cause == LATE_COMMAND]
    if not controlled or any(log.motors_seen) or of_loop or others or not late or _delay(late[0]) > MAX_SKEW:
        return decision
    number = [cause for cause, _ in decision.shares].index(LATE_COMMAND) + 1
    (twin,) = _renamed(late, LATE_COMMAND, LATE_ANGLE)
    shares, models = list(decision.shares), list(decision.models)
    shares.insert(number, (LATE_ANGLE, shares[number - 1][1]))
    models.insert(number, twin)
    also = (LATE_ANGLE,) if LATE_COMMAND in decision.equivalent else ()
    return replace(
        decision, shares=tuple(shares), models=tuple(models), equivalent=(*decision.equivalent, *also),
        twins=(LATE_COMMAND, LATE_ANGLE),
    )  # fmt: skip


def _delay(model: Evaluation) -> float:
    """[s] of the late command of a model."""
    return model.fit.effects[model.fit.locations.index(LATE_COMMAND)].parameters["delay"]


def _renamed(found: Sequence[Evaluation], wrong: Location, right: Location) -> list[Evaluation]:
    """The models with `right` in place of `wrong`, best first, without duplicates."""
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


def _rounded(log: JointLog, late: float) -> tuple[float, float] | None:
    """How far rounding errors reduce the residual share of the commands' squared third differences, as factors.

    Those of the angle as it is stamped, and those of the angle `late` [s] later; None where too little can be compared.
    """
    if log.commands is None or "external_torque" not in log.commands:
        return None
    period = float(np.median(np.diff(log.measured.time)))
    step, samples = quantum(log, 0), late / period
    angle, command = _regular(log, period)
    if step <= 0.0 or np.isfinite(angle * command).sum() < LEAST:
        return None
    differences = np.diff(command, DIFFERENCES)
    limited = np.abs(command) >= FULL * np.nanmax(np.abs(command))
    differences[np.convolve(limited, np.ones(DIFFERENCES + 1))[DIFFERENCES:-DIFFERENCES] > 0.0] = np.nan
    differences[np.abs(differences) > OUTLIER * np.nanmedian(np.abs(differences))] = np.nan
    smooth = _between(angle, 0.0)
    moving = [differences, *_lags(smooth)]
    moved, rounded = _unexplained(moving), _unexplained([*moving, *_lags(step * np.rint(smooth / step))])
    regression = [differences, *_lags(angle)]
    at_once = _unexplained(regression)
    if not moved or rounded is None or at_once is None:  # without a change of the commands nothing is to be explained
        return None
    now, later = rounded / moved, 1.0
    if at_once < COMPLETE:
        return now, later
    first = int(np.floor(samples + ABOUT[-1]))
    newest = [_later(np.diff(angle, DIFFERENCES), first - i) for i in range(min(first, AHEAD))]
    for share in samples + ABOUT:
        smooth = _later(_between(angle, share - np.floor(share)), int(np.floor(share)))
        beside = [*regression, *_lags(smooth)]
        moved, rounded = _unexplained(beside), _unexplained([*beside, *newest, *_lags(step * np.rint(smooth / step))])
        if moved and rounded is not None:
            later = min(later, rounded / moved)
    return now, later


def _regular(log: JointLog, period: float) -> tuple[Array, Array]:
    """Angle [rad] and command [N m] (N,) at every period of the log; NaN where a sample or its command is missing."""
    assert log.commands is not None
    columns = np.full((2, round(log.duration / period) + 1), np.nan)
    for column, signals, name in zip(columns, (log.measured, log.commands), ("q", "external_torque"), strict=True):
        late = signals.time - log.measured.time[0]
        sample = np.rint(late / period).astype(np.intp)
        there = (np.abs(late - sample * period) < ON_TIME * period) & (sample >= 0) & (sample < len(column))
        column[sample[there]] = signals[name][there]
    return columns[0], columns[1]


def _between(angle: Array, share: float) -> Array:
    """(N,) [rad] of the polynomial about every sample, `share` of a sample later; NaN at the ends."""
    half = WINDOW // 2
    weights = savgol_coeffs(WINDOW, DEGREE, pos=half + share, use="dot")
    smooth = np.convolve(angle, weights[::-1], "same")
    smooth[:half] = smooth[-half:] = np.nan
    return smooth


def _later(values: Array, samples: int) -> Array:
    """(N,) values shifted by some samples, forward in time if positive; NaN beyond the ends."""
    at = np.arange(len(values)) + samples
    inside = (at >= 0) & (at < len(values))
    return np.where(inside, values[np.clip(at, 0, len(values) - 1)], np.nan)


def _lags(angle: Array) -> list[Array]:
    """Third differences of an angle at the lags that a controller uses."""
    moved = np.diff(angle, DIFFERENCES)
    return [_later(moved, -lag) for lag in LAGS]


def _unexplained(columns: Sequence[Array]) -> float | None:
    """Residual share of the square of the first column, each half fitted on the other. None: too few samples."""
    table = np.column_stack(columns)
    table = table[np.isfinite(table).all(axis=1)][:MOST]
    if len(table) < LEAST:
        return None
    half, left = len(table) // 2, 0.0
    for fitted, held in ((table[:half], table[half:]), (table[half:], table[:half])):
        weights = np.linalg.lstsq(fitted[:, 1:], fitted[:, 0], rcond=None)[0]
        left += float(np.sum((held[:, 0] - held[:, 1:] @ weights) ** 2))
    return left / max(float(table[:, 0] @ table[:, 0]), 1e-300)
