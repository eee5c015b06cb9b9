"""The whole diagnosis on planted effects with every number of the device file wrong by up to five percent."""

import numpy as np
import pytest
from gap_logs import FLEXIBLE, even_log, flexible, log_of, rigid
from via_core.devices import parse_device
from via_core.errors import SignalError
from via_core.signals import Signals
from via_gap.candidates.localisation import localise
from via_gap.diagnosis import diagnose
from via_gap.logs.log import JointLog, read_log
from via_gap.report.report import GapReport, save_repair
from via_gap.report.withheld import before_and_after
from via_gap.residual.inverse_dynamics import missing_torque
from via_gap.residual.segments import cut_log
from via_sim.effects import Effect
from via_sim.effects.files import load_effects

COULOMB = Effect("coulomb_friction", "motor", {"torque": 0.03}, 1)
BACKLASH = Effect("backlash", "transmission", {"gap": 0.02}, 1)
LINK = Effect("coulomb_friction", "link", {"torque": 0.02})
PAYLOAD = Effect("payload", "link", {"mass": 0.3, "distance": 0.2})
DEAD_ZONE = Effect("dead_zone", "motor", {"width": 0.15}, 1)
RIPPLE = Effect("torque_ripple", "motor", {"amplitude": 0.05, "order": 7.0, "phase": 0.3}, 1)


@pytest.fixture(scope="module")
def friction() -> GapReport:
    log = log_of(flexible(), (COULOMB,), seed=21, duration=10.0)
    return diagnose([log], log.device)


def test_friction_of_the_motor_is_named_placed_and_measured(friction):
    assert friction.verdict == "effect"
    cause = friction.causes[0]
    assert (cause.effect, cause.site, cause.motor) == ("coulomb_friction", "motor", 1)
    assert cause.probability > 0.9
    assert cause.parameters["torque"].value == pytest.approx(0.03, rel=0.02)
    assert (friction.where[0].site, friction.where[0].motor) == ("motor", 1)
    assert [place.effect for place in friction.equivalence_set] == ["coulomb_friction"]
    assert sum(each.probability for each in friction.causes) < 1.0  # the rest: an answer that is wrong


def test_the_predicted_gap_is_that_of_a_log_never_seen(friction):
    withheld = log_of(flexible(), (COULOMB,), seed=21, duration=9.0)
    before, after = before_and_after([withheld], withheld.device, friction.repaired())
    predicted = 1.0 - friction.gap.after / friction.gap.before
    assert 1.0 - after.overall / before.overall == pytest.approx(predicted, abs=0.05)
    assert friction.gap.explained > 0.95
    assert friction.gap.interval[0] <= friction.gap.after <= friction.gap.interval[1]


def test_the_claimed_gap_comes_again_from_the_effects_file(friction, tmp_path):
    save_repair(friction, tmp_path / "repair.yaml")
    log, repair = log_of(flexible(), (COULOMB,), seed=21, duration=10.0), load_effects(tmp_path / "repair.yaml")
    assert [effect.name for effect in repair] == ["coulomb_friction", "device_numbers"]
    before, after = before_and_after([log], log.device, repair, friction.held_out)
    assert (before.overall, after.overall) == pytest.approx((friction.gap.before, friction.gap.after), rel=1e-9)
    assert dict(zip(after.names, after.signals, strict=True)) == pytest.approx(
        {name: signal.after for name, signal in friction.gap.signals.items()}, rel=1e-9
    )
    _, without = before_and_after([log], log.device, friction.repair(), friction.held_out)
    assert without.overall > 1.5 * after.overall  # the numbers were off: the effects alone do not give the claimed gap
    elsewhere = [each.model_copy(update={"log": "another"}) for each in friction.held_out]
    with pytest.raises(SignalError, match="none of the intervals that the report held out"):
        before_and_after([log], log.device, repair, elsewhere)


def test_a_device_within_its_tolerance_has_no_gap():
    log = log_of(flexible(), (), seed=22, duration=10.0)
    heard = []
    report = diagnose([log], log.device, progress=lambda what, share: heard.append(share))
    assert (report.verdict, report.causes, report.where) == ("no_gap", (), ())
    assert report.gap.before > 5.0 * report.gap.after
    assert heard == sorted(heard) and heard[-1] == 1.0


