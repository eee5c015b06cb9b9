"""Signals: locked copies, one time base, zero-order hold and interpolation, refused input."""

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from via_core.errors import SignalError, ViaError
from via_core.signals import Signals, locked


def example() -> Signals:
    return Signals(
        time=[0.0, 0.1, 0.25],
        channels={"q": [1.0, 2.0, 4.0], "theta": [[0.0, 1.0], [1.0, 3.0], [2.0, 3.0]], "preset": [5.0, 6.0, 7.0]},
        units={"q": "rad", "theta": "rad", "preset": "rad"},
        held=frozenset({"preset"}),
    )


def test_signals_are_pickled_unchanged() -> None:
    sent, came = example(), pickle.loads(pickle.dumps(example()))
    np.testing.assert_array_equal(came.time, sent.time)
    assert came.channels.keys() == sent.channels.keys()
    for name, values in sent.channels.items():
        np.testing.assert_array_equal(came[name], values)
        assert not came[name].flags.writeable
    assert (dict(came.units), came.held) == (dict(sent.units), sent.held)


def test_arrays_are_copies_and_locked() -> None:
    q = np.array([1.0, 2.0, 4.0])
    signals = Signals([0.0, 0.1, 0.25], {"q": q}, {"q": "rad"})
    q[0] = 99.0
    assert signals["q"][0] == 1.0
    for array in (signals["q"], signals.time):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0
    with pytest.raises(TypeError):
        signals.channels["new"] = q  # type: ignore[index]
    with pytest.raises(AttributeError):
        signals.time = q  # type: ignore[misc]


def test_integers_and_fortran_order_become_contiguous_floats() -> None:
    array = locked(np.asfortranarray(np.arange(6).reshape(2, 3)), "x")
    assert array.dtype == np.float64
    assert array.flags.c_contiguous and not array.flags.writeable


@pytest.mark.parametrize("values", [["1.5", "2"], [1.0, None], [1j, 2.0], [[1.0], [1.0, 2.0]], {"a": 1.0}])
def test_arrays_that_are_not_real_are_refused(values) -> None:
    with pytest.raises(SignalError, match="'x' is not"):
        locked(values, "x")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"time": [[0.0, 0.1, 0.2]]}, "one-dimensional"),
        ({"time": [0.0, np.nan, 0.2]}, "not finite at sample 1"),
        ({"time": [0.0, np.inf, 0.2]}, "not finite at sample 1"),
        ({"time": [0.0, 0.1, 0.1]}, "does not increase at sample 2"),
        ({"time": [0.0, -0.1, 0.1]}, "does not increase at sample 1"),
        ({"time": [0.0, 0.1]}, r"'q' has shape \(3,\), expected \(2,\)"),
        ({"channels": {"q": np.zeros((3, 2, 2))}}, r"shape \(3, 2, 2\)"),
        ({"channels": {"q": 1.0}}, r"shape \(\)"),
        ({"units": {}}, "without a unit: q"),
        ({"held": frozenset({"preset"})}, "no channel: preset"),
    ],
)
def test_inconsistent_signals_are_refused(change, message: str) -> None:
    good = {"time": [0.0, 0.1, 0.2], "channels": {"q": [1.0, 2.0, 3.0]}, "units": {"q": "rad"}}
    with pytest.raises(SignalError, match=message):
        Signals(**{**good, **change})


def test_errors_are_of_the_one_family_and_name_what_there_is() -> None:
    with pytest.raises(ViaError, match="no channel 'torque'; there are: preset, q, theta"):
        example()["torque"]
    assert "q" in example() and "torque" not in example()


def test_select_and_between_keep_what_they_should() -> None:
    chosen = example().select(["preset", "theta"])
    assert set(chosen.channels) == {"preset", "theta"} and chosen.held == {"preset"}
    assert chosen.units == {"preset": "rad", "theta": "rad"}
    part = example().between(0.1, 0.25)
    np.testing.assert_array_equal(part.time, [0.1])
    assert part["theta"].shape == (1, 2)
    assert len(example().between(5.0, 6.0)) == 0
    with pytest.raises(SignalError, match="end before it starts"):
        example().between(1.0, 0.0)
    with pytest.raises(SignalError, match="end before it starts"):
        example().between(float("nan"), 1.0)


def test_commands_hold_and_measurements_interpolate() -> None:
    moved = example().resample([-1.0, 0.05, 0.1, 0.175, 9.0])
    np.testing.assert_allclose(moved["q"], [1.0, 1.5, 2.0, 3.0, 4.0])
    np.testing.assert_allclose(moved["theta"][:, 0], [0.0, 0.5, 1.0, 1.5, 2.0])
    np.testing.assert_array_equal(moved["preset"], [5.0, 5.0, 6.0, 6.0, 7.0])
    assert moved.held == {"preset"}


STAMPS = st.lists(st.integers(0, 10_000), min_size=1, max_size=30, unique=True).map(lambda n: np.array(sorted(n)) / 1e3)


@given(time=STAMPS, at=STAMPS, data=st.data())
def test_resample_equals_the_slow_obvious_way(time, at, data) -> None:
    shape = (len(time), 2)
    values = data.draw(hnp.arrays(np.float64, shape, elements=st.floats(-1e3, 1e3)))
    signals = Signals(time, {"m": values, "c": values}, {"m": "rad", "c": "rad"}, frozenset({"c"}))
    moved = signals.resample(at)
    for n, t in enumerate(at):
        before = max((k for k in range(len(time)) if time[k] <= t), default=0)
        np.testing.assert_array_equal(moved["c"][n], values[before])
        after = min(before + 1, len(time) - 1)
        share = 0.0 if after == before or t < time[0] else (t - time[before]) / (time[after] - time[before])
        np.testing.assert_allclose(moved["m"][n], values[before] + share * (values[after] - values[before]), atol=1e-9)


def test_not_measured_stays_not_measured() -> None:
    signals = Signals([0.0, 1.0, 2.0, 3.0], {"q": [0.0, np.nan, 2.0, 3.0]}, {"q": "rad"})
    moved = signals.resample([0.0, 0.5, 1.5, 2.0, 2.5])["q"]
    np.testing.assert_array_equal(moved, [0.0, np.nan, np.nan, 2.0, 2.5])


def test_a_joint_without_motors_resamples_to_no_columns() -> None:
    signals = Signals([0.0, 1.0], {"theta": np.empty((2, 0))}, {"theta": "rad"})
    assert signals.resample([0.5])["theta"].shape == (1, 0)


def test_resample_refuses_what_is_no_time_base() -> None:
    for bad in ([0.2, 0.1], [np.nan], [[0.1]]):
        with pytest.raises(SignalError):
            example().resample(bad)
    empty = Signals([], {"q": []}, {"q": "rad"})
    assert len(empty) == 0
    with pytest.raises(SignalError, match="without samples"):
        empty.resample([0.0])


def test_joined_brings_the_other_onto_this_time_base() -> None:
    command = Signals([0.0, 0.2], {"u": [1.0, 2.0]}, {"u": "rad"}, frozenset({"u"}))
    both = example().joined(command)
    np.testing.assert_array_equal(both["u"], [1.0, 1.0, 2.0])
    assert both.held == {"preset", "u"} and both.units["u"] == "rad"
    with pytest.raises(SignalError, match="channels in both: q"):
        example().joined(Signals([0.0], {"q": [1.0]}, {"q": "rad"}))
