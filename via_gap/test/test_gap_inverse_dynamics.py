"""The second view: with the effects that were planted every equation balances to the floor of the sensors, and a view
that asks for little torque wins nothing; what predicts without a model is the other view's measure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap_logs import antagonistic_log, flexible, log_of, rigid
from scipy.signal import lfilter
from via_core.errors import SignalError
from via_core.signals import Array, Signals
from via_gap.candidates.bounds import bounds_of
from via_gap.candidates.fit import effect_or_none
from via_gap.candidates.location import Location, locations
from via_gap.candidates.scales import scales_of
from via_gap.candidates.starts import combined, starts
from via_gap.logs.log import JointLog
from via_gap.residual.equation_torques import equation_torques
from via_gap.residual.inverse_dynamics import TAKING, InverseDynamics
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.rollout import Rollout
from via_gap.residual.segments import binned, cut_log
from via_gap.residual.true_starts import without_parts
from via_sim.catalogue import EFFECTS
from via_sim.effects import Effect
from via_sim.joint.layout import M1, M2
from via_sim.joint.parameters import P
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import InitialConditions, simulate

MOTOR = Effect("coulomb_friction", "motor", {"torque": 0.03}, 1)
LINK = Effect("coulomb_friction", "link", {"torque": 0.02})
BACKLASH = Effect("backlash", "transmission", {"gap": 0.02}, 1)
MAXWELL = Effect("hysteresis", "transmission", {"torque": 0.05, "stiffness": 1.0}, 1)
DELAY = Effect("actuator_delay", "command", {"delay": 0.0043})
WEAK = Effect("torque_gain", "motor", {"gain": 0.8}, 1)
PAYLOAD = Effect("payload", "link", {"mass": 0.3, "distance": 0.2})
RIPPLE = Effect("torque_ripple", "motor", {"amplitude": 0.1, "order": 7.0, "phase": 0.3}, 1)
MUCH = Effect("coulomb_friction", "link", {"torque": 0.037})
STRONG = Effect("coulomb_friction", "motor", {"torque": 0.2}, 1)


def model_of(log: JointLog) -> ResidualModel:
    segments = cut_log(log)
    return ResidualModel.of([segments], [np.flatnonzero(segments.valid)], InverseDynamics.of)


def missing(model: ResidualModel, *effects: Effect) -> Array:
    """(a,) root mean square of the missing torque of every axis, in units of the floor."""
    view = model.views[0]
    residual = model.residual([model.row(effects)])[0]
    return np.sqrt(np.mean(residual.reshape(len(view.chosen), len(view.windows.axes), -1) ** 2, axis=(0, 2)))


CASES = [
    ("flexible", (), ()),
    ("flexible", (MOTOR,), (1,)),
    ("flexible", (LINK, BACKLASH), (0, 1)),
    ("flexible", (MAXWELL,), (0, 1)),
    ("flexible", (DELAY,), (1,)),
    ("flexible", (WEAK,), (1,)),
    ("rigid", (), ()),
    ("rigid", (PAYLOAD,), (0,)),
    ("rigid", (RIPPLE,), (0,)),
    ("antagonistic", (), ()),
    ("antagonistic", (STRONG,), (1,)),
    ("antagonistic", (PAYLOAD,), (0,)),
]


@pytest.mark.parametrize(
    ("joint", "effects", "axes"), CASES, ids=[f"{j}: {', '.join(e.name for e in es) or 'none'}" for j, es, _ in CASES]
)
def test_equations_balance_with_the_effects_planted_and_lack_torque_where_they_act(joint, effects, axes):
    if joint == "antagonistic":
        log = antagonistic_log(effects)
    else:
        log = log_of(flexible() if joint == "flexible" else rigid(), effects, seed=5, duration=6.0, tolerance=0.0)
    model = model_of(log)
    assert np.all((missing(model, *effects) > 0.6) & (missing(model, *effects) < 1.7))
    lacking = missing(model) > 5.0
    assert tuple(np.flatnonzero(lacking)) == axes


@pytest.mark.parametrize("device", [flexible(), rigid()], ids=["motor", "drive of a rigid joint"])
def test_a_drive_that_gives_nothing_lacks_more_not_less(device):
    """A light motor turned evenly: without its torque little accelerates, and what is missing is the friction's."""
    model = model_of(log_of(device, (), seed=5, duration=6.0))
    tenth = Effect("torque_gain", "motor", {"gain": 0.1}, 1)
    small = Effect("torque_saturation", "motor", {"limit": 0.02}, 1)
    (drive,) = (v.windows.drive[:, -1] for v in model.views)
    dead = Effect("torque_deadband", "motor", {"threshold": 0.9 * float(np.abs(drive).max())}, 1)
    sizes = [float(np.sum(missing(model, *each) ** 2)) for each in ((), (tenth,), (small,), (dead,))]
    assert all(each > 2.0 * sizes[0] for each in sizes[1:])
    view = model.views[0]
    nothing = float(np.mean(view.baseline() ** 2))
    assert sizes[1] / len(view.windows.axes) > 0.5 * nothing  # no better than no model


