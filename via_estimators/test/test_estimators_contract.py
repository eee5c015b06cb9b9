"""Contract tests of every estimator."""

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from via_core.devices import load_device
from via_core.errors import ParameterError, SignalError
from via_core.signals import Signals
from via_core.status import Status
from via_estimators.contract import Parameters, rows_of, summarise
from via_estimators.damping_directional import DampingDirectional, DampingDirectionalParameters
from via_estimators.damping_mixture import DampingMixture, DampingMixtureParameters
from via_estimators.damping_rls import DampingRLS, DampingRLSParameters
from via_estimators.extended_kalman import ExtendedKalman, ExtendedKalmanParameters
from via_estimators.filtered_signal_based import FilteredSignalBased, FilteredSignalBasedParameters
from via_estimators.link_impedance import LinkImpedance, LinkImpedanceParameters
from via_estimators.methods import estimator_for
from via_estimators.modulated_stiffness import ModulatedStiffness, ModulatedStiffnessParameters
from via_estimators.modulated_torque import ModulatedTorque, ModulatedTorqueParameters
from via_estimators.moving_horizon import MovingHorizon, MovingHorizonParameters
from via_estimators.residual import Residual, ResidualParameters
from via_estimators.signal_based import SignalBased, SignalBasedParameters
from via_estimators.unknown_input_observer import UnknownInputObserver, UnknownInputObserverParameters
from via_estimators.unscented_kalman import UnscentedKalman, UnscentedKalmanParameters

MACCEPA = load_device("maccepavd")
ESTIMATORS = {
    "modulated_torque, two motors": ModulatedTorque(ModulatedTorqueParameters(window=60, memory=5.0)),
    "modulated_torque, one motor": ModulatedTorque(ModulatedTorqueParameters(transmissions=1, window=60)),
    "modulated_stiffness": ModulatedStiffness(ModulatedStiffnessParameters(window=60, memory=5.0)),
    "signal_based": SignalBased(SignalBasedParameters(window=60, memory=5.0)),
    "filtered_signal_based": FilteredSignalBased(FilteredSignalBasedParameters(window=60, order=6, memory=5.0)),
    "moving_horizon, two motors": MovingHorizon(MovingHorizonParameters(window=60)),
    "moving_horizon, one motor": MovingHorizon(MovingHorizonParameters(transmissions=1, window=60, even_terms=2)),
    "unknown_input_observer": UnknownInputObserver(UnknownInputObserverParameters(window=60)),
    "extended_kalman, two motors": ExtendedKalman(ExtendedKalmanParameters(window=60)),
    "unscented_kalman, one motor": UnscentedKalman(UnscentedKalmanParameters(transmissions=1, window=60)),
    "residual": Residual(ResidualParameters(window=60, quantum=1e-4)),
    "link_impedance": LinkImpedance(
        MACCEPA.springs[0], LinkImpedanceParameters(window=60, sampling=1e-3, minimum_motion=0.02)
    ),
    "damping_directional": DampingDirectional(DampingDirectionalParameters(window=60, terms=2)),
    "damping_mixture": DampingMixture(DampingMixtureParameters(span=0.06)),
    "damping_rls": DampingRLS(DampingRLSParameters(window=60, terms=2, stability_factor=10.0)),
}


def moving_rows(estimator, count=600, period=1e-3):
    """Rows with everything in smooth motion; torques are those of some motor with some spring."""
    t = period * np.arange(count)
    values = {"q": 0.4 * np.sin(9.0 * t), "equilibrium": 0.2 * np.sin(3.0 * t), "preset": 0.5 + 0.0 * t}
    values["tau_link"] = 2.0 * np.gradient(values["q"], t)
    for i in (1, 2):
        theta = 0.5 * (-1) ** i + 0.1 * np.sin((6.0 + i) * t)
        values[f"theta_{i}"] = theta
        values[f"theta_velocity_{i}"] = np.gradient(theta, t)
        values[f"tau_{i}"] = 0.1 * np.gradient(theta, t) - 8.0 * (values["q"] - theta) ** 3
    return np.column_stack([t, *(values[name] for name in estimator.inputs)])


