"""The causes of a report: from fits that were compared, and from errors that the sensors' own measurements show."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from via_core.devices import Device

from via_gap.candidates.bounds import bounds_of
from via_gap.candidates.location import Location
from via_gap.candidates.scales import Scales
from via_gap.report.combinations import combinations
from via_gap.report.report import Cause, EffectLocation, Value
from via_gap.selection.evidence import Evaluation
from via_gap.selection.reliability import decisive, in_conformal_set, reliability
from via_gap.selection.verdict import UNNAMED, Decision, Verdict
from via_gap.sensors.sensor_errors import SensorError

SENSOR = 0.98  # probability that an error shown by a sensor's own measurements is real
SENSOR_UNITS = {"quantum": "rad", "gain": "-", "torque": "N m"}


def compared_causes(device: Device, decision: Decision, scales: Scales, tuned: Evaluation) -> tuple[Cause, ...]:
    """Every cause compared: those named, in the order of what they explain, then the others by probability."""
    compared = [(*ranked, model) for ranked, model in zip(decision.shares, decision.models, strict=True)]
    rank = {location: number for number, location in enumerate(decision.named)}
    compared.sort(key=lambda each: (rank.get(each[0], len(rank)), -each[1]))
    causes = [cause_of(device, place, model, scales, tuned) for place, _, model in compared]
    trust = reliability(decision.verdict, decisive(causes[0].left, decision.transfer)) if causes else 1.0
    without = {
        location: left / max(tuned.mean_square, 1e-12)
        for location, left in zip(decision.named, decision.without, strict=False)  # one effect has no `without`
    }
    return tuple(
        cause.model_copy(
            update={
                "share": share,
                "probability": trust * share * decision.alone(location),
                "without": without.get(location),
            }
        )
        for cause, (location, share, _) in zip(causes, compared, strict=True)
    )


def cause_of(device: Device, location: Location, model: Evaluation, scales: Scales, tuned: Evaluation) -> Cause:
    """One effect of a fitted model with its parameters and evidence; its share and probability are 0."""
    number = model.fit.locations.index(location)
    effect, fitted = model.fit.effects[number], model.fit.locations[number]
    first = sum(len(each.parameters) for each in model.fit.effects[:number])
    own = slice(first, first + len(fitted.parameters))
    values = {
        p.name: Value(
            value=effect.parameters[p.name], sd=float(np.clip(sd, 0.0, 1e12)), unit=p.unit_on(device.drive),
            low=float(low), high=float(high), neutral=p.neutral,
        )
        for p, sd, low, high in zip(fitted.parameters, model.fit.sd[own], *bounds_of(fitted, scales), strict=True)
    }  # fmt: skip
    return Cause(
        effect=effect.name, site=effect.site, joint=device.name, motor=effect.motor,  # type: ignore[arg-type]
        probability=0.0, share=0.0, parameters=values,
        combinations=combinations(effect, model.fit.covariance[own, own]),
        left=model.mean_square / max(tuned.mean_square, 1e-12), score=model.score,
    )  # fmt: skip


def sensor_causes(joint: str, errors: Sequence[SensorError]) -> tuple[Cause, ...]:
    """One cause per sensor error; each is certain by itself, so none has to share with the others."""
    return tuple(
        Cause(
            effect=each.effect.name, site="sensor", joint=joint, motor=each.effect.motor, probability=SENSOR, share=1.0,
            parameters={
                name: Value(value=value, sd=each.sd[name], unit=SENSOR_UNITS[name])
                for name, value in each.effect.parameters.items()
            },
            left=each.left, score=float(np.log1p(each.left)),
        )
        for each in errors
    )  # fmt: skip


def conformal_set(verdict: Verdict, level: str, causes: Sequence[Cause]) -> tuple[EffectLocation, ...] | None:
    """The causes that belong to the 95 % set on logs of this signal set.

    None if the answer names no cause, or no set is known.
    """
    inside = in_conformal_set([cause.share for cause in causes], level)
    if verdict in (*UNNAMED, "no_gap") or inside is None:
        return None
    return tuple(each.place for each, within in zip(causes, inside, strict=True) if within)