def test_every_effect_on_a_command_can_reduce_the_torque_of_a_drive():
    """Otherwise a drive that gives nothing would lack nothing."""
    taking = set(TAKING)
    for kind in EFFECTS.values():
        slots = [getattr(P, slot.name) for slot in kind.slots if any(t.place == "command" for t in kind.terms)]
        assert taking.issuperset(slots), kind.name


def test_rows_on_several_threads_give_the_bits_of_one_row_at_a_time():
    """Also where each row has commands of its own, more than the record keeps."""
    device = rigid()
    log = log_of(device, (), seed=5, duration=6.0, tolerance=0.0)
    segments = cut_log(log)
    view = InverseDynamics.of(segments, np.arange(len(segments)))
    plant = JointPlant.from_device(device)
    delays = [Effect("actuator_delay", "command", {"delay": 0.002 * k}) for k in range(1, 13)]
    rows = np.stack([plant.with_effects([each]).parameters for each in delays])
    np.testing.assert_array_equal(view.residual(rows), np.concatenate([view.residual(row[None]) for row in rows]))


def test_what_drives_a_joint_is_its_torque_of_a_link_behind_springs_theirs():
    log = log_of(flexible(), (), seed=5, duration=6.0, tolerance=0.0)
    segments = cut_log(log)
    view = InverseDynamics.of(segments, np.arange(len(segments)))
    sent = log.commands["motor"][:, 0]
    held = 0.5 * (sent[1:] + sent[:-1])  # of the ticks before and after a sample, half each
    assert view.windows.drive[1 : len(sent), 1] == pytest.approx(held, abs=1e-9)
    deflection = log.measured["q"] - log.measured["theta"][:, 0]
    spring = 6.0 * deflection + 10.0 * deflection**3
    assert view.windows.drive[:, 0] == pytest.approx(spring[: len(view.windows.drive)], abs=5e-3)


def test_the_baseline_is_the_drive_less_its_mean_and_worse_than_the_model():
    model = model_of(log_of(rigid(), (), seed=5, duration=6.0, tolerance=0.0))
    (view,) = model.views
    drive = view.windows.drive[:, 0]
    weights = view.windows.weights[0]
    over = np.array([[drive[k : k + len(weights)] @ weights for k in row] for row in view.first])
    assert view.baseline() == pytest.approx((over - over.mean()) / view.windows.floor[0], rel=1e-9, abs=1e-9)
    assert np.mean(view.baseline() ** 2) > 100.0 * np.mean(model.residual([model.row(())])[0] ** 2)


def test_the_witness_looks_at_a_segment_as_a_whole():
    segments = cut_log(log_of(flexible(), (), seed=5, duration=6.0, tolerance=0.0))
    view = InverseDynamics.by_segment(segments, np.arange(1, len(segments) - 1))
    assert view.windows.weights.shape[1] == segments.ticks + 1 and view.first.shape[1] == 1


