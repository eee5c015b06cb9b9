"""Reliability of each verdict, sizes of conformal sets, and widths of intervals, from answers with a known cause.

    probability of a cause = reliability of the verdict * share of the cause among the models compared

An answer that leaves much of the error is wrong more often. So the answers of a verdict are divided into groups by the
error that they leave, by isotonic regression: the share of right answers falls from group to group. With r of n answers
of a group right, the reliability is (r + 1/2) / (n + 1), the mean of Jeffreys' posterior. A verdict that was never
wrong therefore does not count as certain.

Conformal sets: the score of a cause is 1 - share. Take the scores of the true causes of n calibration cases of one
signal set whose answers name a cause, and q, their ceil((n + 1) (1 - alpha))-th smallest. The set { cause : score <= q
} contains the true cause of a further such case with probability >= 1 - alpha, whatever the quality of the shares.

Widths of intervals: no model is exact, and two right simulators of one joint differ by some tenths of a percent (steps
in time, contacts at ticks). So a named parameter has the variance

    wider^2 (sd^2 + (DISCREPANCY value)^2)

with sd from the fit, and `wider` the smallest factor with which 95 % of the true parameters of the calibration cases
with the same verdict lie inside their intervals (`via_validation.calibration` computes q and `wider`). The parameters
of a main effect compensate for what the model lacks, so its factor is larger.

Sources: R. E. Barlow et al., Statistical Inference under Order Restrictions (1972), chapter 1 (isotonic regression);
V. Vovk, A. Gammerman, G. Shafer, Algorithmic Learning in a Random World (2005), section 4.1 (split conformal).

The numbers are those of `via gap blind calibrate` on development cases. They hold for similar cases only.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from importlib import resources

import numpy as np
import yaml
from via_core.records import Record
from via_core.signals import Array

DISCREPANCY = 0.003  # of a value: below it, the intervals of exact models of a second simulator fail


class Counts(Record):
    """Answers of one verdict that leave at most `left` of the squared error, and more than those of the group before.

    right  in how many of them the first cause was right
    """

    left: float
    answers: int
    right: int


class Reliability(Record):
    """Groups of answers of each verdict, and of each signal set the least share of a cause in its conformal set.

    wider       factor of the standard deviations of named parameters of each verdict, see above
    parameters  number of true parameters of named effects of each verdict, with those that the answers lack
    """

    origin: str
    seeds: str
    verdicts: dict[str, list[Counts]]
    least_share: dict[str, float]
    cases: dict[str, int]
    wider: dict[str, float]
    parameters: dict[str, int]


def wider(verdict: str) -> float:
    """Factor of the standard deviations of named parameters."""
    return shipped().wider.get(verdict, 1.0)


def widened(values: Array, covariance: Array, verdict: str) -> Array:
    """Covariance (p, p) of named parameters with values (p,), from that of their fit; fixed parameters stay so."""
    free = np.diag(covariance) > 0.0
    discrepancy = np.where(free, DISCREPANCY * values, 0.0)
    return np.asarray(wider(verdict) ** 2 * (covariance + np.diag(discrepancy**2)))


@cache
def shipped() -> Reliability:
    """The numbers in `reliability.yaml`."""
    text = resources.files("via_gap.selection").joinpath("reliability.yaml").read_text(encoding="utf-8")
    return Reliability.model_validate(yaml.safe_load(text))


def decisive(left: float, transfer: Mapping[str, float]) -> float:
    """Squared error, relative to that of the fitted device parameters, by which answers are counted as reliable.

    left      of the first cause, on held-out data
    transfer  of a main effect in motion to which it was not fitted (transfer.py); the largest decides
    """
    return max(transfer.values(), default=left)


def reliability(verdict: str, left: float, numbers: Reliability | None = None) -> float:
    """Probability that the first cause of an answer of this verdict is right; 1 for verdicts without causes.

    left  see `decisive`
    """
    groups = (numbers or shipped()).verdicts.get(verdict)
    if not groups:
        return 1.0
    group = next((each for each in groups if left <= each.left), groups[-1])
    return (group.right + 0.5) / (group.answers + 1.0)


def in_conformal_set(shares: Sequence[float], level: str) -> tuple[bool, ...] | None:
    """Whether the cause of each share (k,) belongs to the 95 % set on logs of this signal set.

    None if no set can be stated: there were too few calibration cases of this signal set, or the true cause was often
    not compared.
    """
    least = shipped().least_share.get(level, 0.0)
    return tuple(share >= least for share in shares) if least > 0.0 else None
