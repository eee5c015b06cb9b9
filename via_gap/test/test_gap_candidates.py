"""Fits of single causes from poor starts, and what the screen proposes."""

from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
import pytest
from gap_logs import antagonistic_log, flexible, log_of, rigid, servo
from gap_models import evaluated
from scipy.optimize import lsq_linear
from via_core.devices import Device
from via_core.signals import Signals
from via_gap.candidates.bounds import bounds_of
from via_gap.candidates.converged import converged
from via_gap.candidates.covariance import clustered_covariance, clusters, covariance_of
from via_gap.candidates.fit import Fit, fit_device_parameters
from via_gap.candidates.location import Location, locations
from via_gap.candidates.refinement import fit_on, member_slopes, refine
from via_gap.candidates.scales import Scales, scales_of
from via_gap.candidates.screen import REACH, Direction, _Screen, directions, ranked, ranked_pairs
from via_gap.candidates.starts import amount_range, starts
from via_gap.report.causes import cause_of
from via_gap.residual.nuisance import BOUND
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import cut_log
from via_sim.catalogue.starts import Start
from via_sim.effects import Effect

MAXWELL = Effect("hysteresis", "transmission", {"torque": 0.03, "stiffness": 0.6}, 1)
CLIPPED = Effect("torque_saturation", "motor", {"limit": 0.5}, 1)
DAMPED = Effect("spring_damping", "transmission", {"coefficient": 0.05}, 1)


@cache
def searched(name: str) -> tuple[ResidualModel, Fit, np.ndarray, Scales]:
    device, effect, duration = {
        "flexible": (flexible(), MAXWELL, 6.0),
        "servo": (servo(), DAMPED, 12.0),
        "rigid": (rigid(), CLIPPED, 6.0),
    }[name]
    return fitted(device, effect, duration)


def fitted(device: Device, effect: Effect, duration: float) -> tuple[ResidualModel, Fit, np.ndarray, Scales]:
    segments = cut_log(log_of(device, (effect,), seed=7, duration=duration, tolerance=0.0))
    problem = ResidualModel.of([segments], [np.arange(1, len(segments))])
    base, jacobian = based(problem)
    scales = scales_of([segments], [None])
    return problem, base, jacobian, scales


def based(problem: ResidualModel) -> tuple[Fit, np.ndarray]:
    """The device's own numbers, and the Jacobian of the nuisances there."""
    base = fit_device_parameters(problem)
    return base, problem.nuisance_jacobian((), base.offsets, base.residual)


@pytest.mark.parametrize(("name", "effect"), [("flexible", MAXWELL), ("servo", DAMPED), ("rigid", CLIPPED)])
def test_the_screen_puts_the_cause_first(name, effect):
    problem, base, jacobian, scales = searched(name)
    tried = directions(problem, base, locations(problem.device, problem.views[0].segments.log), scales)
    _, location, _ = ranked(base, jacobian, tried)[0]
    assert location == Location(effect.name, effect.site, effect.motor)


@pytest.mark.parametrize(
    ("name", "effect", "start"),
    [("flexible", MAXWELL, (0.06, 1.2)), ("servo", DAMPED, (0.005,))],
    ids=["slip", "damper"],
)
def test_a_fit_finds_the_planted_numbers_from_a_poor_start(name, effect, start):
    problem, base, jacobian, scales = searched(name)
    members = [(Location(effect.name, effect.site, effect.motor), start)]
    fit = refine(problem, base, members, scales, jacobian=jacobian)
    planted = problem.residual([problem.row([effect])])[0]
    assert fit is not None and fit.loss < 1.001 * (planted @ planted)  # the device's numbers are the file's
    # Beside servos all torques may grow in one proportion.
    off = 1.1 * BOUND * problem.device.tolerances.spring if name == "servo" else 0.01
    assert dict(fit.effects[0].parameters) == pytest.approx(dict(effect.parameters), rel=off)


@pytest.mark.parametrize("offset", [-0.004, 0.17, 0.6, 2.9, 3.4])
def test_the_screen_reaches_offsets_of_any_size(offset):
    """A rigid joint feels an offset through gravity alone, and hardly: sin(q - offset)."""
    effect = Effect("encoder_offset", "sensor", {"offset": offset})
    problem, base, jacobian, scales = fitted(rigid(), effect, 6.0)
    location = Location(effect.name, effect.site, effect.motor)
    _, first, values = ranked(base, jacobian, directions(problem, base, [location], scales))[0]
    assert first == location and values == pytest.approx([offset], rel=0.25)