@pytest.fixture(params=ESTIMATORS, name="estimator")
def _estimator(request):
    return ESTIMATORS[request.param]


def all_finite(estimates):
    """Assert finite estimates and non-negative standard deviations."""
    assert np.isfinite(estimates.value).all() and np.isfinite(estimates.time).all()
    assert np.isfinite(estimates.standard_deviation).all() and np.all(estimates.standard_deviation >= 0.0)
    return estimates


def test_run_is_step_folded_bit_for_bit(estimator):
    rows = moving_rows(estimator)
    rows[300, 1] = np.nan
    rows[310, 0] = rows[309, 0]
    rows[400:, 0] += 1.0
    _, whole = estimator.run_rows(rows)
    state = estimator.init()
    for k, row in enumerate(rows):
        state, estimate = estimator.step(state, row)
        assert (estimate.time, estimate.status) == (whole.time[k], whole.status[k])
        assert np.array_equal(estimate.value, whole.value[k])
        assert np.array_equal(estimate.standard_deviation, whole.standard_deviation[k])
    assert {Status.OK, Status.WARMING_UP, Status.BAD_SAMPLE} <= set(whole.status)
    middle, first = estimator.run_rows(rows[:250])
    _, second = estimator.run_rows(rows[250:], middle)
    assert np.array_equal(np.concatenate([first.value, second.value]), whole.value)
    all_finite(whole)


def test_run_reads_signals_by_channel(estimator):
    rows = moving_rows(estimator)
    columns = dict(zip(estimator.inputs, rows[:, 1:].T, strict=True))
    channels = {name: columns[name] for name in ("q", "tau_link", "equilibrium", "preset") if name in columns}
    for name in ("theta", "theta_velocity", "tau"):
        if f"{name}_1" in columns:
            keys = [f"{name}_{i}" for i in (1, 2) if f"{name}_{i}" in columns]
            channels[name] = np.column_stack([columns[key] for key in keys])
    signals = Signals(rows[:, 0], channels, dict.fromkeys(channels, "-"))
    assert np.array_equal(rows_of(signals, estimator.inputs), rows)
    assert np.array_equal(estimator.run(signals).value, estimator.run_rows(rows)[1].value)
    without_q = signals.select([name for name in channels if name != "q"])
    with pytest.raises(SignalError, match="no values of q"):
        estimator.run(without_q)


def test_missing_signals_are_an_error_that_names_them():
    estimator = estimator_for(load_device("qbmove_a"))
    time = np.arange(100) * 1e-3
    units = {"q": "rad", "theta": "rad", "torque": "N m"}
    signals = Signals(time, {"q": 0.0 * time, "theta": np.zeros((100, 2)), "torque": np.zeros((100, 2))}, units)
    with pytest.raises(SignalError, match="no values of tau_1, tau_2; the signals are q, theta, torque"):
        estimator.run(signals)


def test_step_does_not_modify_its_state_and_states_are_locked(estimator):
    rows = moving_rows(estimator)
    state, _ = estimator.run_rows(rows[:200])
    before = state.copy()
    first = estimator.step(state, rows[200])
    again = estimator.step(state, rows[200])
    assert np.array_equal(state, before)
    assert np.array_equal(first[0], again[0]) and np.array_equal(first[1].value, again[1].value)
    assert not first[0].flags.writeable and not estimator.init().flags.writeable


def test_estimates_equal_the_prior_until_there_is_data(estimator):
    _, estimates = estimator.run_rows(moving_rows(estimator)[:50])  # less than a window
    assert np.all(estimates.status == Status.WARMING_UP)
    _, nothing = estimator.run_rows(np.full((1, 1 + len(estimator.inputs)), np.nan))
    assert nothing.status[0] == Status.BAD_SAMPLE
    for name in estimator.outputs:
        if name.startswith("stiffness"):
            continue  # follows the deflection through the prior spring law
        assert estimates.column(name)[0][-1] == nothing.column(name)[0][0]
        assert estimates.column(name)[1][-1] == nothing.column(name)[1][0]
    all_finite(nothing)