def test_axes_nobody_measured_have_no_equation():
    log = log_of(flexible(), (), seed=5, duration=6.0, tolerance=0.0)
    alone = Signals(log.measured.time, {"q": log.measured["q"]}, {"q": "rad"})
    segments = cut_log(JointLog("link only", log.device, alone, log.commands))
    with pytest.raises(SignalError, match="no equation"):
        InverseDynamics.of(segments, np.arange(4))


def coasting() -> JointLog:
    """A rigid joint without gravity and friction that nothing drives: a straight line."""
    device = rigid()
    free = device.model_copy(
        update={"link": device.link.model_copy(update={"gravity_torque": 0.0, "viscous_friction": 0.0})}
    )
    time = np.arange(2000) / 500.0
    still = {"external_torque": np.zeros(len(time))}
    commands = Signals(time, still, {"external_torque": "N m"}, frozenset(still))
    plant, start = JointPlant.from_device(free), np.array([-1.0, 0.0, 0.0, 0.5, 0.0, 0.0])
    run = simulate(plant, commands, 4.0, 500.0, Sensors.of_device(free), InitialConditions(start, seed=2))
    return JointLog("coasting", free, run.measured.select(["q"]), commands)


def test_a_straight_line_predicts_what_nothing_drives_to_the_noise():
    segments = cut_log(coasting())
    view = Rollout.of(segments, np.arange(1, len(segments)))
    assert 0.4 < np.mean(view.baseline() ** 2) < 1.5


def test_a_straight_line_leaves_half_the_acceleration_times_time_squared():
    """Beside a measured motion that is a line, with a parabola added: the baseline is that parabola, whitened."""
    segments = cut_log(coasting())
    chosen = np.arange(1, len(segments))
    ticks = np.arange(segments.ticks + 1) / segments.rate
    start = segments.start[segments.begin]
    line = start[:, None, [0]] + ticks[None, :, None] * start[:, None, [3]]
    on_line = replace(segments, measured=binned(line, segments.every, segments.averaged))
    assert Rollout.of(on_line, chosen).baseline() == pytest.approx(0.0, abs=1e-6)
    parabola = 0.5 * 3.0 * ticks**2
    off = replace(segments, measured=binned(line + parabola[None, :, None], segments.every, segments.averaged))
    view = Rollout.of(off, chosen)
    expected = binned(np.tile(parabola[None, :, None], (len(chosen), 1, 1)), segments.every, segments.averaged)
    whitened = without_parts((expected / segments.noise).reshape(1, len(chosen), -1), view.basis, view.shrink)[0]
    assert view.baseline() == pytest.approx(whitened, rel=1e-6, abs=1e-6)
    assert np.mean(view.baseline() ** 2) > 100.0


def test_a_model_beats_a_straight_line_where_the_joint_is_driven():
    segments = cut_log(log_of(flexible(), (), seed=5, duration=6.0))
    model = ResidualModel.of([segments], [np.arange(1, len(segments))])
    line, own = (model.per_segment(each) for each in (model.baseline(), model.residual([model.row(())])[0]))
    assert np.mean(np.log1p(line)) > np.mean(np.log1p(own)) + 1.0


@pytest.mark.parametrize("every", [1, 5, 10])
def test_the_floor_is_the_scatter_of_windows_by_noise_at_any_rate(every):
    """Angles between samples are interpolated, so that several ticks share the noise of one sample."""
    log, rng = log_of(rigid(), (), seed=6, duration=20.0), np.random.default_rng(6)
    time, q = log.measured.time[::every], log.measured["q"][::every]
    noisy, clean = (
        replace(log, measured=Signals(time, {"q": angle}, {"q": "rad"}))
        for angle in (q + 1e-3 * rng.standard_normal(len(q)), q)
    )
    segments = cut_log(noisy)
    there = np.flatnonzero(segments.valid)
    views = [InverseDynamics.of(each, there) for each in (segments, replace(segments, angles=cut_log(clean).angles))]
    with_noise, without = (view.residual(view.nominal[None])[0] for view in views)
    assert np.sqrt(np.mean((with_noise - without) ** 2)) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("lag", [0.0, 0.004, 0.03, 0.2])
