"""Fits of a tied cause to predicted measurements of another one: what it cannot imitate separates the two."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from via_core.errors import ParameterError
from via_core.signals import Array
from via_sim.catalogue import EFFECTS
from via_sim.effects import Effect

from via_gap.candidates.fit import effect_or_none
from via_gap.candidates.location import Location
from via_gap.report.report import Cause
from via_gap.residual.nuisance import BOUND, descend, lowest_offsets
from via_gap.residual.residual_model import ResidualModel

FREE = 5.0  # standard deviations of a fitted parameter: prior width of the imitating cause
WIDE = 0.2  # share of a parameter's value: least prior width
STEP = 0.05  # of the prior width: finite differences
DONE = 0.02  # relative decrease of the loss that ends the fit
ROUNDS = 3  # Gauss-Newton steps at most
SHARES = (1.0, 0.3, 0.1)  # of a step, tried at once


@dataclass(frozen=True, eq=False)
class TiedCause:
    """A cause of a report with its values (p,) and the prior width of each (p,)."""

    location: Location
    values: Array
    width: Array

    @staticmethod
    def of(cause: Cause) -> TiedCause:
        parameters = [cause.parameters[p.name] for p in EFFECTS[cause.effect].parameters]
        values, sd = (np.array(column) for column in zip(*((p.value, p.sd) for p in parameters), strict=True))
        width = np.maximum(FREE * sd, WIDE * np.abs(values))
        return TiedCause(Location(cause.effect, cause.site, cause.motor), values, np.maximum(width, 1e-9))

    def effect(self) -> Effect:
        """Raises ParameterError where the report's values are not valid together."""
        made = effect_or_none(self.location, list(self.values))
        if made is None:
            raise ParameterError(f"{self.location}: the report's values make no such effect")
        return made

    def includes(self, simpler: Location) -> bool:
        """Whether a diagnosis would prefer the `simpler` effect at the same location if this one explains no more."""
        same = (self.location.site, self.location.motor) == (simpler.site, simpler.motor)
        return same and len(EFFECTS[self.location.name].parameters) > len(EFFECTS[simpler.name].parameters)

    def imitated(self, problem: ResidualModel, offsets: Array) -> Array:
        """(R,) residual of `problem` once this cause's and the device's parameters imitate what was recorded.

        offsets  (J,) of the device's parameters [sd], where the fit starts

        A prior keeps every parameter near its value in the report.
        """
        count, kind = len(offsets), EFFECTS[self.location.name].parameters
        start = np.append(offsets, np.zeros(len(kind)))
        low, high = (
            np.append(bound, (np.array(ends) - self.values) / self.width)
            for bound, ends in (
                (lowest_offsets(problem.nuisances), [p.low for p in kind]),
                (np.full(count, BOUND), [p.high for p in kind]),
            )
        )

        def row(point: Array) -> Array | None:
            effect = effect_or_none(self.location, list(self.values + point[count:] * self.width))
            return problem.row_or_none([effect], point[:count])

        at, here = start, row(start)
        assert here is not None
        residual = problem.residual([here])[0]
        for _ in range(ROUNDS):
            before = residual @ residual + (at - start) @ (at - start)
            steps = np.where(at + STEP > high, -STEP, STEP)
            rows = [row(at + step) for step in np.diag(steps)]
            moved = problem.residual([here if each is None else each for each in rows])
            slopes = (moved - residual).T / steps
            normal = slopes.T @ slopes + np.eye(len(at))
            wanted = descend(normal, slopes.T @ (slopes @ at - residual) + start, at, low, high)
            tries = [(point, row(point)) for point in (at + share * (wanted - at) for share in SHARES)]
            valid = [(point, each) for point, each in tries if each is not None]
            if not valid:
                break
            residuals = problem.residual([each for _, each in valid])
            losses = [r @ r + (p - start) @ (p - start) for (p, _), r in zip(valid, residuals, strict=True)]
            best = int(np.argmin(losses))
            if not losses[best] < before:
                break
            (at, here), residual = valid[best], residuals[best]
            if losses[best] > (1.0 - DONE) * before:
                break
        return residual
