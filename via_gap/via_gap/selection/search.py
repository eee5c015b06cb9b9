"""The search for causes: single effects, then effects added one by one as long as they help.

Everything is tried on few segments first (`subset`), and only what comes near the best is fitted to all of them. What
effects do to a residual is simulated once, for all of them, and used again when a second one is sought: beside another
effect it does much the same, so that it says which few are worth a simulation of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from via_core.signals import Array

from via_gap.candidates.fit import Fit, events, member_slopes, refine
from via_gap.candidates.location import Location
from via_gap.candidates.scales import KEPT_ORDERS, Scales
from via_gap.candidates.screen import Direction, Members, directions, ranked, ranked_pairs
from via_gap.candidates.subset import subset
from via_gap.residual.residual_model import ResidualModel
from via_gap.selection.calibration import Calibration
from via_gap.selection.evidence import Evaluation
from via_gap.selection.verdict import helps, rms

Progress = Callable[[str, float], None]  # what is being done, share of the whole [0..1]
Judge = Callable[[Sequence[Fit]], list[Evaluation]]  # fits, all or the best, on data they were not fitted to
REFINED = 9  # candidates that are fitted
REFINED_SECOND = 4
REFINED_SERVO = 10  # fewer places, and published models of servos lack more than one thing
REFINED_FREE = 7  # where every fit is judged by several more
AGAIN = 2  # times as many are simulated beside the effect they are to join
HOPE = 0.5  # share of the gain asked of a set on held-out segments, that one must reach on those it is fitted to
PAIRS = 4  # of all that are fitted
ALIKE = 1.1  # times the predicted loss of a richer effect: the plainer one does
ABREAST = 4.0  # times the best loss: no further off may a fit be that only its start led astray
EXCHANGED = 0.9  # times the loss, below which one effect in the place of another counts
EXCHANGES = 2
MOST = 4  # effects that are added one by one
RIVAL = 0.3  # score within which a second single cause is tried as the first of a pair
NEAR = 30.0  # times the best predicted loss: candidates beyond it are not refined
CLOSE, CLOSEST = 2.0, 3  # times the best loss on few segments, and how many at least: these are fitted to all segments
CLOSE_SECOND, CLOSEST_SECOND = 1.3, 2
ELSEWHERE = 1.5  # times what is left on few segments: more on all of them is left where the few do not look
RIPPLE = "torque_ripple"
ORDERS = tuple(float(each) for each in range(2, 61))  # periods per turn at which a ripple is looked for as the second
PLAINER = {  # of effects that hold another: its name, and the parameters whose mean is where it starts
    "asymmetric_coulomb": ("coulomb_friction", (0, 1)),
    "stribeck_friction": ("coulomb_friction", (1,)),
    "presliding_friction": ("coulomb_friction", (0,)),
    "asymmetric_viscous": ("viscous_friction", (0, 1)),
}
FINISHING = 6  # rounds from the best on few segments to the best on all


@dataclass(frozen=True, eq=False)
class Search:
    """What to fit, all segments and few, and how to judge; what `base`, the device's own numbers, leaves of both."""

    whole: ResidualModel
    few: ResidualModel
    judge: Judge
    base: Fit
    start: Fit  # base on few segments
    jacobian: Array  # (R, J) of base on few segments
    tried: list[Direction]
    candidates: tuple[Location, ...]
    scales: Scales
    crossed: bool  # whether `judge` fits again

    @staticmethod
    def of(
        whole: ResidualModel,
        judge: Judge,
        base: Fit,
        jacobian: Array,
        candidates: Sequence[Location],
        scales: Scales,
        crossed: bool = False,
    ) -> Search:
        """Simulates every effect at every place."""
        few, which = subset(whole, base.residual)
        start = base if few is whole else _on(few, base)
        tried = directions(few, start, candidates, scales)
        return Search(whole, few, judge, base, start, jacobian[which], tried, tuple(candidates), scales, crossed)

    @property
    def refined(self) -> int:
        """Candidates to join others that are fitted."""
        if self.whole.device.drive == "torque":
            return REFINED_SECOND
        return REFINED_FREE if self.crossed else REFINED_SERVO

    def single(self, tell: Progress) -> list[Evaluation]:
        """The best candidates, fitted and judged, best held-out score first."""
        fits: list[Fit] = []
        best = 0.0
        most = REFINED_FREE if self.crossed else REFINED
        hopeful = ranked(self.start, self.jacobian, self.tried)[:most]
        for number, (loss, location, values) in enumerate(hopeful):
            if loss > NEAR * max(hopeful[0][0], 1.0 * self.few.size) and number > 2:
                break
            tell(f"fitting {location}", 0.25 + 0.2 * number / REFINED)
            fit = refine(self.few, self.start, self.jacobian, [(location, values)], self.scales, best)
            if fit is not None:
                fits.append(fit)
                best = min(best, fit.loss) if best else fit.loss
        tell("fitting the best", 0.45)
        if fits:
            there = {fit.locations for fit in fits}
            fits += [fit for fit in self._plain(min(fits, key=lambda fit: fit.loss)) if fit.locations not in there]
        return sorted(self.judge(self._finished(fits, CLOSE, CLOSEST)), key=lambda each: each.score)

    def more(
        self, causes: list[Evaluation], frozen: Calibration, tell: Progress, at_events: bool = False
    ) -> tuple[list[Evaluation], list[Evaluation]]:
        """Effects added one by one to the best so far, as long as they help -> (single causes, pairs and larger sets).

        at_events  it ends where one that begins or ends at a time of the run has helped

        Of every set that helps, each member is also left out and the rest fitted again: a single cause whose fit had
        not found its way alone comes out of it as good as the pair, and the pair is dropped.
        """
        sets: list[Evaluation] = []
        leaders = causes[:1]
        if causes and not causes[0].free:
            others = [each for each in causes if _kind(each.fit.locations) != _kind(causes[0].fit.locations)]
            leaders = leaders + [each for each in others[:1] if each.score < causes[0].score + RIVAL]
        while leaders and len(leaders[0].fit.effects) < MOST:
            single = len(leaders[0].fit.effects) == 1
            if leaders[0].mean_square <= (frozen.enough if single else frozen.explained):
                break
            here = self._seeing(leaders[0].fit)
            if single:
                here = here._reordered(leaders[0].fit)
            fits: list[Fit] = []
            for number, first in enumerate(leaders):
                tell(f"adding to {first.fit.locations[-1]}", 0.55 + 0.1 * number)
                fits += here._joined(first.fit, min((fit.loss for fit in fits), default=0.0))
            if single:
                fits += here._pairs(fits)
            if fits:
                fits += here._exchanged(min(fits, key=lambda fit: fit.loss), frozen.explained)
            if not fits or not here._worth(min(fits, key=lambda fit: fit.loss), leaders, causes[0], frozen):
                break
            fits = here._finished(fits, CLOSE_SECOND, CLOSEST_SECOND)
            fits += here._abreast(fits, frozen.explained)
            fits += here._plainer(closest(fits))
            found = sorted(self.judge(fits), key=lambda each: each.mean_square)
            best, before = found[0], min(leaders, key=lambda each: each.mean_square)
            if not helps(best, before, causes[0], frozen):
                break
            again = self.judge(here._shorter(best.fit, [each.fit.locations for each in leaders]))
            (causes if len(best.fit.effects) == 2 else sets).extend(again)
            if any(rms(each) - rms(best) < frozen.second_gain * rms(causes[0]) for each in again):
                break
            sets.extend(found)
            if at_events and events(best.fit):
                break
            leaders = [best]
        return _best_of_each(causes), sorted(sets, key=lambda each: each.score)

    def events(self, fit: Fit, every: ResidualModel) -> tuple[float, ...]:
        """When what `fit` names begins and ends [s since the run began], sought in `every` segment there is."""
        found = refine(every, fit, None, _members(fit), self.scales, rounds=FINISHING) if events(fit) else None
        return events(found or fit)

    def _seeing(self, fit: Fit) -> Search:
        """The same on other few segments, where what `fit` leaves is in segments that these few do not hold."""
        if self.few is self.whole:
            return self
        left = _on(self.whole, fit).residual
        if float(np.mean(left**2)) < ELSEWHERE * float(np.mean(_on(self.few, fit).residual ** 2)):
            return self
        few, _ = subset(self.whole, left)
        start = _on(few, self.base)
        jacobian = few.nuisance_jacobian(start.effects, start.deviations, start.residual)
        tried = directions(few, start, self.candidates, self.scales)
        return replace(self, few=few, start=start, jacobian=jacobian, tried=tried)

    def _reordered(self, fit: Fit) -> Search:
        """The same with the orders of ripple that show in what `fit` leaves: the first cause may have hidden them."""
        of_ripple = [location for location in self.candidates if location.name == RIPPLE]
        here = _on(self.few, fit)
        jacobian = self.few.nuisance_jacobian(here.effects, here.deviations, here.residual)
        orders, tried = list(self.scales.orders), [each for each in self.tried if each.location.name != RIPPLE]
        for location in of_ripple:
            each = directions(self.few, self.start, [location], replace(self.scales, orders=(ORDERS,) * len(orders)))
            best = sorted(each, key=lambda one: ranked(here, jacobian, [one])[0][0])[:KEPT_ORDERS]
            orders[location.motor] = tuple(one.start.directions[0]["order"] for one in best) or orders[location.motor]
            tried += best
        return replace(self, scales=replace(self.scales, orders=tuple(orders)), tried=tried)

    def _worth(self, larger: Fit, leaders: Sequence[Evaluation], single: Evaluation, frozen: Calibration) -> bool:
        """Whether a set closes on the few segments it was fitted to part of what it would have to on others."""
        smaller, alone = min([self._left(each.fit) for each in leaders]), self._left(single.fit)
        return smaller - self._left(larger) >= HOPE * frozen.second_gain * alone

    def _left(self, fit: Fit) -> float:
        """Root mean square whitened error beyond the noise on the few segments."""
        residual = _on(self.few, fit).residual
        return float(np.sqrt(max(float(np.mean(self.few.per_segment(residual))) - 1.0, 0.0)))

    def _joined(self, first: Fit, rival: float) -> list[Fit]:
        """Fits on few segments of `first` with one effect more."""
        refined = self.refined
        here = _on(self.few, first)
        jacobian = self.few.nuisance_jacobian(here.effects, here.deviations, here.residual)
        slopes = member_slopes(self.few, here, self.scales)
        known = [each for each in self.tried if each.location not in first.locations]
        hopeful = [location for _, location, _ in ranked(here, jacobian, known, slopes)[: AGAIN * refined]]
        fits = []
        beside = directions(self.few, here, hopeful, self.scales)
        for _, location, values in ranked(here, jacobian, beside, slopes)[:refined]:
            fit = refine(self.few, here, jacobian, [*_members(first), (location, values)], self.scales, rival)
            if fit is not None:
                fits.append(fit)
                rival = min(rival, fit.loss) if rival else fit.loss
        return fits

    def _pairs(self, there: Sequence[Fit]) -> list[Fit]:
        """Fits on few segments of the two effects that would leave least if they added up, but for those `there`.

        Two effects often show together as a third that is neither, which then is the best single cause: whatever joins
        it, this is no way to the two. What all effects do is known, so that all pairs can be compared at once, as
        subsets of a linear regression: G. M. Furnival, R. W. Wilson, Regressions by leaps and bounds (1974).
        """
        kinds: dict[frozenset[Location], tuple[float, Members]] = {}
        for loss, members in ranked_pairs(self.start, self.jacobian, self.tried):
            kind = _kind([location for location, _ in members])
            known = kinds.get(kind)
            if known is None or (loss < ALIKE * known[0] and _size(members) < _size(known[1])):
                kinds[kind] = (loss, members)
        found: list[Fit] = []
        seen = {frozenset(fit.locations) for fit in there}
        rival = min((fit.loss for fit in there), default=0.0)
        for _, members in [each for kind, each in kinds.items() if len(kind) == 2][:PAIRS]:
            fit = None
            if frozenset(location for location, _ in members) not in seen:
                fit = refine(self.few, self.start, self.jacobian, members, self.scales, rival)
            if fit is not None:
                found.append(fit)
                rival = min(rival, fit.loss) if rival else fit.loss
        return found

    def _exchanged(self, fit: Fit, enough: float) -> list[Fit]:
        """Fits on few segments with others in the place of older effects of `fit`, as long as one leaves less.

        Where effects do not add up, a wrong one is given back once another is there. Sequential replacement:
        A. Miller, Subset Selection in Regression, 2nd ed. (2002), section 3.4.

        enough  mean squared whitened error up to which nothing is sought in the place of anything
        """
        found: list[Fit] = []
        older, turns = list(fit.locations[:-1]), 0
        while older and turns < EXCHANGES and float(np.mean(self.few.per_segment(fit.residual))) > enough:
            out = older.pop(0)
            rest = refine(self.few, fit, None, [each for each in _members(fit) if each[0] != out], self.scales)
            joined = [] if rest is None else self._joined(rest, fit.loss)
            found += joined
            best = min(joined, key=lambda each: each.loss, default=fit)
            if best.loss < EXCHANGED * fit.loss:
                fit, older, turns = best, list(best.locations[:-1]), turns + 1
        return found

    def _abreast(self, fits: Sequence[Fit], enough: float) -> list[Fit]:
        """Those near the best that differ from it in one effect, fitted again from where the best ended.

        A fit may end in a minimum of its own (a motor falls into the next dip of its ripple), and which of two sets
        that share an effect had better luck with it says nothing about the others.

        enough  as of `_exchanged`
        """
        found: list[Fit] = []
        best = None
        while best is not (best := closest([*fits, *found])) and len(found) < EXCHANGES:
            if float(np.mean(self.whole.per_segment(_on(self.whole, best).residual))) <= enough:
                break
            shared = dict(_members(best))
            for fit in [*fits, *found]:
                alike = len(fit.locations) == len(shared) == len(shared.keys() & set(fit.locations)) + 1
                if alike and len(fit.residual) == len(best.residual) and fit.loss < ABREAST * best.loss:
                    members = [(location, shared.get(location, values)) for location, values in _members(fit)]
                    again = refine(self.whole, best, None, members, self.scales, rounds=FINISHING)
                    found += [again] if again is not None and again.loss < fit.loss else []
        return found

    def _plainer(self, fit: Fit) -> list[Fit]:
        """What `_plain` finds, fitted to all segments."""
        found = self._plain(fit)
        return self._finished(found, np.inf, len(found))

    def _plain(self, fit: Fit) -> list[Fit]:
        """The same with one member replaced by the plainer effect it contains, which few starts may have hidden."""
        found = []
        for number, (location, values) in enumerate(_members(fit)):
            if location.name in PLAINER:
                name, which = PLAINER[location.name]
                members = _members(fit)
                members[number] = (
                    Location(name, location.site, location.motor),
                    [float(np.mean([values[i] for i in which]))],
                )
                plain = refine(self.few, fit, None, members, self.scales)
                if plain is not None:
                    found.append(plain)
        return found

    def _shorter(self, fit: Fit, known: Sequence[tuple[Location, ...]]) -> list[Fit]:
        """Every effect left out in turn, the rest fitted again; the newest only where the rest is none of `known`."""
        found = []
        for left_out in range(len(fit.effects)):
            members = _members(fit)
            del members[left_out]
            if left_out == len(members) and fit.locations[:-1] in known:
                continue
            shorter = refine(self.few, fit, None, members, self.scales)
            if shorter is not None:
                found.append(shorter)
        return self._finished(found, np.inf, len(found))

    def _finished(self, fits: Sequence[Fit], close: float, closest: int) -> list[Fit]:
        """Those near the best fitted to all segments, the others as they are."""
        if self.few is self.whole:
            return list(fits)
        order = sorted(fits, key=lambda fit: fit.loss)
        done = []
        for number, fit in enumerate(order):
            best = None
            if number < closest or fit.loss < close * order[0].loss:
                best = refine(self.whole, fit, None, _members(fit), self.scales, rounds=FINISHING)
            done.append(best or fit)
        return done


