"""Search for causes: effects are added and exchanged as long as that improves the model on held-out data.

    none -> one -> two ...        each step: add the best, exchange earlier ones, try without each of them

A linear prediction (screen.py) gives the amount from which a candidate starts. Candidates are ranked by their loss
after one step. The best are fitted to a subset of the segments, and those near the best fit to all segments. Which
model is the answer is decided afterwards (verdict.py).

Source: sequential floating forward selection, P. Pudil, J. Novovicova, J. Kittler, Floating search methods in feature
selection, Pattern Recognition Letters 15 (1994); all pairs at once as subsets of a linear regression, G. M. Furnival,
R. W. Wilson, Regressions by leaps and bounds, Technometrics 16 (1974).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from via_gap.candidates.candidate_set import CandidateSet
from via_gap.candidates.fit import Fit, Members
from via_gap.candidates.further_terms import richer
from via_gap.candidates.location import Location
from via_gap.candidates.refinement import FINISHING, Budget, fit_on, member_slopes, raced, refine, refine_all
from via_gap.candidates.scales import Scales
from via_gap.candidates.screen import Direction, directions, other_starts, ranked, ranked_pairs
from via_gap.candidates.subset import subset
from via_gap.residual.residual_model import ResidualModel
from via_gap.selection.evidence import Evaluation, plainer, simplest
from via_gap.selection.plausibility import absurd
from via_gap.selection.verdict import improvable, relevant

Progress = Callable[[str, float], None]  # what is being done, share of the whole [0..1]
Evaluate = Callable[[Sequence[Fit]], list[Evaluation]]  # fits on held-out data
Supported = Callable[[Evaluation], bool]  # whether a model may be named

FITTED = 9  # candidates
FITTED_NEXT = 4  # beside other effects
FITTED_WHOLE = 7  # for runs over whole recordings, where the evaluation of a fit needs several more fits
PAIRS = 4  # best pairs that are fitted
RACED = 3  # times as many candidates beside other effects, and pairs, take a first step
PREDICTED = 2  # best ones of the linear prediction that are fitted in any case
FIRST = Budget(rounds=1)
CLOSE = 2.0  # times the best loss on the subset: fits below it are fitted to all segments
CLOSEST = 4  # fits to all segments at least
EXCHANGED = 0.9  # times the loss, below which another effect replaces an earlier one
MOST = 4  # effects


@dataclass(frozen=True, eq=False)
class Search:
    """Residual models of all segments (`whole`) and of a subset (`few`), and the simulated candidates.

    tuned     evaluation of the device parameters alone
    start     their fit on the subset, with the Jacobian (R, J) of the nuisances there
    tried     changes of the residual of `start` by every start of every candidate
    """

    whole: ResidualModel
    few: ResidualModel
    evaluate: Evaluate
    supported: Supported
    tuned: Evaluation
    start: Fit
    jacobian: np.ndarray
    tried: list[Direction]
    candidates: CandidateSet

    @staticmethod
    def of(
        whole: ResidualModel, evaluate: Evaluate, supported: Supported, tuned: Evaluation,
        candidates: CandidateSet,
    ) -> Search:  # fmt: skip
        """Simulates every candidate once."""
        few = subset(whole.by_squares, tuned.fit.residual)[0]
        search = Search(whole, few, evaluate, supported, tuned, tuned.fit, np.empty(0), [], candidates)
        return search._beside(tuned.fit)

    @property
    def scales(self) -> Scales:
        """Typical sizes in these logs."""
        return self.candidates.scales

    def run(self, progress: Progress, most: int = MOST) -> list[Evaluation]:
        """Every model evaluated, of at most `most` effects."""
        models: dict[frozenset[Location], Evaluation] = {}
        current = self.tuned
        while len(current.fit.effects) < most and improvable(current, self.tuned):
            size = len(current.fit.effects)
            progress("trying every effect" if size == 0 else f"beside {current.fit.locations[-1]}", 0.2 + 0.15 * size)
            here = self if size == 0 else self._beside(current.fit)
            found = self._evaluated(here._finished(here._extended(current.fit)), models)
            step = simplest(found) if found else current
            if len(step.fit.effects) > size > 0:  # a smaller model may fit better from there than it did alone
                self._evaluated(here._reduced(step.fit), models)
            if not _relevant_anywhere(step, current, self.tuned):
                break
            current = step  # what is not significantly better yet may become so with one more
        return list(models.values())

    def _evaluated(self, fits: Sequence[Fit], models: dict[frozenset[Location], Evaluation]) -> list[Evaluation]:
        """Held-out evaluations of those `fits` that may be named; `models` keeps one for each set of locations.

        Further terms and orders do not change what is named, so a better fit is enough for them (`plainer`).
        """
        found = [each for each in self.evaluate(fits) if self.supported(each)]
        for each in found:
            kind = frozenset(each.fit.locations)
            models[kind] = plainer(models[kind], each) if kind in models else each
        return found

    def _beside(self, fit: Fit) -> Search:
        """The same with a subset that contains the largest errors of `fit`, and candidates simulated there."""
        left = fit_on(self.whole, fit).residual if fit is not self.tuned.fit else fit.residual
        few = subset(self.whole.by_squares, left)[0]
        start = fit_on(few, self.tuned.fit)
        jacobian = few.nuisance_jacobian(start.effects, start.offsets, start.residual)
        tried = directions(few, start, self.candidates.locations, self.scales)
        return replace(self, few=few, start=start, jacobian=jacobian, tried=tried)

    def _extended(self, fit: Fit) -> list[Fit]:
        """Fits on the subset with one more effect; beside one effect also pairs; earlier effects are exchanged."""
        fits = self._joined(fit)
        if len(fit.effects) == 1:
            fits += self._pairs(fits)
        if fits and fit.effects:
            fits += self._exchanged(min(fits, key=lambda each: each.loss))
        fits += self._reshaped(fits)
        return fits + self._plainer(fits)

    def _joined(self, fit: Fit, rival: float = 0.0) -> list[Fit]:
        """Fits on the subset of the effects of `fit` and one of the best-ranked candidates."""
        here = fit_on(self.few, fit)
        most = FITTED_WHOLE if self.tuned.whole else FITTED_NEXT if fit.effects else FITTED
        jacobian, hopeful = self.jacobian, ranked(self.start, self.jacobian, self.tried)
        if fit.effects:
            jacobian = self.few.nuisance_jacobian(here.effects, here.offsets, here.residual)
            slopes = member_slopes(self.few, here, self.scales)
            known = [each for each in self.tried if not any(map(each.location.overlaps, fit.locations))]
            near = [location for _, location, _ in ranked(here, jacobian, known, slopes)[: RACED * FITTED_NEXT]]
            hopeful = ranked(here, jacobian, directions(self.few, here, near, self.scales), slopes)
        members = [[*fit.members, (location, values)] for _, location, values in hopeful]
        return self._raced(here, members, jacobian, most, rival)

    def _raced(
        self, base: Fit, candidates: Sequence[Members], jacobian: np.ndarray, most: int, rival: float = 0.0
    ) -> list[Fit]:
        """Fits on the subset of the best `most` of some candidates, after one step of each from `base`.

        candidates  ordered by a linear prediction of their loss

        Far from a model that explains the motion, the prediction ranks them wrongly; one step shows by how much. Where
        device parameters are far from their values, so does the step: the best predictions are fitted as well.
        """
        first = refine_all(self.few, [(base, each) for each in candidates], self.scales, FIRST, jacobian)
        begun = [each for each in first if each is not None]
        order = sorted(begun, key=lambda each: each.loss)[:most]
        chosen = (*order, *(each for each in begun[:PREDICTED] if each not in order))
        return raced(self.few, [(each, each.members) for each in chosen], self.scales, rival)

    def _pairs(self, there: Sequence[Fit]) -> list[Fit]:
        """Fits on the subset of the best-ranked pairs, except those in `there`.

        Two effects together often resemble a third one, which then is the best single cause. Adding effects to it does
        not lead to the true pair.
        """
        seen = {frozenset(fit.locations) for fit in there}
        rival = min((fit.loss for fit in there), default=0.0)
        pairs = _distinct(ranked_pairs(self.start, self.jacobian, self.tried), RACED * PAIRS)
        new = [members for members in pairs if frozenset(location for location, _ in members) not in seen]
        return self._raced(self.start, new, self.jacobian, PAIRS, rival)

    def _exchanged(self, fit: Fit) -> list[Fit]:
        """Fits on the subset with each earlier effect replaced by another one; continues from much better ones."""
        found: list[Fit] = []
        older = list(fit.locations[:-1])
        while older:
            out = older.pop(0)
            rest = refine(self.few, fit, [each for each in fit.members if each[0] != out], self.scales)
            joined = self._joined(rest, fit.loss) if rest is not None else []
            found += joined
            best = min(joined, key=lambda each: each.loss, default=fit)
            if best.loss < EXCHANGED * fit.loss:
                fit = best
        return found

    def _reshaped(self, fits: Sequence[Fit]) -> list[Fit]:
        """The best fit from the other starts of its effects, if it ended where it may not be named.

        A speed at the end of its range is no minimum of the loss, but where the way from a wrong start led.
        """
        found = []
        for best in sorted(fits, key=lambda fit: fit.loss)[:1]:
            others = other_starts(best, self.scales, self.few.device) if absurd(best, self.scales) else []
            again = refine_all(self.few, [(best, members) for members in others], self.scales)
            found += [each for each in again if each is not None]
        return found

    def _plainer(self, fits: Sequence[Fit]) -> list[Fit]:
        """The best fit with one or more members replaced by the simpler effects that they contain."""
        there = {frozenset(fit.locations) for fit in fits}
        found = []
        for best in sorted(fits, key=lambda fit: fit.loss)[:1]:
            for members in product(*(_forms(*each) for each in best.members)):
                if frozenset(each for each, _ in members) not in there:
                    plain = refine(self.few, best, list(members), self.scales)
                    found += [plain] if plain is not None else []
        return found

    def _reduced(self, fit: Fit) -> list[Fit]:
        """Fits to all segments with each effect left out."""
        fewer = [[each for each in fit.members if each[0] != out] for out in fit.locations]
        shorter = refine_all(self.whole, [(fit, members) for members in fewer], self.scales, FINISHING)
        return [each for each in shorter if each is not None]

    def _finished(self, fits: Sequence[Fit]) -> list[Fit]:
        """Plausible fits near the best of them, fitted to all segments."""
        order = sorted((fit for fit in fits if not absurd(fit, self.scales)), key=lambda fit: fit.loss)
        near = [fit for number, fit in enumerate(order) if number < CLOSEST or fit.loss < CLOSE * order[0].loss]
        found = near
        if self.few is not self.whole:
            done = refine_all(self.whole, [(fit, fit.members) for fit in near], self.scales, FINISHING)
            found = [fit for fit in done if fit is not None]
        return found + richer(self.whole, found, self.candidates.equations, self.scales)


def _relevant_anywhere(more: Evaluation, fewer: Evaluation, tuned: Evaluation) -> bool:
    """Whether a model with more effects is better by a relevant amount, on held-out or on all segments.

    A torque limit that only fitted recordings reach improves no held-out one, but a pair with it may.
    """
    return relevant(more, fewer, tuned) or relevant(more.on_all, fewer.on_all, tuned.on_all)


def _forms(location: Location, values: Sequence[float]) -> Members:
    """The effect itself, and the simpler one that it contains, if there is one."""
    own = (location, list(values))
    if location.kind.contains is None:
        return [own]
    name, which = location.kind.contains
    return [own, (replace(location, name=name), [float(np.mean([values[i] for i in which]))])]


def _distinct(pairs: Iterable[tuple[float, Members]], most: int) -> list[Members]:
    """The best pair of every two kinds of effects; an effect that contains a simpler one counts as the simpler one."""
    kinds: dict[frozenset[Location], Members] = {}
    for _, members in pairs:
        kind = frozenset(replace(p, name=p.plainest) for p, _ in members)
        if len(kind) == 2:
            kinds.setdefault(kind, members)
        if len(kinds) == most:
            break
    return list(kinds.values())
