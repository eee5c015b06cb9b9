"""The bound: a flexible torque explains what has no name, invents nothing, and simulates as it was fitted."""

from dataclasses import replace

import numpy as np
import pytest
from gap_logs import flexible as joint
from gap_logs import log_of, positioned, rigid, servo
from via_core.signals import Signals
from via_gap.candidates.fit import Fit, fit_device_parameters
from via_gap.logs.log import JointLog
from via_gap.residual.errors import Errors, free_errors
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import Segments, cut_log
from via_gap.selection.basis import MEMORIES, Basis, ticks_of
from via_gap.selection.bound import Flexible, flexible, solved
from via_gap.selection.evidence import evaluate
from via_gap.selection.gap import _gap
from via_gap.selection.holdout import split
from via_sim.effects import Effect
from via_sim.joint.layout import GOAL
from via_sim.plants import JointPlant
from via_sim.simulate import simulate

DRAG = Effect("quadratic_drag", "link", {"coefficient": 0.01})


def prepared(device, effects, duration=12.0) -> tuple[ResidualModel, ResidualModel, Fit, Segments]:
    segments = cut_log(log_of(device, effects, seed=31, duration=duration))
    train, held, everything = split([segments], [])
    fitted, evaluated = ResidualModel.of(everything, train), ResidualModel.of(everything, held)
    return fitted, evaluated, fit_device_parameters(fitted), segments


@pytest.fixture(name="dragged", scope="module")
def _dragged() -> tuple[ResidualModel, ResidualModel, Fit, Segments, Flexible]:
    """A joint with drag, and the flexible torque found for it."""
    fitted, evaluated, base, segments = prepared(joint(), (DRAG,), 20.0)
    return fitted, evaluated, base, segments, flexible(fitted, base)


def test_a_flexible_torque_explains_a_gap_without_knowing_its_name(dragged):
    _, evaluated, base, _, model = dragged
    (left,) = evaluate(evaluated, [base])
    reached = float(np.mean(model.residual(evaluated, model.functions(evaluated)) ** 2))
    assert reached < 1e-3 * left.mean_square


def test_it_finds_nothing_where_there_is_nothing():
    fitted, evaluated, base, _ = prepared(joint(), ())
    model = flexible(fitted, base)
    reached = float(np.mean(model.residual(evaluated, model.functions(evaluated)) ** 2))
    assert 0.8 < reached < 1.3


def test_the_torque_found_is_the_one_that_is_missing(dragged):
    fitted, _, _, segments, model = dragged
    (values,) = model.functions(fitted)
    torque = (values @ model.weights.T)[:, 0]
    speed = segments.start[:: ticks_of(segments), 3]
    missing = -0.01 * speed * np.abs(speed)
    fast = np.abs(speed) > 1.0  # elsewhere the tuned viscous friction has taken some of it
    assert np.corrcoef(torque[fast], missing[fast])[0, 1] > 0.9


def test_a_joint_of_servos_is_run_freely_with_it():
    device = servo()
    damped = Effect("viscous_friction", "link", {"coefficient": 0.05})
    fitted, evaluated, base, segments = prepared(device, (damped, DRAG), 24.0)
    model = flexible(fitted, replace(base, offsets=np.zeros_like(base.offsets)))
    held = [view.chosen for view in evaluated.views]
    plain = free_errors(device, (), [segments], held)
    reached = free_errors(device, (), [model.driven(segments)], held)
    assert reached.overall < 0.5 * plain.overall


def test_the_bound_is_the_lesser_of_both_and_not_below_the_floor():
    def errors(*sizes: float) -> Errors:
        squares = np.array([sizes, sizes]) ** 2
        return Errors(("q", "theta_1", "x"), squares, np.ones(3), np.full(3, 0.01))

    three = [errors(1.0, 1.0, 1.0), errors(0.8, 0.6, 0.4), errors(0.5, 0.2, 0.01)]
    gap = _gap("segments", three, np.array([0.4, 0.3, 0.02]))
    bounds = [each.bound for each in gap.signals.values()]
    assert bounds == pytest.approx([0.4, 0.2, 0.1])
    assert gap.bound == pytest.approx(np.sqrt(np.mean(np.square(bounds))))
    assert gap.explained == pytest.approx((gap.before - gap.after) / (gap.before - gap.bound))
    assert (gap.before, gap.signals["q"].explained) == pytest.approx((1.0, 0.5 / 0.6))