def test_a_second_cause_shows_once_the_first_gives_way():
    """A wall is found where the encoder, which is off, shows it: with the offset known it stands elsewhere."""
    wall = Effect("contact", "environment", {"angle": 0.4, "stiffness": 3.0, "damping": 0.02, "side": 1.0})
    offset = Effect("encoder_offset", "sensor", {"offset": 0.02})
    # On this motion an offset of the preset or of the other encoder is no near tie.
    segments = cut_log(log_of(flexible(), (wall, offset), seed=8, duration=6.0, tolerance=0.0))
    problem = ResidualModel.of([segments], [np.arange(1, len(segments))])
    base, jacobian = based(problem)
    scales = scales_of([segments], [None])
    members = [(Location("contact", "environment", 0), [*wall.parameters.values()])]
    first = refine(problem, base, members, scales, jacobian=jacobian)
    beside = problem.nuisance_jacobian(first.effects, first.offsets, first.residual)
    candidates = [each for each in locations(problem.device, segments.log) if each not in first.locations]
    tried = directions(problem, first, candidates, scales)
    at_rest, giving_way = (ranked(first, beside, tried, s) for s in (None, member_slopes(problem, first, scales)))
    assert giving_way[0][1] == Location("encoder_offset", "sensor", 0) != at_rest[0][1]


def test_pairs_that_are_asked_for_one_by_one_come_in_the_order_of_all():
    """Every candidate of a joint with friction and backlash, some with two directions, some without any influence."""
    log = log_of(flexible(), (Effect("coulomb_friction", "motor", {"torque": 0.03}, 1),), seed=8, duration=6.0)
    segments = cut_log(log)
    problem = ResidualModel.of([segments], [np.flatnonzero(segments.valid)])
    base = fit_device_parameters(problem)
    jacobian = problem.nuisance_jacobian((), base.offsets, base.residual)
    scales = scales_of([segments], [None])
    tried = directions(problem, base, locations(problem.device, log), scales)
    assert len({each.moved.shape[1] for each in tried}) > 1
    screen = _Screen.of(base, jacobian, tried)
    apart = [
        pair
        for pair in combinations(screen.best_starts(), 2)
        if not tried[pair[0]].location.overlaps(tried[pair[1]].location)
    ]
    slow = [screen.predicted(pair) for pair in apart]
    assert all(screen.least_losses(apart) <= [loss for loss, _ in slow])
    assert list(ranked_pairs(base, jacobian, tried)) == sorted(slow, key=lambda each: each[0])


def test_all_pairs_are_compared_where_the_best_single_cause_is_in_neither():
    """Of three directions the third is nearly the sum of the others; against least squares in bounds, one by one."""
    rng = np.random.default_rng(5)
    jacobian, one, two = rng.normal(size=(60, 2)), rng.normal(size=60), rng.normal(size=60)
    moved = {"coulomb_friction": one, "quadratic_drag": two, "viscous_friction": one + two + 0.1 * rng.normal(size=60)}
    parameter = {name: "torque" if name == "coulomb_friction" else "coefficient" for name in moved}
    tried = [
        Direction(Location(name, "link", 0), Start(({parameter[name]: 0.1},), (parameter[name],)), each[:, None])
        for name, each in moved.items()
    ]
    residual = -(1.5 * one + 1.2 * two) + 0.01 * rng.normal(size=60)
    base = Fit((), np.zeros(2), float(residual @ residual), residual, np.empty((0, 0)))
    assert ranked(base, jacobian, tried)[0][1].name == "viscous_friction"
    pairs = list(ranked_pairs(base, jacobian, tried))
    assert {location.name for location, _ in pairs[0][1]} == {"coulomb_friction", "quadratic_drag"}
    assert [value for _, (value,) in pairs[0][1]] == pytest.approx([0.15, 0.12], abs=0.01)
    for loss, members in pairs:
        whole = np.hstack([jacobian, *(moved[location.name][:, None] for location, _ in members)])
        prior = np.eye(2, whole.shape[1])
        reach = [
            amount_range(each.location, each.start, REACH)
            for location, _ in members
            for each in tried
            if each.location == location
        ]
        low, high = ([sign * BOUND] * 2 + [ends[i][0] for ends in reach] for i, sign in ((0, -1.0), (1, 1.0)))
        best = lsq_linear(np.vstack([whole, prior]), -np.r_[residual, 0.0, 0.0], (low, high), tol=1e-14)
        assert loss == pytest.approx(2.0 * best.cost, rel=1e-6)


