"""The proposed motion: it breaks the tie it was made for, keeps within limits, survives its file, or says it cannot."""

from functools import cache

import numpy as np
import pytest
from gap_logs import flexible, log_of, servo, wrong_plant
from via_controllers.contract import JointSample
from via_controllers.joint_methods import ExcitationParameters
from via_core.bags.reader import read_bag
from via_core.command_files import read_motion
from via_core.devices import Device, load_device
from via_core.errors import ParameterError, SignalError
from via_gap.design import proposal
from via_gap.design.commands import commands_of, rate_of, recorded
from via_gap.design.motion_file import write_motion
from via_gap.design.motions import DURATION, MOTIONS
from via_gap.design.proposal import ENOUGH, Proposed, propose, tied, with_proposal
from via_gap.diagnosis import diagnose
from via_gap.report.report import Cause, EffectLocation, GapReport, NuisanceValue, Value
from via_gap.residual.nuisance import nuisances
from via_gap.residual.residual_model import ResidualModel
from via_sim.effects import Effect
from via_sim.plants import JointPlant
from via_sim.simulate import Simulator

COULOMB = Effect("coulomb_friction", "motor", {"torque": 0.03}, 1)
STRIBECK = Effect("stribeck_friction", "motor", {"breakaway": 0.045, "kinetic": 0.03, "velocity": 0.05}, 1)
DAHL = Effect("presliding_friction", "link", {"torque": 0.02, "stiffness": 3.0})
BACKLASH = Effect("backlash", "transmission", {"gap": 0.02}, 1)
BIAS = Effect("torque_bias", "motor", {"torque": -0.004}, 1)
SKEWED = Effect("asymmetric_coulomb", "motor", {"forward": 0.008, "backward": 0.0}, 1)


def undecided(device: Device, *effects: Effect) -> GapReport:
    """A report that ties these causes, as a diagnosis would write it."""
    places = tuple(EffectLocation(effect=e.name, site=e.site, joint=device.name, motor=e.motor) for e in effects)
    causes = tuple(
        Cause(
            effect=e.name, site=e.site, joint=device.name, motor=e.motor, probability=1.0 / len(effects),
            share=1.0 / len(effects), left=0.0, score=0.7,
            parameters={p.name: Value(value=e.parameters[p.name], sd=0.0, unit=p.unit) for p in e.kind.parameters},
        )
        for e in effects
    )  # fmt: skip
    numbers = tuple(
        NuisanceValue(name=n.name, unit=n.unit, filed=n.value, fitted=n.value, offset=0.0, at_bound=False)
        for n in nuisances(JointPlant.from_device(device))
    )
    return GapReport(
        joint=device.name, level="full", logs=("a",), holdout=("blocks of the same logs",), verdict="effect", where=(),
        causes=causes, equivalence_set=places, effects=places[:1], gap=None, nuisance=numbers, data_check=(),
        not_evaluated=(),
    )  # fmt: skip


RIVALS = {"two frictions": (COULOMB, STRIBECK), "Dahl or backlash": (DAHL, BACKLASH)}


@cache
def proposed_for(tie: str) -> Proposed:
    """The motion for a tie, whichever of its causes is true."""
    return propose(undecided(flexible(), *RIVALS[tie]), flexible())


@pytest.mark.parametrize(
    ("truth", "tie"),
    [(STRIBECK, "two frictions"), (COULOMB, "two frictions"), (BACKLASH, "Dahl or backlash")],
    ids=["Stribeck", "Coulomb", "backlash"],
)
def test_the_motion_breaks_the_tie(truth, tie):
    device, proposed = flexible(), proposed_for(tie)
    assert proposed.score > ENOUGH
    plant = wrong_plant(device, (truth,), np.random.default_rng(41), 0.05)
    answer = recorded(plant, proposed.commands, np.zeros(6), 7)
    report = diagnose([log_of(device, (truth,), seed=41, duration=6.0), answer], device)
    assert report.verdict == "effect"
    assert [place.effect for place in report.equivalence_set] == [truth.name]


def test_the_motion_is_the_best_of_all_with_every_pair_tried():
    """Three causes: the hardest pair of one motion is not that of another."""
    device = flexible()
    blank = ResidualModel.of_plant(JointPlant.from_device(device))
    offsets, report = np.zeros(len(blank.nuisances)), undecided(device, DAHL, BACKLASH, BIAS)
    causes = [proposal.TiedCause.of(cause) for cause in report.causes]
    every = []
    for motion in MOTIONS:
        sizes = (
            proposal._tried(blank, causes, offsets, motion, share * proposal.RANGE, None) for share in proposal.SMALLER
        )
        every += [each for each in sizes if each is not None][:1]
    best, found = max(every, key=lambda each: each.score), propose(report, device)
    assert len(every) > 3 and len({each.pair for each in every}) > 1
    assert (found.motion, found.size, found.pair) == (best.motion, best.size, best.pair)
    assert (found.score, found.disagreement) == pytest.approx((best.score, best.disagreement), rel=1e-9)
    weakest = min(every, key=lambda each: each.score)
    for each in every:
        beside_weak, beside_best = (
            proposal._tried(blank, causes, offsets, each.motion, each.size, other) for other in (weakest, best)
        )
        assert beside_best.score <= best.score
        if each is not weakest:
            assert (beside_weak.pair, beside_weak.score) == (each.pair, pytest.approx(each.score, rel=1e-9))