def test_a_lag_filters_the_noise_of_measured_torques_in_the_floor(lag):
    """White noise through the lag of the simulator, against the window, beside the closed form."""
    segments = cut_log(log_of(rigid(), (), seed=6, duration=8.0))
    windows = InverseDynamics.of(segments, np.arange(len(segments))).windows
    noisy = replace(windows, floor=np.array([5.0]), sensed=np.array([3.0]))  # 4 by other sensors
    period, weights = 1.0 / segments.rate, windows.weights[0]
    noise = np.random.default_rng(5).standard_normal(400_000)
    kept = np.exp(-period / lag) if lag else 0.0
    passed = lfilter([1.0 - kept], [1.0, -kept], noise)
    share = np.var(np.convolve(passed, weights, "valid")) / np.var(np.convolve(noise, weights, "valid"))
    assert noisy.floor_behind(lag)[0] == pytest.approx(np.sqrt(16.0 + 9.0 * share), rel=0.01)
    row = JointPlant.from_device(rigid()).with_effects([Effect("actuator_lag", "command", {"time_constant": 0.03})])
    view = InverseDynamics(segments, np.arange(len(segments)), segments.nominal, noisy)
    quiet = replace(view, windows=replace(noisy, sensed=np.array([0.0])))
    ratio = view.residual(row.parameters[None]) / quiet.residual(row.parameters[None])
    assert np.nanmedian(ratio) == pytest.approx(5.0 / noisy.floor_behind(0.03)[0])


def with_gaps(log: JointLog, *gaps: tuple[float, float]) -> JointLog:
    """The log without the samples inside some intervals [s]."""
    time = log.measured.time
    keep = ~np.any([(time > begin) & (time < end) for begin, end in gaps], axis=0)
    channels = {name: values[keep] for name, values in log.measured.channels.items()}
    return replace(log, measured=Signals(time[keep], channels, log.measured.units))


def test_windows_with_a_gap_in_the_samples_do_not_count() -> None:
    log = log_of(rigid(), (), seed=6, duration=8.0)
    segments = cut_log(with_gaps(log, (3.1, 3.16)))
    inside = segments.hidden
    assert 0 < inside.sum() < 40
    wrong = replace(segments, angles=segments.angles + 0.1 * inside[:, None])
    views = [InverseDynamics.of(each, np.flatnonzero(each.valid)) for each in (segments, wrong)]
    left, same = (view.residual(view.nominal[None])[0] for view in views)
    assert np.array_equal(left, same) and 0 < np.sum(views[0].weight == 0.0) < 10
    assert np.allclose(np.mean(views[0].weight ** 2, axis=1), 1.0)
    baseline = views[0].baseline().reshape(views[0].weight.shape)
    assert not baseline[views[0].weight == 0.0].any()


def test_where_most_windows_have_a_gap_there_is_no_second_view() -> None:
    log = log_of(rigid(), (), seed=6, duration=8.0)
    gaps = [(at, at + 0.01) for at in np.arange(0.05, 8.0, 0.07)]
    segments = cut_log(with_gaps(log, *gaps))
    with pytest.raises(SignalError, match="too many samples are missing"):
        InverseDynamics.of(segments, np.flatnonzero(segments.valid))


