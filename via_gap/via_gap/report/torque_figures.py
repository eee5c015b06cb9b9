"""Missing torque of every equation before and after a repair: against angle, speed and time, and its order spectrum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import log, pi, sqrt

import numpy as np
from via_core.errors import SignalError
from via_core.signals import Array
from via_sim.catalogue import EFFECTS

from via_gap.candidates.fit import Fit
from via_gap.candidates.location import Location
from via_gap.candidates.scales import HIGHEST_ORDER, highest_order
from via_gap.report.binning import bins_of, quantities, rms, six
from via_gap.report.figures import OrderSpectrum, ResidualBin, ResidualFigure
from via_gap.residual.inverse_dynamics import InverseDynamics
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import Segments

# Periods per turn: quarters, since gears cause fractional orders, then whole numbers (poles times slots).
LOW_ORDERS, WHOLE_ORDERS = np.arange(0.5, 12.0, 0.25), np.arange(12.0, HIGHEST_ORDER)
LEVEL = 0.05  # share of the orders at which noise alone exceeds the level


@dataclass(frozen=True, eq=False)
class MissingTorque:
    """Missing torque of one equation, window by window over all usable segments.

    axis    0 link, 1, 2 motors
    time    (N,) [s] middle of each window, since its log began
    states  (N, 6) [rad, rad/s] there; NaN: not measured
    before, after  (N,) [N m] with the device as filed, and as repaired
    floor   (N,) [N m] standard deviation that sensor noise explains
    stride  number of neighbouring windows that share samples
    """

    axis: int
    time: Array
    states: Array
    before: Array
    after: Array
    floor: Array
    stride: float

    @property
    def name(self) -> str:
        return "link" if self.axis == 0 else f"motor {self.axis}"


def missing_torques(segments: Sequence[Segments], before: Fit, after: Fit) -> tuple[MissingTorque, ...]:
    """One per equation that the recorded signals allow to evaluate; maybe none."""
    try:
        every = [np.flatnonzero(each.valid) for each in segments]
        model = ResidualModel.of(segments, every, InverseDynamics.of)
    except SignalError:
        return ()
    two = model.residual([model.row(each.effects, each.offsets) for each in (before, after)])
    columns: dict[int, list[tuple[Array, ...]]] = {}
    stride = 1.0
    for view, values in zip(model.views, model.by_view(two), strict=True):
        assert isinstance(view, InverseDynamics)
        windows, torques = view.windows, [view.torques(each) for each in values]
        span = windows.weights.shape[1]
        ticks = (view.first + span // 2).ravel()
        stride = (span - 1) / windows.stride
        for i, (axis, floor) in enumerate(zip(windows.axes, windows.floor, strict=True)):
            first, second = (each[:, i].ravel() for each in torques)
            part = (ticks / view.segments.rate, view.segments.start[ticks], first, second, np.full(len(ticks), floor))
            columns.setdefault(axis, []).append(part)
    return tuple(
        MissingTorque(axis, *map(np.concatenate, zip(*parts, strict=True)), stride=stride)  # type: ignore[misc, arg-type]
        for axis, parts in columns.items()
    )


def residual_figures(missing: Sequence[MissingTorque], n_transmissions: int) -> tuple[ResidualFigure, ...]:
    """Missing torque of every equation against speed, angles, deflection and time."""
    found = []
    for each in missing:
        for by, (unit, values) in quantities(each.states, each.time, each.axis, n_transmissions).items():
            along = np.sign(each.states[:, 3 + each.axis]) if by == "speed" else np.ones(len(values))
            bins = tuple(
                ResidualBin(
                    low=six(low), high=six(high), centre=six(np.median(values[inside])),
                    before=six(float(np.mean((each.before * along)[inside]))),
                    after=six(float(np.mean((each.after * along)[inside]))),
                    before_rms=rms(each.before[inside]), after_rms=rms(each.after[inside]),
                    floor=rms(each.floor[inside]),
                )
                for low, high, inside in bins_of(by, values)
            )  # fmt: skip
            found.append(ResidualFigure(equation=each.name, by=by, unit=unit, bins=bins))
    return tuple(found)


def periodic(locations: Sequence[Location]) -> bool:
    """Whether one of the effects is periodic in an angle."""
    return any(p.name.startswith("phase") for each in locations for p in EFFECTS[each.name].parameters)


def order_spectra(missing: Sequence[MissingTorque]) -> tuple[OrderSpectrum, ...]:
    """Order spectrum of every equation whose axis was measured and turned far enough for one order."""
    found = []
    for each in missing:
        angle = each.states[:, each.axis]
        if not np.isfinite(angle).all():
            continue
        turns = float(np.ptp(angle)) / (2.0 * pi)
        highest = highest_order(angle)
        orders = np.concatenate([LOW_ORDERS, WHOLE_ORDERS[highest >= WHOLE_ORDERS]])
        orders = orders[orders * turns >= 1.0]
        if not len(orders) or len(angle) < 4:
            continue
        before, after = amplitudes(angle, np.stack([each.before, each.after], axis=1), orders)
        independent = max(len(angle) / each.stride, 1.0)
        # Amplitudes of white noise are Rayleigh distributed: P(a > x) = exp(-x^2 n / (4 sd^2)).
        level = rms(each.floor) * sqrt(-4.0 * log(LEVEL) / independent)
        found.append(
            OrderSpectrum(
                equation=each.name, orders=tuple(map(six, orders)), before=tuple(map(six, before)),
                after=tuple(map(six, after)), level=six(level), turns=six(turns),
            )
        )  # fmt: skip
    return tuple(found)


def amplitudes(angle: Array, values: Array, orders: Array) -> Array:
    """(c, K) amplitudes of values (N, c) as constant + a sin(order angle) + b cos(order angle), one order at a time."""
    found = np.empty((values.shape[1], len(orders)))
    for k, order in enumerate(orders):
        waves = np.stack([np.ones_like(angle), np.sin(order * angle), np.cos(order * angle)], axis=1)
        coefficients = np.linalg.lstsq(waves, values, rcond=None)[0]
        found[:, k] = np.hypot(coefficients[1], coefficients[2])
    return found
