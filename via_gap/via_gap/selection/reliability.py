"""How often an answer of each kind is right, as the development cases of the sealed benchmark showed.

    probability of a cause = reliability of the verdict * share of the cause among the models compared

The counts are those of `via gap blind calibrate`; with r of n answers right the reliability is (r + 1/2) / (n + 1),
the mean of Jeffreys' posterior, so that a kind of answer that was never wrong is not certain.
"""

from __future__ import annotations

from functools import cache
from importlib import resources

import yaml
from pydantic import BaseModel, ConfigDict


class Counts(BaseModel):
    """Answers of one verdict, and in how many of them the first cause was right."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    answers: int
    right: int


@cache
def shipped() -> dict[str, Counts]:
    """Verdict -> counts, from `reliability.yaml`."""
    text = resources.files("via_gap.selection").joinpath("reliability.yaml").read_text(encoding="utf-8")
    return {verdict: Counts.model_validate(counts) for verdict, counts in yaml.safe_load(text)["verdicts"].items()}


def reliability(verdict: str) -> float:
    """Probability that the first cause of an answer of this verdict is right; 1 for verdicts without causes."""
    counts = shipped().get(verdict)
    return 1.0 if counts is None else (counts.right + 0.5) / (counts.answers + 1.0)