def _kind(locations: Sequence[Location]) -> frozenset[Location]:
    """The places, those of effects that contain a plainer one as of that."""
    return frozenset(replace(location, name=PLAINER.get(location.name, (location.name,))[0]) for location in locations)


def _size(members: Members) -> int:
    """Number of parameters."""
    return sum(len(values) for _, values in members)


def closest(fits: Sequence[Fit]) -> Fit:
    """The best of those fitted to the most segments: what is left of few segments is less, whatever the fit."""
    return min(fits, key=lambda fit: (-len(fit.residual), fit.loss))


def _on(problem: ResidualModel, fit: Fit) -> Fit:
    """A fit as it stands on the segments of `problem`."""
    residual = problem.residual([problem.row(fit.effects, fit.deviations)])[0]
    loss = float(residual @ residual + fit.deviations @ fit.deviations)
    return Fit(fit.effects, fit.deviations, loss, residual, fit.sd)


def _members(fit: Fit) -> Members:
    return [(p, list(e.parameters.values())) for p, e in zip(fit.locations, fit.effects, strict=True)]


def _best_of_each(causes: Sequence[Evaluation]) -> list[Evaluation]:
    """The best fit of every place, best score first."""
    best: dict[tuple[Location, ...], Evaluation] = {}
    for each in causes:
        if each.fit.locations not in best or each.score < best[each.fit.locations].score:
            best[each.fit.locations] = each
    return sorted(best.values(), key=lambda each: each.score)
