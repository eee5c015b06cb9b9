"""Free runs: whole logs, evidence from fitted logs alone, and what was held out has no say in what is named."""

import numpy as np
import pytest
from gap_logs import log_of, servo
from via_core.device_parts import Tolerances
from via_gap.candidates.fit import fit_device_parameters
from via_gap.diagnosis import diagnose
from via_gap.logs.log import JointLog
from via_gap.logs.replay import simulated_log
from via_gap.residual.nuisance import nuisances
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.rollout import Rollout
from via_gap.residual.segments import whole_log
from via_gap.selection.folds import FOLDS, Folds
from via_sim.effects import Effect
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import InitialConditions, simulate

DELAY = Effect("actuator_delay", "command", {"delay": 0.03})
GROUPS = ("a", "b", "a", "c")


def log_at_rest(seed, *more):
    """A log that begins with all axes where their commands say."""
    device = servo()
    commands = log_of(device, seed=seed, duration=2.0).commands
    plant = JointPlant.from_device(device).with_effects((DELAY, *more))
    rest = [0.0, 0.0, commands["preset"][0], 0.0, 0.0, 0.0]
    run = simulate(plant, commands, 2.0, 500.0, Sensors.of_device(device), InitialConditions(rest, seed=seed))
    return JointLog(f"log {seed}", device, run.measured.select(["q", "theta"]), commands)


def runs(*seeds):
    return [whole_log(log_at_rest(seed)) for seed in seeds]


def problem(*seeds):
    segments = runs(*seeds)
    return ResidualModel.of(segments, [np.arange(1)] * len(segments))


def test_a_whole_log_is_the_free_run():
    device, (segments,) = servo(), runs(1)
    assert len(segments) == 1
    assert segments.ticks / segments.rate == pytest.approx(segments.log.duration, abs=0.005)
    view = Rollout.of(segments, np.arange(1))
    assert not view.shrink.any()  # nothing is put down to the start
    run = simulated_log(device, segments.log.measured, segments.log.commands)
    ticks = segments.origin + segments.every * np.arange(1, segments.measured.shape[1] + 1) / segments.rate
    motion = view.motion(view.segments.nominal[None])[0, 0, :, 0]
    # of .5 rad: a start is read off a little differently
    assert motion == pytest.approx(np.interp(ticks, run.time, run["q"]), abs=4e-3)


def test_logs_of_a_group_are_left_out_together_and_each_once():
    whole = problem(1, 2, 3, 4)
    folds = Folds.of(whole, GROUPS)
    assert len(folds.parts) == min(FOLDS, 3)
    assert np.array_equal(np.sort(np.concatenate([where for _, _, where in folds.parts])), np.arange(whole.size))
    for kept, rest, _ in folds.parts:
        sides = [{GROUPS[int(b.segments.log.name.split()[1]) - 1] for b in part.views} for part in (kept, rest)]
        assert sides[0] | sides[1] == {"a", "b", "c"}
        assert not sides[0] & sides[1]
    assert Folds.of(whole, ("a",) * 4) is None


def test_a_fold_is_evaluated_by_a_fit_to_the_others():
    whole = problem(1, 2, 3)
    base = fit_device_parameters(whole)
    (evaluation,) = Folds.of(whole, (1, 2, 3)).evaluate([base], None)
    for i, seed in enumerate((1, 2, 3)):
        others = problem(*(s for s in (1, 2, 3) if s != seed))
        offsets = others.fit_nuisances((), base.offsets)[0]
        alone = problem(seed)
        assert evaluation.segments[i] == pytest.approx(
            np.mean(alone.residual([alone.row((), offsets)])[0] ** 2), rel=1e-9
        )
    assert evaluation.mean_square > np.mean(base.residual**2)  # a fit is best where it was fitted


def test_what_is_named_does_not_depend_on_what_was_held_out():
    device = servo()
    logs = [log_at_rest(seed) for seed in (1, 2, 3)]
    other = Effect("coulomb_friction", "link", {"torque": 0.1})
    held = [log_at_rest(4, *more) for more in ((), (other,))]
    first, second = (diagnose(logs, device, [each]) for each in held)
    assert first.effects == second.effects
    assert (first.causes, first.nuisance, first.verdict) == (second.causes, second.nuisance, second.verdict)
    assert [location.effect for location in first.effects] == ["actuator_delay"]
    assert first.causes[0].parameters["delay"].value == pytest.approx(0.03, abs=1e-3)
    assert first.gap.after < 0.1 * first.gap.before
    assert second.gap.after > 10.0 * first.gap.after


def test_numbers_are_as_loose_as_the_device_file_says():
    device = servo()
    wide = device.tolerances.model_copy(update={"bandwidth": 0.6, "link_friction": 0.3})
    loose = device.model_copy(update={"tolerances": wide})
    found = {each.name: each.tolerance for each in nuisances(JointPlant.from_device(loose))}
    assert found["motor 2 bandwidth"] == 0.6
    assert found["link viscous friction"] == 0.3
    tight = device.model_copy(update={"tolerances": Tolerances()})
    assert {each.tolerance for each in nuisances(JointPlant.from_device(tight))} == {0.05}
