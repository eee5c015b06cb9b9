"""Sensor errors, found in the measurements themselves, as causes in the report."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from via_gap.report.report import Cause, GapReport, Place, Value, Where
from via_gap.sensors.sensor_errors import SensorError

PROBABILITY = 0.98  # that such a finding is what it seems


def with_sensor_errors(report: GapReport, found: Sequence[SensorError]) -> GapReport:
    """The report with what the readings show: beside a cause it is a second one, where there was no gap the only one.

    An answer that names nothing stays as it is: what the readings show does not explain it.
    """
    if not found or report.verdict not in ("no_gap", "effect", "two_effects"):
        return report
    causes = tuple(_cause(report.joint, each) for each in found)
    places = tuple(Place(effect=c.effect, site=c.site, joint=c.joint, motor=c.motor) for c in causes)
    named = tuple(c for c in report.causes if _place(c) in {_key(p) for p in report.effects})
    others = tuple(c for c in report.causes if c not in named)
    count = len(named) + len(causes)
    share = 1.0 / count
    where = tuple(
        Where(joint=c.joint, site=c.site, motor=c.motor, equation="readings", share=share) for c in causes
    ) + tuple(each.model_copy(update={"share": each.share * len(named) / count}) for each in report.where)
    return report.model_copy(
        update={
            "verdict": "effect" if count == 1 else "two_effects",
            "causes": (*named, *causes, *others),
            "equivalence_set": (*report.equivalence_set, *places),
            "effects": (*report.effects, *places),
            "where": tuple(sorted(where, key=lambda each: -each.share)),
        }
    )


def _place(cause: Cause) -> tuple[str, str, int]:
    return cause.effect, cause.site, cause.motor


def _key(place: Place) -> tuple[str, str, int]:
    return place.effect, place.site, place.motor


def _cause(joint: str, found: SensorError) -> Cause:
    effect = found.effect
    unit = {"quantum": "rad", "gain": "-", "torque": "N m"}
    return Cause(
        effect=effect.name, site="sensor", joint=joint, motor=effect.motor, probability=PROBABILITY,
        parameters={n: Value(value=v, sd=found.sd[n], unit=unit[n]) for n, v in effect.parameters.items()},
        left=found.left, score=float(np.log1p(found.left)),
    )  # fmt: skip