def test_what_no_torque_on_record_tells_is_known_as_well_as_the_device_file_says():
    """Beside servos inertia, friction, springs and the effect may grow in one proportion, and nothing shows."""
    problem, base, _, scales = searched("servo")
    location = Location(DAMPED.name, DAMPED.site, DAMPED.motor)
    led_astray = Fit((), 0.8 * BOUND * np.sign(base.offsets), 0.0, base.residual, base.covariance)
    fit = refine(problem, led_astray, [(location, (0.06,))], scales)
    end = converged(problem, fit, scales)
    proportional = [each.tolerance for each in problem.nuisances if "bandwidth" not in each.name]
    # at `fit`, where the derivatives are taken
    factors = [1.0 + n.tolerance * d for n, d in zip(problem.nuisances, fit.offsets) if "bandwidth" not in n.name]
    known = fit.values[0] / np.sqrt(sum((factor / t) ** 2 for factor, t in zip(factors, proportional)))
    planted, (value,) = DAMPED.parameters["coefficient"], end.effects[0].parameters.values()
    likely = problem.at_likely_starts(problem.row(fit.effects, fit.offsets))
    assert fit_on(likely, end).loss <= fit_on(likely, fit).loss
    low, high = bounds_of(location, scales)  # beside the device file, the range of the effect is known
    least = 1.0 / np.hypot(1.0 / known, 1.0 / float(high[0] - low[0]))
    assert least < 1.0001 * end.sd[0] < 1.3 * least  # more than `least` by a trade with friction beside it
    assert abs(value - planted) < 0.5 * end.sd[0]


@pytest.mark.parametrize("astray", [-1.0, 0.9, BOUND])
def test_gravity_of_the_file_and_a_payload_are_one_sum_in_the_final_fit(astray):
    """Wherever on this line the search ended, the filed gravity is kept, and its tolerance is in the interval."""
    device, moment = rigid(), 0.3 * 0.4
    problem, base, _, scales = fitted(device, Effect("payload", "link", {"mass": 0.3, "distance": 0.4}), 6.0)
    gravity, location = [n.name for n in problem.nuisances].index("gravity torque"), Location("payload", "link", 0)
    off = device.tolerances.gravity * device.link.gravity_torque / 9.81  # [kg m] per sd of the filed gravity
    offsets = np.zeros(len(problem.nuisances))
    offsets[gravity] = astray
    weight = moment - astray * off
    mass = weight**2 / (0.3 * 0.4**2)  # the same inertia
    effect = location.effect({"mass": mass, "distance": weight / mass})
    begin = Fit((effect,), offsets, 0.0, base.residual, np.eye(2))
    fit = converged(problem, fit_on(problem, begin), scales)
    mass, distance = fit.values
    assert fit.offsets[gravity] == 0.0 and mass * distance == pytest.approx(moment, rel=0.01)
    along = np.array([distance, mass])
    assert off < np.sqrt(along @ fit.covariance @ along) < 1.1 * off


@pytest.mark.parametrize(("device", "unit"), [(rigid(), "N m"), (servo(), "rad/s")], ids=["torque", "servo"])
def test_a_limit_is_stated_in_the_unit_it_has_on_the_device(device, unit):
    limit = Location("torque_saturation", "motor", 1)
    model, scales = evaluated(np.full(40, 1.0), limit), searched("rigid")[3]
    assert cause_of(device, limit, model, scales, model).parameters["limit"].unit == unit


def test_a_few_segments_that_nothing_explains_do_not_move_a_fit():
    """Someone takes hold of the joint three times: squares alone are off by many standard deviations."""
    planted = Effect("coulomb_friction", "motor", {"torque": 0.03}, 1)
    log = log_of(flexible(), (planted,), seed=9, duration=10.0, tolerance=0.0)
    held = {name: values.copy() for name, values in log.measured.channels.items()}
    for begin in (2100, 5200, 7700):
        bump = 0.01 * np.sin(np.linspace(0.0, np.pi, 300)) ** 2
        held["q"][begin : begin + 300] += bump
        held["theta"][begin : begin + 300, 0] += bump
    disturbed = replace(log, measured=Signals(log.measured.time, held, log.measured.units))
    segments = cut_log(disturbed)
    problem = ResidualModel.of([segments], [np.arange(1, len(segments))])
    base = fit_device_parameters(problem)
    scales = scales_of([segments], [None])
    place = Location("coulomb_friction", "motor", 1)
    plain = refine(problem, base, [(place, [0.02])], scales)
    fit = refine(replace(problem, robust=True), plain, [(place, plain.values)], scales)
    assert abs(plain.values[0] - 0.03) > 4.0 * abs(fit.values[0] - 0.03)
    assert fit.values[0] == pytest.approx(0.03, abs=2.0 * max(fit.sd[0], 1e-5))
    assert fit.values[0] == pytest.approx(0.03, rel=0.02)