def stop_and_go(quantum: float) -> JointLog:
    """A light joint with much dry friction and encoder steps `quantum` [rad]: pulses of torque, then rest."""
    device = rigid()
    numbers = {"inertia": 4e-4, "viscous_friction": 1e-4, "coulomb_friction": 0.02, "gravity_torque": 0.0}
    sensors = device.sensors.model_copy(update={"link_quantum": quantum})
    light = device.model_copy(update={"link": device.link.model_copy(update=numbers), "sensors": sensors})
    time = np.arange(5000) / 500.0
    torque = np.where(time % 1.0 < 0.3, 0.07, 0.05 * np.sin(20.0 * time)) * np.sign(np.sin(np.pi * time))
    commands = Signals(time, {"external_torque": torque}, {"external_torque": "N m"}, frozenset({"external_torque"}))
    plant = JointPlant.from_device(light).with_effects([MUCH])
    run = simulate(plant, commands, 10.0, 500.0, Sensors.of_device(light), InitialConditions(seed=2))
    return JointLog("stop and go", light, run.measured.select(["q"]), commands)


def test_noise_of_the_speed_at_rest_is_not_taken_for_motion():
    """With friction of random sign at rest, a weak drive with less inertia would explain the motion as well."""
    model = model_of(stop_and_go(1e-3))
    instead = [Effect("torque_gain", "motor", {"gain": 0.35}, 1), Effect("link_inertia", "link", {"inertia": -2.6e-4})]
    right, wrong = missing(model, MUCH), missing(model, *instead)
    assert right < 2.0 and wrong > 2.0 * right


def test_dry_friction_may_be_larger_than_all_other_torque_on_a_link():
    log = stop_and_go(1e-5)
    scales = scales_of([cut_log(log)], [None])
    assert scales.torque[0] == pytest.approx(np.std(log.commands["external_torque"]), rel=0.01)
    _, high = bounds_of(Location("coulomb_friction", "link", 0), scales)
    assert high[0] > 2.0 * MUCH.parameters["torque"]


def test_friction_that_differs_with_the_direction_holds_as_a_bias_beside_it_does():
    """The same physics under two names, at standstill as well: static friction is not symmetric about zero."""
    forward, backward = 0.02, 0.10
    one = Effect("asymmetric_coulomb", "link", {"forward": forward, "backward": backward})
    other = (
        Effect("coulomb_friction", "link", {"torque": 0.5 * (forward + backward)}),
        Effect("torque_bias", "motor", {"torque": 0.5 * (backward - forward)}, 1),
    )
    model = model_of(log_of(rigid(), (one,), seed=3))
    first, second = model.residual([model.row([one]), model.row(other)])
    np.testing.assert_allclose(first, second, atol=1e-6)


def test_no_equation_of_a_motor_contains_the_drive_of_the_other():
    """So one record without the commands of both motors serves the equations of both, with every effect."""
    log = antagonistic_log(())
    model = model_of(log)
    segments = model.views[0].segments
    record, scales = model.views[0].windows.record, scales_of([segments], [None])
    without = {drives: np.array(record.commands) for drives in ((M1,), (M2,), (M1, M2))}
    for drives, commands in without.items():
        commands[:, list(drives)] = 0.0
    records = {drives: replace(record, commands=commands) for drives, commands in without.items()}
    tried = 0
    for place in locations(log.device, log):
        for start in starts(place, scales, log.device):
            effect = effect_or_none(place, combined(place, start, [1.0] * (2 if start.wave else len(start.directions))))
            row = model.row_or_none([effect])
            if row is None:
                continue
            tried += 1
            torques = {drives: equation_torques(row, each).torque for drives, each in records.items()}
            for axis, drive in ((1, M1), (2, M2)):
                np.testing.assert_array_equal(torques[M1, M2][:, axis], torques[(drive,)][:, axis], str(place))
    assert tried > 60


def test_each_motor_is_measured_by_the_torque_of_its_own_drive():
    model = model_of(antagonistic_log(()))
    tenth = Effect("torque_gain", "motor", {"gain": 0.1}, 2)
    before, after = missing(model), missing(model, tenth)
    assert after[:2] == pytest.approx(before[:2], rel=1e-9) and after[2] > 5.0 * before[2]
    row = model.row([tenth])
    terms = equation_torques(row, model.views[0].windows.record, model.views[0].inside)
    assert model.views[0]._passed(row, terms) == pytest.approx([1.0, 1.0, 0.1], rel=1e-6)
