"""Fits of candidates' effects together with the device parameters, by Gauss-Newton steps, many side by side.

Steps stay inside the bounds. A line search on the simulation accepts only points with a lower loss. One fit alone
simulates few rows at a time, and most lanes of a block would be idle. Independent fits therefore take their steps
together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from via_core.signals import Array, Mask

from via_gap.candidates.fit import Axes, Fit, Members, Point
from via_gap.candidates.scales import Scales
from via_gap.residual.residual_model import Asks, ResidualModel

ROUNDS = 14
SHARES = (1.0, 0.25)  # of a step, tried at once; damping does the rest
DONE = 2e-3  # share of the loss: after a step that gains less, the Jacobian is renewed or the fit ends
AGED = 0.3  # share of the loss at which the nuisance Jacobian was computed: below it, the Jacobian is renewed
STALE = 0.9  # the same, below which a fit does not end on this Jacobian
TIME_STEPS = (0.1, 0.03, 0.01, 0.003, 0.001, 0.0003, 0.0001)  # of the log's duration
LAST_STEPS = 3  # of these, once times are nearly right
MOST_DAMPED = 1.0  # of the curvature of each parameter: a step that is damped more and does not help is the last
GIVE_UP = 4.0  # times the best loss so far
SLOW = 0.3  # of the loss: only a fit that gains less in a step is given up


@dataclass(frozen=True)
class Budget:
    """Effort of one fit: the largest number of Gauss-Newton steps."""

    rounds: int = ROUNDS


FINISHING = Budget(rounds=6)  # from the best fit on a subset of the segments to the best fit on all


@dataclass(frozen=True, eq=False)
class _State:
    """Where a fit is: coordinates, weighted normal matrix of the last step, parameters without a valid neighbour."""

    axes: Axes
    here: Point
    normal: Array
    apart: Mask

    def fit(self) -> Fit:
        axes, covariance = self.axes, self.axes.covariance(self.here, self.normal)
        sd = np.minimum(np.sqrt(np.diag(covariance)), axes.high - axes.low)
        known = np.where(axes.times, TIME_STEPS[-1], np.where(self.apart | axes.fixed, 0.0, sd))
        return axes.fit(self.here, covariance, known)


_Course = tuple[_State, _State | None]  # end of a fit, and the first state in which a much better fit would end it


def fit_on(problem: ResidualModel, fit: Fit) -> Fit:
    """The same effects and device parameters, with loss and residual on the segments of `problem`."""
    residual = problem.residual([problem.row(fit.effects, fit.offsets)])[0]
    return replace(fit, loss=float(problem.loss(residual) + fit.offsets @ fit.offsets), residual=residual)


def member_slopes(problem: ResidualModel, fit: Fit, scales: Scales) -> Array:
    """(R, k) derivatives of the residual by those effect parameters of a fit on which it depends smoothly."""
    axes = Axes.of(problem, fit.members, scales)
    here = Point(axes.coordinates(fit.offsets, fit.values), fit.loss, fit.residual)
    (slopes,) = problem.answer([axes.slopes(here)])
    return slopes[:, np.isfinite(slopes[0]) & np.any(slopes != 0.0, axis=0)]


def refine(
    problem: ResidualModel,
    base: Fit,
    members: Members,
    scales: Scales,
    budget: Budget = Budget(),
    jacobian: Array | None = None,
) -> Fit | None:
    """Gauss-Newton fit of the effects `members` (with initial values) and the nuisance parameters together.

    base      fit whose offsets are the initial ones
    jacobian  (R, J) of the nuisances at `base`; None: computed here

    None if the initial values are not valid together.
    """
    return refine_all(problem, [(base, members)], scales, budget, jacobian)[0]


def refine_all(
    problem: ResidualModel,
    starts: Sequence[tuple[Fit, Members]],
    scales: Scales,
    budget: Budget = Budget(),
    jacobian: Array | None = None,
) -> list[Fit | None]:
    """`refine` from each of some bases with members."""
    courses = [_course(Axes.of(problem, own, scales), base, own, budget, jacobian) for base, own in starts]
    return [None if each is None else each[0].fit() for each in problem.answer(courses)]


def raced(
    problem: ResidualModel, starts: Sequence[tuple[Fit, Members]], scales: Scales, rival: float = 0.0
) -> list[Fit]:
    """`refine` from each of some bases with members; slow fits end early if an earlier one is much better.

    rival  loss of the best fit so far; 0: none. Then the first fit is a rival of the others
    """
    found: list[Fit | None] = []  # fits whose earlier ones have all ended
    ended: dict[int, _Course | None] = {}

    def best() -> float:
        return min((each for each in (rival, *(fit.loss for fit in found if fit is not None)) if each), default=0.0)

    def runs(number: int) -> Asks[None]:
        base, own = starts[number]
        ended[number] = yield from _course(Axes.of(problem, own, scales), base, own, Budget(), None, best)
        while (here := len(found)) in ended:
            course = ended[here]
            found.append(None if course is None else (_given_up(course, best()) or course[0]).fit())

    for group in (range(1), range(1, len(starts))) if rival == 0.0 else (range(len(starts)),):
        problem.answer([runs(number) for number in group if number < len(starts)])
    return [fit for fit in found if fit is not None]


def _given_up(course: _Course, rival: float) -> _State | None:
    """The state in which a rival's loss ends a fit. In later states the loss is smaller, so the first one decides."""
    slow = course[1]
    return slow if slow is not None and slow.here.loss > GIVE_UP * rival > 0.0 else None


