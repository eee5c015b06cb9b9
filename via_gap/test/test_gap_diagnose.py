"""The whole diagnosis on planted effects with every number of the device file wrong by up to five percent."""

import numpy as np
import pytest
from gap_logs import flexible, log_of, rigid
from via_core.errors import SignalError
from via_core.signals import Signals
from via_gap.candidates.localisation import localise
from via_gap.diagnose import diagnose
from via_gap.logs.log import JointLog, read_log
from via_gap.report.report import GapReport, save_repair
from via_gap.report.withheld import before_and_after
from via_gap.residual.equations import weak_residuals
from via_gap.residual.segments import cut_log
from via_sim.effects import Effect
from via_sim.effects_file import load_effects

COULOMB = Effect("coulomb_friction", "motor", {"torque": 0.03}, 1)
BACKLASH = Effect("backlash", "transmission", {"gap": 0.02}, 1)
LINK = Effect("coulomb_friction", "link", {"torque": 0.02})


@pytest.fixture(scope="module")
def friction() -> GapReport:
    log = log_of(flexible(), (COULOMB,), seed=21)
    return diagnose([log], log.device)


def test_friction_of_the_motor_is_named_placed_and_measured(friction):
    assert friction.verdict == "effect"
    cause = friction.causes[0]
    assert (cause.effect, cause.site, cause.motor) == ("coulomb_friction", "motor", 1)
    assert cause.probability > 0.9
    assert cause.parameters["torque"].value == pytest.approx(0.03, rel=0.02)
    assert (friction.where[0].site, friction.where[0].motor) == ("motor", 1)
    assert [place.effect for place in friction.equivalence_set] == ["coulomb_friction"]
    assert 0.9 < sum(each.probability for each in friction.causes) < 1.0  # the rest: an answer that is wrong


def test_the_predicted_gap_is_that_of_a_log_never_seen(friction):
    withheld = log_of(flexible(), (COULOMB,), seed=21, duration=9.0)
    before, after = before_and_after([withheld], withheld.device, friction.repaired())
    predicted = 1.0 - friction.gap.after / friction.gap.before
    assert 1.0 - after.overall / before.overall == pytest.approx(predicted, abs=0.05)
    assert friction.gap.closes > 0.95
    assert friction.gap.interval[0] <= friction.gap.after <= friction.gap.interval[1]


def test_the_claimed_gap_comes_again_from_the_effects_file(friction, tmp_path):
    save_repair(friction, tmp_path / "repair.yaml")
    log, repair = log_of(flexible(), (COULOMB,), seed=21), load_effects(tmp_path / "repair.yaml")
    assert [effect.name for effect in repair] == ["coulomb_friction", "device_numbers"]
    before, after = before_and_after([log], log.device, repair, friction.held_out)
    assert (before.overall, after.overall) == pytest.approx((friction.gap.before, friction.gap.after), rel=1e-9)
    assert dict(zip(after.names, after.signals, strict=True)) == pytest.approx(
        {name: signal.after for name, signal in friction.gap.signals.items()}, rel=1e-9
    )
    _, without = before_and_after([log], log.device, friction.repair(), friction.held_out)
    assert without.overall > 1.5 * after.overall  # the numbers were off: the effects alone do not give the claimed gap
    elsewhere = [each.model_copy(update={"log": "another"}) for each in friction.held_out]
    with pytest.raises(SignalError, match="not what the report held out"):
        before_and_after([log], log.device, repair, elsewhere)


def test_a_device_within_its_tolerance_has_no_gap():
    log = log_of(flexible(), (), seed=22)
    heard = []
    report = diagnose([log], log.device, progress=lambda what, share: heard.append(share))
    assert (report.verdict, report.causes, report.where) == ("no_gap", (), ())
    assert report.gap.before > 5.0 * report.gap.after
    assert heard == sorted(heard) and heard[-1] == 1.0


def test_a_log_that_cannot_be_used_is_answered_not_raised():
    log = log_of(flexible(), (), seed=22)
    blind = JointLog("blind", log.device, Signals(log.measured.time, {"q": log.measured["q"]}, {"q": "rad"}), None)
    report = diagnose([blind], log.device)
    assert (report.verdict, report.gap) == ("cannot_tell", None)
    assert any(finding.severity == "refuse" for finding in report.data_check)
    assert report.not_judged


@pytest.mark.parametrize(("effect", "site"), [(COULOMB, "motor"), (BACKLASH, "transmission"), (LINK, "link")])
def test_equations_alone_say_where(effect, site):
    log = log_of(flexible(), (effect,), seed=23, tolerance=0.0)
    segments = cut_log(log)
    shares = localise([segments], [weak_residuals(segments, log.device)], log.device)
    assert (shares[0].site, shares[0].share > 0.8) == (site, True)


def test_equations_of_the_right_plant_balance_within_the_floor():
    log = log_of(flexible(), (), seed=23, tolerance=0.0)
    segments = cut_log(log)
    for residual in weak_residuals(segments, log.device):
        assert np.sqrt(np.mean((residual.torque / residual.floor) ** 2)) < 1.5


def test_a_csv_file_is_a_log(tmp_path):
    log = log_of(flexible(), (), seed=24, duration=2.0)
    path = tmp_path / "run.csv"
    columns = np.column_stack(
        [log.measured.time, log.measured["q"], log.measured["theta"], np.append(log.commands["motor"], 0.0)]
    )
    np.savetxt(path, columns, delimiter=",", header="t,q,theta_1,motor_1", comments="", fmt="%.17g")
    device = log.device.model_copy(update={"wire": log.device.wire.model_copy(update={"columns": {"time": "t"}})})
    read = read_log(path, device)
    assert read.level == "no torque"
    assert np.array_equal(read.measured["q"], log.measured["q"])
    assert np.array_equal(read.commands["motor"][:-1], log.commands["motor"])


def loaded(seed: int, mass: float, distance: float, friction: float) -> GapReport:
    effects = (
        Effect("payload", "link", {"mass": mass, "distance": distance}),
        Effect("viscous_friction", "link", {"coefficient": friction}),
    )
    log = log_of(rigid(), effects, seed=seed)
    return diagnose([log], log.device)


def test_two_effects_that_look_like_a_third_are_both_named():
    """Heavier and slower alike: a weaker motor is the best single cause, and no way from there leads to the two."""
    report = loaded(3, mass=0.3, distance=0.2, friction=0.15)
    assert report.verdict == "two_effects"
    assert {place.effect for place in report.effects} == {"payload", "viscous_friction"}


def test_a_pair_as_good_as_the_one_named_is_told_of():
    """Inertia, gravity and friction all grown by about as much: within the tolerances a weaker motor does the same."""
    report = loaded(5, mass=0.17, distance=0.26, friction=0.13)
    assert {"payload", "torque_gain", "viscous_friction"} <= {place.effect for place in report.equivalence_set}