def test_what_a_torque_may_depend_on_is_finite_where_nothing_moves():
    segments = cut_log(log_of(joint(), (), seed=31, duration=12.0))
    knots = np.zeros((5, 7)) + 1e-12 * np.arange(7)
    still = Basis(np.zeros(5), np.full(5, 1e-9), knots, knots[0], 12.0, (0,))
    assert np.isfinite(still.values(segments)).all()
    assert Basis.of([segments]).values(segments).shape[0] == -(-len(segments.start) // ticks_of(segments))


@pytest.mark.parametrize("friction", ["damping", "tight spot"])
def test_friction_that_differs_along_the_way_is_in_reach(friction):
    """Otherwise it would count as not explainable, and what imitates a part of it as its cause."""
    segments = cut_log(log_of(joint(), (), seed=31, duration=40.0))
    state = segments.start[:: ticks_of(segments)]
    angle, speed = state[:, 0], state[:, 3]
    spot = np.exp(-(((angle - 0.25) / 0.35) ** 2))
    torque = angle**2 * speed if friction == "damping" else spot * np.tanh(speed / 0.1)
    values = Basis.of([segments]).values(segments)
    known = (np.arange(len(angle)) // 500) % 2 == 0
    normal = values[known].T @ values[known] + 1e-6 * np.eye(values.shape[1])
    left = torque - values @ np.linalg.solve(normal, values[known].T @ torque[known])
    assert np.std(left[~known]) < 0.3 * np.std(torque[~known])


def goals_log(rate: float = 500.0) -> JointLog:
    device = positioned()
    device = device.model_copy(update={"sensors": device.sensors.model_copy(update={"rate": rate})})
    time = np.arange(round(20.0 * rate)) / rate
    goal = 0.8 * np.sign(np.sin(2.0 * time)) + 0.3 * np.sin(0.7 * time)
    commands = Signals(time, {"equilibrium": goal}, {"equilibrium": "rad"}, frozenset({"equilibrium"}))
    run = simulate(JointPlant.from_device(device), commands, 20.0, rate)
    return JointLog("run", device, run.measured.select(["q"]), commands)


@pytest.mark.parametrize("memory", MEMORIES)
@pytest.mark.parametrize("rate", [500.0, 190.0])
def test_an_integral_fades_over_the_same_time_at_any_rate(memory, rate):
    segments = cut_log(goals_log(rate))
    basis, every = Basis.of([segments]), ticks_of(segments)
    step = every / segments.rate
    error = (segments.commands[:, GOAL] - segments.start[:, 0])[::every] / basis.scale[0]
    expected = [error[0]]
    for each in error[1:]:
        expected.append(expected[-1] + (each - expected[-1]) * -np.expm1(-step / memory))
    off = np.abs(basis.values(segments) - np.array(expected)[:, None]).max(axis=0)
    assert np.count_nonzero(off < 1e-9) == 1


def test_the_integral_of_the_error_of_a_position_drive_is_in_reach():
    """Integral action is outside the catalogue: without it in reach, what imitates a part of it would be its cause."""
    segments = cut_log(goals_log())
    values, every = Basis.of([segments]).values(segments), ticks_of(segments)
    error = (segments.commands[:, GOAL] - segments.start[:, 0])[::every]
    torque = np.cumsum(error) * every / segments.rate
    known = (np.arange(len(torque)) // 250) % 2 == 0
    normal = values[known].T @ values[known] + 1e-6 * np.eye(values.shape[1])
    left = torque - values @ np.linalg.solve(normal, values[known].T @ torque[known])
    assert np.std(left[~known]) < 0.1 * np.std(torque[~known])


def test_a_torque_that_repeats_along_the_way_is_found_by_its_waves():
    ripple = Effect("torque_ripple", "motor", {"amplitude": 0.02, "order": 9.0, "phase": 0.3}, 1)
    fitted, evaluated, base, segments = prepared(joint(), (ripple,), 20.0)
    model = flexible(fitted, base)
    assert 9 in {wave.order for wave in model.basis.waves}
    (left,) = evaluate(evaluated, [base])
    reached = float(np.mean(model.residual(evaluated, model.functions(evaluated)) ** 2))
    assert reached < 0.05 * left.mean_square
    assert Basis.of([segments]).waves == ()


def test_functions_that_a_log_cannot_tell_apart_are_solved_for():
    """A normal matrix with eigenvalues that rounding has made negative: finite, and the plain solution where it is."""
    rng = np.random.default_rng(0)
    half = rng.normal(size=(400, 60))
    columns = np.hstack([half, half @ rng.normal(size=(60, 60))])
    normal, pull = columns.T @ columns, columns.T @ rng.normal(size=400)
    plain = np.linalg.solve(normal + 1e-3 * np.diag(np.diag(normal)), pull)
    assert solved(normal, pull, 1e-3) == pytest.approx(plain, rel=1e-6, abs=1e-9)
    negative = normal - 1e-9 * np.abs(normal).max() * np.eye(120)
    assert np.linalg.eigvalsh(negative)[0] < 0.0
    assert np.isfinite(solved(negative, pull, 1e-10)).all()


@pytest.mark.parametrize("effects", [(), (DRAG,)], ids=["no gap", "a gap"])
def test_a_few_gross_outliers_do_not_move_the_bound(effects):
    """Pushed in three of the fitted segments, each by thousands of standard deviations: by squares, the torque of every
    segment would follow."""
    fitted, evaluated, base, segments = prepared(joint(), effects, 20.0)
    chosen = fitted.views[0].chosen
    measured = segments.measured.copy()
    measured[chosen[[5, 17, 29]]] += 0.1 * np.linspace(0.0, 1.0, measured.shape[1])[:, None] ** 2
    pushed = replace(segments, measured=measured)

    def reached(of: Segments, robust: bool) -> float:
        model = flexible(ResidualModel.of([of], [chosen], robust=robust), base)
        return float(np.mean(model.residual(evaluated, model.functions(evaluated)) ** 2))

    if effects:
        assert reached(pushed, True) < 0.05 * evaluate(evaluated, [base])[0].mean_square
        return
    assert reached(pushed, True) == pytest.approx(reached(segments, True), rel=0.05)
    assert reached(pushed, False) > 100.0


def test_a_kink_is_in_reach_and_segments_without_it_stay_explained():
    """A wall at .3 rad: with wide hats, or a ridge chosen by squares, segments away from it would get worse."""
    wall = Effect("contact", "environment", {"angle": 0.3, "stiffness": 3.0, "damping": 0.1, "side": 1.0})
    fitted, evaluated, base, _ = prepared(rigid(), (wall,), 16.0)
    model = flexible(replace(fitted, robust=True), base)
    (left,) = evaluate(evaluated, [base])
    reached = evaluated.per_segment(model.residual(evaluated, model.functions(evaluated)))
    assert np.mean(reached) < 0.01 * left.mean_square
    assert np.mean(np.log1p(reached)) < left.score - 4.0