def test_a_joint_with_a_torque_that_the_report_lacks_is_led_through_the_motion(tmp_path):
    device, proposed = flexible(), proposed_for("two frictions")
    write_motion(tmp_path / "motion.csv", device, proposed.commands, proposed.reference)
    player = ExcitationParameters(commands=str(tmp_path / "motion.csv")).of(device)
    plant = JointPlant.from_device(device).with_effects([COULOMB, Effect("torque_bias", "motor", {"torque": 0.05}, 1)])
    simulator = Simulator(plant, rate_of(device))
    state, memory = simulator.init(), player.supervisor.init()
    angles, measured = np.zeros(len(proposed.commands)), simulator.sample(simulator.init())[0]
    for k in range(len(angles)):
        angles[k] = measured[1]
        sample = JointSample(k / rate_of(device), float(measured[0]), measured[1:2].copy())
        memory, answer = player.supervisor.step(memory, sample, True)
        state, measured, _ = simulator.step(state, [*answer.torque, 0.0, 0.0, 0.0])
    assert np.max(np.abs(angles - proposed.reference[:, 0])) < 0.02
    np.testing.assert_allclose(proposed.reference[[0, -1]], 0.0, atol=0.05)


def test_what_is_the_same_torque_in_every_motion_is_said_to_be():
    device = flexible()
    dry = device.model_copy(
        update={"motors": (device.motors[0].model_copy(update={"coulomb_friction": 0.08}),)}
    )  # 5 % of it and one-sided friction make a bias
    proposed = propose(undecided(dry, BIAS, SKEWED), dry)
    assert proposed.score < ENOUGH
    assert "no motion" in proposed.text and "hold" in proposed.text


def test_nothing_is_proposed_where_nothing_is_open():
    device = flexible()
    decided = undecided(device, COULOMB)
    assert propose(decided, device) is None
    assert with_proposal(decided, device).proposal is None
    both = undecided(device, COULOMB, BACKLASH)
    assert len(tied(both)) == len(tied(both.model_copy(update={"verdict": "main_effect"}))) == 2
    several = {"verdict": "several_effects", "effects": both.equivalence_set}
    assert tied(both.model_copy(update=several)) == tied(both.model_copy(update={"verdict": "unknown"})) == ()
    open_ = both.model_copy(update={"verdict": "cannot_tell", "equivalence_set": ()})
    assert len(tied(open_)) == 2
    assert with_proposal(open_, device).proposal is None and with_proposal(both, device).proposal is not None


def test_a_cause_that_no_motion_keeps_within_the_limits_prevents_no_proposal():
    """A log whose error does not repeat can leave a push among its causes."""
    device, push = flexible(), Effect("external_torque", "environment", {"torque": 9.0, "start": 0.0, "stop": 9.0})
    assert propose(undecided(device, push, COULOMB), device) is None
    proposed = propose(undecided(device, push, DAHL, BACKLASH), device)
    assert {each.name for each in proposed.separates} == {"presliding_friction", "backlash"}


def test_a_report_of_another_device_is_refused():
    report = undecided(flexible(), COULOMB, BACKLASH)
    with pytest.raises(ParameterError, match="not those of"):
        propose(report, servo())


@pytest.mark.parametrize("motion", MOTIONS, ids=lambda motion: motion.name)
def test_every_motion_begins_and_ends_at_rest_within_its_size(motion):
    time = np.arange(round(DURATION * 1000.0)) / 1000.0
    angle = motion.reference(time)
    assert angle[[0, -1]] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert np.max(np.abs(angle)) <= 1.0 + 1e-9
    assert np.max(np.abs(angle)) >= 0.1
    assert np.max(np.abs(np.diff(angle))) < 0.05
    assert np.all((motion.load(time) >= 0.0) & (motion.load(time) <= 1.0))


@pytest.mark.parametrize("device", [flexible(), servo(), load_device("dfki_elbow")], ids=["torque", "servo", "rigid"])
def test_commands_survive_their_file(tmp_path, device):
    commands, _ = commands_of(JointPlant.from_device(device), MOTIONS[2], 0.3)
    write_motion(tmp_path / "motion.csv", device, commands)
    again = read_motion(tmp_path / "motion.csv", device)
    assert again.channels.keys() == commands.channels.keys()
    for name, values in commands.channels.items():
        assert again[name] == pytest.approx(values, rel=1e-8, abs=1e-12)
    write_motion(tmp_path / "motion", device, commands)
    topic = read_bag(tmp_path / "motion")[device.command_topic]
    assert len(topic) == len(commands) == round(DURATION * rate_of(device))
    if not device.n_motors:
        assert np.stack(topic["motor"])[:, 0] == pytest.approx(commands["external_torque"])
    write_motion(tmp_path / "empty.csv", device, commands.select([]))
    with pytest.raises(SignalError, match="no column of commands"):
        read_motion(tmp_path / "empty.csv", device)


def test_a_position_drive_is_moved_by_its_goal(monkeypatch):
    monkeypatch.setattr(proposal, "MOTIONS", [each for each in MOTIONS if each.name == "ladder of speeds"])
    device = load_device("xl330")
    assert device.drive == "position"
    more, drag = (Effect(name, "link", {"coefficient": 0.02}) for name in ("viscous_friction", "quadratic_drag"))
    proposed = propose(undecided(device, more, drag), device)
    assert proposed.commands.channels.keys() == {"equilibrium"} and proposed.disagreement > 0.0
