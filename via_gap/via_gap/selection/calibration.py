"""The frozen numbers of `calibration.yaml`."""

from __future__ import annotations

from functools import cache
from importlib import resources

import yaml
from pydantic import BaseModel, ConfigDict


class Calibration(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    version: int
    no_gap: float
    no_gap_gain: float
    explained: float
    explained_share: float
    explained_most: float
    explained_nearly: float
    typical: float
    slight: float
    near: float
    second_gain: float
    last_gain: float
    enough: float
    significance: float
    margin: float
    temperature: float
    largest_set: int
    parsimony: float
    rare: dict[str, float]


@cache
def calibration(arrangement: str) -> Calibration:
    """The numbers that ship, for a device of this arrangement."""
    text = resources.files("via_gap.selection").joinpath("calibration.yaml").read_text(encoding="utf-8")
    content = yaml.safe_load(text)
    return Calibration.model_validate(content | {"rare": content["rare"].get(arrangement, {})})
