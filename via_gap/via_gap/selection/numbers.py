"""The numbers that decide, read from `numbers.yaml`: each states where it comes from, docs/method.md what it does."""

from __future__ import annotations

from importlib import resources
from typing import Annotated

import yaml
from pydantic import Field
from via_core.records import Record

Share = Annotated[float, Field(gt=0.0, lt=1.0)]


class Numbers(Record):
    """See `numbers.yaml`."""

    significance: Share
    margin: Annotated[float, Field(gt=0.0)]
    no_gap: Annotated[float, Field(gt=1.0)]
    most: Share
    complete: Share
    substantial: Share
    material: Share
    remaining: Share
    largest_set: Annotated[int, Field(ge=1)]


def _shipped() -> Numbers:
    text = resources.files("via_gap.selection").joinpath("numbers.yaml").read_text(encoding="utf-8")
    return Numbers.model_validate(yaml.safe_load(text))


NUMBERS = _shipped()