@pytest.mark.parametrize("poison", [np.nan, np.inf, -np.inf, 1e300, -1e12])
def test_samples_that_are_not_finite_are_skipped_and_the_last_value_is_repeated(estimator, poison):
    rows = moving_rows(estimator)
    rows[400, 1] = poison
    state, estimates = estimator.run_rows(rows)
    assert estimates.status[400] == Status.BAD_SAMPLE
    assert np.array_equal(estimates.value[400], estimates.value[399])
    assert estimator.health(state).bad == 1
    all_finite(estimates)
    clean = estimator.run_rows(np.delete(rows, 400, axis=0))[1]
    assert np.array_equal(np.delete(estimates.value, 400, axis=0), clean.value)


@pytest.mark.parametrize("stamp", [np.nan, np.inf])
def test_a_stamp_that_is_not_finite_is_skipped(estimator, stamp):
    rows = moving_rows(estimator)
    rows[400, 0] = stamp
    estimates = all_finite(estimator.run_rows(rows)[1])
    assert estimates.status[400] == Status.BAD_SAMPLE and estimates.time[400] == rows[399, 0]


def test_stamps_that_do_not_increase_are_skipped(estimator):
    rows = moving_rows(estimator)
    twice = np.insert(rows, 300, rows[299], axis=0)
    back = np.insert(rows, 300, rows[290], axis=0)
    for disturbed in (twice, back):
        state, estimates = estimator.run_rows(disturbed)
        assert np.flatnonzero(estimates.status == Status.BAD_SAMPLE).tolist() == [300]
        assert estimator.health(state).bad == 1
        assert np.array_equal(np.delete(estimates.value, 300, axis=0), estimator.run_rows(rows)[1].value)


def test_a_gap_or_a_clock_reset_restarts_the_window_and_keeps_the_estimate(estimator):
    rows = moving_rows(estimator)
    for shift in (2.0, -1000.0):
        moved = rows.copy()
        moved[400:, 0] += shift
        state, estimates = estimator.run_rows(moved)
        assert estimator.health(state).gaps == 1 and estimator.health(state).bad == 0
        assert np.all(estimates.status[400:460] == Status.NOT_EXCITED)
        assert estimates.status[399] in (Status.OK, Status.OUTSIDE_RANGE)
        assert estimates.status[-1] in (Status.OK, Status.OUTSIDE_RANGE)
        all_finite(estimates)


def test_standstill_is_reported_and_bounded(estimator):
    rows = moving_rows(estimator, count=8000)
    rows[600:, 1:] = rows[599, 1:]
    state, estimates = estimator.run_rows(rows)
    assert np.all(estimates.status[760:] == Status.NOT_EXCITED)
    all_finite(estimates)
    width = estimates.standard_deviation
    assert np.all(width[-1] >= 0.999 * width[760])
    prior = estimator.run_rows(np.full((1, rows.shape[1]), np.nan))[1].standard_deviation[0]
    unlike_stiffness = [k for k, name in enumerate(estimator.outputs) if not name.startswith("stiffness")]
    assert np.all(width[-1][unlike_stiffness] <= 1.5 * prior[unlike_stiffness])
    assert estimator.health(state).motion == 0.0
    assert np.isfinite(estimator.health(state).condition)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), name=st.sampled_from(sorted(ESTIMATORS)))