def test_a_log_that_cannot_be_used_is_answered_not_raised():
    log = log_of(flexible(), (), seed=22)
    bare = JointLog("bare", log.device, Signals(log.measured.time, {"q": log.measured["q"]}, {"q": "rad"}), None)
    report = diagnose([bare], log.device)
    assert (report.verdict, report.gap) == ("cannot_tell", None)
    assert any(finding.severity == "refuse" for finding in report.data_check)
    assert report.not_evaluated


@pytest.mark.parametrize(("effect", "site"), [(COULOMB, "motor"), (BACKLASH, "transmission"), (LINK, "link")])
def test_equations_alone_say_where(effect, site):
    log = log_of(flexible(), (effect,), seed=23, tolerance=0.0)
    segments = cut_log(log)
    shares = localise([segments], [missing_torque(segments, log.device)], log.device)
    assert (shares[0].site, shares[0].share > 0.8) == (site, True)


def test_equations_of_the_right_plant_balance_within_the_floor():
    log = log_of(flexible(), (), seed=23, tolerance=0.0)
    segments = cut_log(log)
    missing = missing_torque(segments, log.device)
    assert missing.axes == (0, 1)
    assert np.all(np.sqrt(np.mean((missing.torque / missing.floor) ** 2, axis=0)) < 1.5)


def test_a_csv_file_is_a_log(tmp_path):
    log = log_of(flexible(), (), seed=24, duration=2.0)
    path = tmp_path / "run.csv"
    columns = np.column_stack(
        [log.measured.time, log.measured["q"], log.measured["theta"], np.append(log.commands["motor"], 0.0)]
    )
    np.savetxt(path, columns, delimiter=",", header="t,q,theta_1,motor_1", comments="", fmt="%.17g")
    device = parse_device(f"{FLEXIBLE}wire: {{columns: {{time: t}}}}\n", "flexible")
    read = read_log(path, device)
    assert read.level == "no torque"
    assert np.array_equal(read.measured["q"], log.measured["q"])
    assert np.array_equal(read.commands["motor"][:-1], log.commands["motor"])


def test_a_payload_is_named_with_the_product_that_its_log_shows():
    log = log_of(rigid(), (PAYLOAD,), seed=3, duration=10.0)
    report = diagnose([log], log.device)
    assert (report.verdict, [place.effect for place in report.effects]) == ("effect", ["payload"])
    found = {name: value.value for name, value in report.causes[0].parameters.items()}
    assert found["mass"] * found["distance"] == pytest.approx(0.3 * 0.2, rel=0.1)
    assert report.explained > 0.95


def test_a_dead_zone_is_one_cause():
    """Without it in the catalogue, torque gain, deadband and friction together imitated it."""
    log = log_of(rigid(), (DEAD_ZONE,), seed=3, duration=10.0)
    report = diagnose([log], log.device)
    assert (report.verdict, [place.effect for place in report.effects]) == ("effect", ["dead_zone"])
    assert report.causes[0].parameters["width"].value == pytest.approx(0.15, rel=0.05)


def test_ripple_of_a_motor_that_turns_evenly_is_found_by_the_torque_it_needs():
    """Under velocity control measured torque hardly predicts the motion, and whatever slows a model down would win."""
    log = even_log((RIPPLE,))
    report = diagnose([log], log.device)
    assert report.gap.by == "inverse dynamics"
    assert (report.verdict, [place.effect for place in report.effects]) == ("effect", ["torque_ripple"])
    found = report.causes[0].parameters
    assert found["amplitude"].value == pytest.approx(0.05, rel=0.05)
    assert found["order"].value == pytest.approx(7.0, abs=0.1)
    before, after = before_and_after([log], log.device, report.repaired(), report.held_out, report.by_equations)
    assert (before.overall, after.overall) == pytest.approx((report.gap.before, report.gap.after), rel=1e-9)


def test_nothing_absurd_is_named_of_a_motor_that_turns_evenly_with_friction_and_ripple():
    """Ten seconds hold one reversal: to name both, one or none is right, a lag or an inertia is not."""
    log = even_log((RIPPLE, Effect("coulomb_friction", "link", {"torque": 0.05})))
    report = diagnose([log], log.device)
    assert {place.effect for place in report.effects} <= {"torque_ripple", "coulomb_friction"}
    assert all(
        cause.probability < 0.5 for cause in report.causes if cause.effect not in ("torque_ripple", "coulomb_friction")
    )