def test_errors_that_blocks_share_are_counted_once():
    """Of a mean of blocks whose values all err alike, the variance is that of the blocks: n times the naive one."""
    problem = searched("flexible")[0]
    neighbours = clusters(problem)[0]
    blocks = neighbours[problem.segment_of_value()]
    rng = np.random.default_rng(4)
    slopes = np.ones((problem.size, 1))
    error = rng.normal(size=blocks[-1] + 1)[blocks]
    found = clustered_covariance(problem, neighbours, slopes, error, slopes.T @ slopes, 0)
    sums, count = np.bincount(blocks, weights=error), blocks[-1] + 1
    assert found[0, 0] == pytest.approx(count / (count - 1) * np.sum(sums**2) / problem.size**2, rel=1e-6)
    alone = rng.normal(size=problem.size)
    independent = clustered_covariance(problem, neighbours, slopes, alone, slopes.T @ slopes, 0)
    assert independent[0, 0] == pytest.approx(1.0 / problem.size, rel=1.0)
    assert found[0, 0] > 50.0 * independent[0, 0]
    beside = np.hstack([slopes, np.zeros((problem.size, 1))])  # a parameter on which nothing depends
    both = clustered_covariance(problem, neighbours, beside, error, beside.T @ beside, 0)
    assert both == pytest.approx(np.diag([found[0, 0], 0.0]))


def test_a_parameter_that_nothing_depends_on_is_known_to_its_bounds():
    slopes = np.random.default_rng(1).normal(size=(50, 3))
    slopes[:, 2] = 0.0
    sd = np.sqrt(np.diag(covariance_of(slopes.T @ slopes, np.diag([1e-12, 7.0**-2.0]), 1)))
    assert sd[0] == pytest.approx(np.sqrt(np.linalg.inv(slopes[:, :2].T @ slopes[:, :2])[1, 1]), rel=1e-6)
    assert sd[1] == pytest.approx(7.0)


def test_a_hardening_begins_at_a_tenth_of_the_torque_of_a_spring_under_pretension():
    """Both springs of the joint stay taut, and their deflections vary much less than they are on average."""
    planted = Effect("spring_law", "transmission", {"scale": 1.0, "hardening": 0.1}, 2)
    segments = cut_log(antagonistic_log((planted,)))
    problem = ResidualModel.of([segments], [np.arange(1, len(segments))])
    base, jacobian = based(problem)
    scales = scales_of([segments], [None])
    deflection = segments.start[:, 0] - segments.start[:, 1]
    assert scales.stretch == pytest.approx(np.sqrt(np.mean(deflection**2)), rel=1e-6)
    assert scales.stretch > 2.0 * scales.deflection
    location = Location.of(planted)
    (start,) = starts(location, scales, problem.device)
    assert start.directions[1]["hardening"] == pytest.approx(0.1 / scales.stretch**2)
    _, _, (_, hardening) = ranked(base, jacobian, directions(problem, base, [location], scales))[0]
    assert hardening == pytest.approx(0.1, rel=0.2)  # twice as much from a start relative to the standard deviation


def test_gravity_can_be_absent_but_not_reversed():
    """A drive that compensates more than gravity, by its integral action for example, is no error of gravity."""
    location = Location("gravity_error", "link", 0)
    problem, _base, _, scales = fitted(rigid(), Effect("gravity_error", "link", {"torque": 0.0, "angle": 0.0}), 3.0)
    filed = problem.device.link.gravity_torque
    (least, turned_back), (_, turned) = bounds_of(location, scales)
    assert -least == pytest.approx(filed * (1.0 + BOUND * problem.device.tolerances.gravity))
    assert turned == -turned_back == pytest.approx(np.pi / 2.0)
    level, _ = bounds_of(location, replace(scales, gravity=np.inf))  # without gravity any direction may be its own
    assert level[0] < -filed and level[1] == pytest.approx(-np.pi)