def _course(
    axes: Axes, base: Fit, members: Members, budget: Budget, jacobian: Array | None, rival: Callable[[], float] = float
) -> Asks[_Course | None]:
    """The steps of a fit, see `refine`. `rival` gives the best loss of other fits so far; 0: none."""
    many = len(axes.size)
    here = yield from axes.best([axes.coordinates(base.offsets, [value for _, values in members for value in values])])
    if not np.isfinite(here.loss):
        return None
    fresh, damping = jacobian is None, 0.0
    side = (yield from axes.nuisance_jacobian(here)) if jacobian is None else axes.free(jacobian)
    normal, since = np.eye(axes.count + many), here.loss if fresh else base.loss
    slopes, sloped = np.empty((axes.problem.size, many)), np.inf
    apart, slow = np.zeros(many, dtype=np.bool_), None
    for round_ in range(budget.rounds):
        if axes.times.any():  # small steps in later rounds: times improve with the sizes of their effects
            here = yield from axes.search_times(here, TIME_STEPS if round_ < 2 else TIME_STEPS[-LAST_STEPS:])
        if here.loss < AGED * since:
            side, fresh, since = (yield from axes.nuisance_jacobian(here)), True, here.loss
        if here.loss < sloped:
            slopes = yield from axes.slopes(here)
            apart = ~np.isfinite(slopes[0])  # no valid neighbour: a side, or a parameter at its bound
            slopes[~np.isfinite(slopes)] = 0.0
            sloped = here.loss
        normal, wanted = axes.step(here, np.hstack([side, slopes]), damping)
        tries = [here.at + share * (wanted - here.at) for share in SHARES]
        best = yield from axes.best(tries)
        gain = here.loss - best.loss
        if gain > 0.0:
            here = best
            damping *= 0.1
        if best.at is not tries[0] or gain <= 0.0:
            damping = max(10.0 * damping, 0.01)
        if slow is None and round_ >= 1 and gain < SLOW * here.loss:
            slow = _State(axes, here, normal, apart)
        if _given_up((_State(axes, here, normal, apart), slow), rival()) is not None:
            break
        if gain <= 0.0 and fresh and damping <= MOST_DAMPED:  # try a shorter step with the same derivatives
            continue
        if gain < DONE * here.loss:
            if (fresh and here.loss >= STALE * since) or len(axes.effects(here.at)) < len(members):
                break
            side, fresh, since = (yield from axes.nuisance_jacobian(here)), True, here.loss
    return _State(axes, here, normal, apart), slow
