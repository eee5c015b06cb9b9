"""Covariance of fitted parameters: from the curvature of the loss, scores of blocks of segments, and unknown delays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from via_core.signals import Array, Indices

from via_gap.candidates.location import Location
from via_gap.logs.between import LATE_SD, STEPS_SD, period_of
from via_gap.residual.quantities import quantities
from via_gap.residual.residual_model import ResidualModel

CLUSTERS = 30  # blocks of neighbouring segments, whose errors may be correlated
KINDS = 4  # quarters of the segments by a quantity of their motion, in which a model may err differently


def covariance_of(normal: Array, prior: Array, first: int) -> Array:
    """(p, p) of the parameters from `first` on, over their typical sizes, with the information (p, p) of a prior."""
    informed = normal.copy()
    informed[first:, first:] += prior
    return _inverse(informed)[first:, first:]


def _inverse(normal: Array) -> Array:
    scale = np.sqrt(np.diag(normal))
    scale = np.where(scale > 0.0, scale, 1.0)  # a parameter that nothing depends on
    both = np.outer(scale, scale)
    return np.asarray(np.linalg.inv(normal / both + 1e-14 * np.eye(len(normal))) / both)


def in_units(covariance: Array, sd: Array, size: Array) -> Array:
    """(p, p) in units of the parameters, rescaled to the standard deviations `sd` (p,) over their typical sizes."""
    own = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    return np.asarray(covariance * np.outer(sd * size / own, sd * size / own))


def delay_sd(problem: ResidualModel, locations: Sequence[Location]) -> Array:
    """(p,) standard deviation of a delay or lead by what is not known of the commands between samples; 0 for others.

    The motion shows the sum of the delay of commands, the lag of the drive, and the delay of a single encoder's stamps.
    Whether a log contains every command is not known: one of many commands, held until the next, acts late by up to
    half a period on average. A goal that leads looks like commands that are lines, and lines like steps that lead.
    """
    segments = problem.views[0].segments
    late = {"actuator_delay", "actuator_lag"} | ({"channel_skew"} if len(segments.axes) == 1 else set())
    period, lined = period_of(segments.log), segments.log.lined
    sd = STEPS_SD * period
    if lined is not None:  # what is left of half a period; nothing if torques were shifted forward
        left = STEPS_SD * (period - 2.0 * lined) if lined >= 0.0 else 0.0
        sd = max(left, LATE_SD * period)
    sds = dict.fromkeys(late, sd)
    servo = problem.device.servo
    if servo is not None and servo.kd > 0.0:
        sds["velocity_feedforward"] = STEPS_SD * period_of(segments.log) * servo.kp / servo.kd
    return np.array([sds.get(location.name, 0.0) for location in locations for _ in location.parameters])


def unfitted_delay_sd(problem: ResidualModel, locations: Sequence[Location]) -> Array:
    """(p,) the same without the delay of a position drive, whose sum with that of its goals was fitted.

    Effects that only resemble a delay keep theirs: the fit moves goals by less than half a sample.
    """
    fitted = {"actuator_delay"} if problem.delays.any() else set()
    own = [location.name not in fitted for location in locations for _ in location.parameters]
    return np.where(own, delay_sd(problem, locations), 0.0)


def clusters(problem: ResidualModel) -> list[Indices]:
    """Divisions of the segments, (S,) indices each: neighbours, and quarters by each quantity of their motion.

    Neighbours share errors that do not repeat with the motion. An error of the model repeats with the motion, and grows
    with the speed or the angle; so parameters that are right in one quarter differ from those of another.
    """
    count = problem.segment_of_value()[-1] + 1
    found = [np.arange(count) // max(1, count // CLUSTERS)]
    for values in quantities(problem.views).values():
        rank = np.searchsorted(np.sort(values), values, side="right") - 1  # equal values are in one quarter
        found.append(rank * KINDS // count)
    return found


def clustered_covariance(
    problem: ResidualModel, cluster: Indices, slopes: Array, residual: Array, normal: Array, first: int
) -> Array:
    """(p, p) covariance that is valid for any correlation of the errors inside a cluster (S,) of segments.

    With the score g_b = J_b' r_b of each of n clusters and the normal matrix N:
        N^-1 (n / (n - 1) sum g_b g_b' + prior) N^-1
    0 for parameters without influence.
    Source: K.-Y. Liang, S. L. Zeger, Longitudinal data analysis using generalized linear models, Biometrika 73 (1986);
    n / (n - 1) since the sum of all scores is 0.
    """
    segment = problem.segment_of_value()
    starts = np.flatnonzero(np.diff(segment, prepend=-1))
    scores = np.zeros((cluster.max() + 1, slopes.shape[1]))
    of_segments = np.add.reduceat(slopes * residual[:, None], starts, axis=0)
    np.add.at(scores, cluster[segment[starts]], of_segments)
    count = len(np.unique(cluster))
    meat = scores.T @ scores * count / max(count - 1, 1)
    meat[range(first), range(first)] += 1.0
    seen = np.flatnonzero(np.diag(normal) > 0.0)
    inside = np.ix_(seen, seen)
    found, bread = np.zeros_like(normal), _inverse(normal[inside] + 1e-12 * np.diag(np.diag(normal)[seen]))
    found[inside] = bread @ meat[inside] @ bread
    return found[first:, first:]