def test_no_input_produces_nan(seed, name):
    estimator, rng = ESTIMATORS[name], np.random.default_rng(seed)
    rows = moving_rows(estimator, count=400)
    rows[:, 1:] *= 10.0 ** rng.uniform(-3.0, 3.0, size=rows.shape[1] - 1)
    hit = rng.random(rows.shape) < 0.02
    rows[hit] = rng.choice([np.nan, np.inf, 0.0, -1e8, 1e8, 1e-300], size=hit.sum())
    rows[:, 0] += np.where(rng.random(len(rows)) < 0.01, rng.normal(size=len(rows)), 0.0)
    all_finite(estimator.run_rows(rows)[1])


def test_a_sample_of_the_wrong_width_raises(estimator):
    with pytest.raises(SignalError, match="a sample has time and q"):
        estimator.step(estimator.init(), np.zeros(2 + len(estimator.inputs)))


def test_parameters_are_frozen_and_checked(estimator):
    parameters = estimator.parameters
    for item in fields(parameters):
        assert item.metadata["description"]
        if "choices" in item.metadata:
            with pytest.raises(ParameterError, match=f"{item.name} must be one of"):
                replace(parameters, **{item.name: "of another kind"})
            continue
        low, high = item.metadata["range"]
        assert item.metadata["unit"]
        for value in (low - 1.0, high + abs(high) + 1.0, float("nan"), "text", None):
            with pytest.raises(ParameterError, match=item.name):
                replace(parameters, **{item.name: value})
        with pytest.raises(AttributeError):
            setattr(parameters, item.name, low)
    with pytest.raises(ParameterError, match="whole number"):
        replace(parameters, window=60.0)
    with pytest.raises(ParameterError, match="parameters must be"):
        estimator.with_parameters(Parameters())
    assert estimator.with_parameters(parameters) == estimator


def test_each_device_has_a_default_method():
    assert isinstance(estimator_for(load_device("cubic_demo")).inner, ModulatedTorque)
    assert isinstance(estimator_for(MACCEPA).inner, LinkImpedance)
    with pytest.raises(ParameterError, match="no method 'guess'; there are: auto, modulated_torque"):
        estimator_for(MACCEPA, "guess")
    with pytest.raises(ParameterError, match="'maccepavd' has no torque-driven transmission"):
        estimator_for(MACCEPA, "modulated_torque")
    with pytest.raises(ParameterError, match="'cubic_demo' is not driven by a position servo"):
        estimator_for(load_device("cubic_demo"), "link_impedance")
    with pytest.raises(ParameterError, match="no estimator suits 'edinburgh_vsa': antagonistic, servo drive"):
        estimator_for(load_device("edinburgh_vsa"))


def test_variance_of_the_total_is_possible_for_its_transmissions(estimator):
    if "stiffness_1" not in estimator.outputs:
        assert "stiffness_2" not in estimator.outputs
        return
    estimates = estimator.run_rows(moving_rows(estimator))[1]
    value, sd = estimates.column("stiffness")
    each = [estimates.column(name) for name in estimator.outputs if name.startswith("stiffness_")]
    np.testing.assert_allclose(value, sum(one for one, _ in each), rtol=1e-9, atol=1e-9 * np.abs(value).max())
    most = sum(one for _, one in each)
    largest = np.max([one for _, one in each], axis=0)
    assert np.all(sd <= most * (1.0 + 1e-9))
    assert np.all(sd >= (2.0 * largest - most) * (1.0 - 1e-9))


def test_a_run_is_averaged_by_information(estimator):
    _, estimates = estimator.run_rows(moving_rows(estimator))
    output = estimator.outputs[0]
    value, sd, weights = summarise(estimates, output)
    good = estimates.status == Status.OK
    values, sds = estimates.column(output)
    assert value == pytest.approx(np.average(values[good], weights=sds[good] ** -2.0))
    assert sd == sds[good].min()
    assert weights.sum() == pytest.approx(1.0) and np.all(weights[~good] == 0.0)
    _, early = estimator.run_rows(moving_rows(estimator)[:50])
    assert summarise(early, output)[:2] == (early.value[-1, 0], early.standard_deviation[-1, 0])
    with pytest.raises(SignalError, match="no output 'colour'"):
        summarise(estimates, "colour")
