"""Every effect of the catalogue is a candidate, or the report says why it is not."""

from dataclasses import replace

import numpy as np
import pytest
from gap_logs import flexible, log_of, rigid, servo
from via_core.devices import load_device
from via_core.signals import Signals
from via_gap.candidates.fit import Fit, effect_or_none
from via_gap.candidates.location import MEASUREMENT_ONLY, Location, locations, missing_effects
from via_gap.candidates.scales import Scales
from via_gap.candidates.screen import REACH, Direction, directions, ranked_pairs
from via_gap.candidates.starts import amount_range, combined, size_of, size_parameters, starts
from via_gap.logs.log import JointLog
from via_gap.rendering.joint_picture import JointPicture
from via_gap.rendering.names import site_words
from via_gap.rendering.page import environment
from via_gap.report.figures import JointSketch
from via_sim.catalogue import EFFECTS
from via_sim.catalogue.starts import Start


def beside(log: JointLog, name: str) -> JointLog:
    """The log with a command channel more."""
    held = log.commands
    channels = {**held.channels, name: 0.0 * held.time}
    return JointLog(log.name, log.device, log.measured, Signals(held.time, channels, {**held.units, name: "rad"}))


@pytest.mark.parametrize("device", [flexible(), servo(), load_device("cubic_aa_vsa")], ids=lambda d: d.name)
def test_what_is_no_candidate_is_told(device):
    log = log_of(flexible() if device.drive == "torque" else servo(), (), seed=5, duration=2.0)
    log = JointLog(log.name, device, log.measured, log.commands)
    offered = {location.name for location in locations(device, log)}
    reasons = " ".join(missing_effects(device, log))
    for name in EFFECTS:
        meaningless = EFFECTS[name].of_goal and device.drive != "position"
        assert (name in offered) != (name in reasons) or name in MEASUREMENT_ONLY or meaningless, name


def test_a_torque_driven_joint_beside_a_neighbour_can_have_all_but_those_of_a_goal():
    log = beside(log_of(flexible(), (), seed=5, duration=2.0), "neighbour")
    every = {kind.name for kind in EFFECTS.values() if not kind.of_goal}
    assert {location.name for location in locations(log.device, log)} | set(MEASUREMENT_ONLY) == every
    assert missing_effects(log.device, log) == ()


def test_an_encoder_that_was_not_recorded_is_no_candidate():
    log = log_of(flexible(), (), seed=5, duration=2.0)
    bare = Signals(log.measured.time, {"q": log.measured["q"]}, {"q": "rad"})
    unseen = JointLog("unseen", log.device, bare, log.commands)
    assert Location("encoder_offset", "sensor", 1) in locations(log.device, log)
    assert Location("encoder_offset", "sensor", 1) not in locations(log.device, unseen)
    assert Location("encoder_offset", "sensor", 0) in locations(log.device, unseen)


PAIR = load_device("cubic_aa_vsa")
BOTH = Location("torque_gain", "motor", 0)
EACH = tuple(Location("torque_gain", "motor", i) for i in (1, 2))
SCALES = Scales(
    torque=np.array([0.5, 0.3, 0.2]), missing=np.full(3, np.inf), speed=np.array([2.0, 3.0, 4.0]),
    peak=np.array([0.7, 0.9]), slew=5.0, angle=0.4, range=np.array([-1.2, -1.0, -0.5, 0.5, 1.0, 1.2]),
    travel=np.full(3, 2.0), deflection=0.2, stretch=0.2, duration=8.0, busy=((1.0, 2.0),), gravity=np.inf,
    friction=np.zeros(3),    orders=((1.0, 2.0), (3.0, 4.0), (5.0, 6.0)),
)  # fmt: skip


def pair_log() -> JointLog:
    log = log_of(flexible(), (), seed=5, duration=2.0)
    return JointLog(log.name, PAIR, log.measured, log.commands)


def test_both_motors_alike_are_one_candidate_beside_each():
    found = locations(PAIR, pair_log())
    assert {BOTH, *EACH, Location("backlash", "transmission", 0)} <= set(found)
    assert all(BOTH.overlaps(each) and each.overlaps(BOTH) for each in EACH)
    assert not EACH[0].overlaps(EACH[1]) and not BOTH.overlaps(Location("torque_bias", "motor", 1))
    assert BOTH.spots == (("motor", 1), ("motor", 2)) and Location("torque_gain", "sensor", 0).spots == (("sensor", 0),)
    assert not Location("coulomb_friction", "link", 0).overlaps(Location("coulomb_friction", "motor", 0))
    assert not [each for each in locations(flexible(), pair_log()) if each.site == "motor" and each.motor == 0]


def test_both_motors_alike_start_as_the_first():
    alike = [each for each in locations(PAIR, pair_log()) if each.site in ("motor", "transmission") and not each.motor]
    assert len(alike) > 10
    for both in alike:
        first = Location(both.name, both.site, 1)
        assert starts(both, SCALES, PAIR) == starts(first, SCALES, PAIR)
        for p in EFFECTS[both.name].parameters:
            assert size_of(p, both, SCALES) == size_of(p, first, SCALES)


def test_every_start_makes_an_effect_whose_other_parameters_are_neutral():
    for location in locations(PAIR, pair_log()):
        for start in starts(location, SCALES, PAIR):
            for direction in start.directions:
                effect = effect_or_none(location, list(direction.values()))
                assert effect is not None and [*effect.parameters] == [
                    p.name for p in EFFECTS[location.name].parameters
                ]


@pytest.mark.parametrize("turned", [0.1, 1.5708, -2.8])
@pytest.mark.parametrize("gravity", [1.3, -0.7])
def test_a_wrong_direction_of_gravity_starts_where_its_parts_along_and_across_say(turned, gravity):
    """A robot on a wall: the torque is linear in both parts for any angle, but far from linear in the angle."""
    link = rigid().link.model_copy(update={"gravity_torque": gravity})
    device = rigid().model_copy(update={"link": link})
    place = Location("gravity_error", "link", 0)
    (start,) = starts(place, SCALES, device)
    torque, angle = (each[name] for each, name in zip(start.directions, ("torque", "angle"), strict=True))
    along, across = 1.2 * gravity * np.cos(turned), 1.2 * gravity * np.sin(turned)
    amounts = [(along - gravity) / torque, across / (gravity * angle)]
    assert combined(place, start, amounts) == pytest.approx([0.2 * gravity, turned])
    assert amount_range(place, start, REACH)[1][1] * angle > 1.0  # gravity may act across alone


def test_every_effect_has_starts_and_a_size():
    """Of an effect without a size every fit would count as its absence. Found in devices of any kind, so asked here."""
    for name in EFFECTS.keys() - {*MEASUREMENT_ONLY}:
        location = Location(name, EFFECTS[name].sites[0], 1 if EFFECTS[name].sites[0] == "motor" else 0)
        sized = size_parameters(location)
        assert set(sized) & {p.name for p in location.parameters}, name
        assert set(sized) <= {p.name for p in EFFECTS[name].all_parameters}, name


def test_no_effect_is_put_twice_at_one_place():
    """As the simulator refuses it: an effect of motor 1 beside the same one of both motors."""
    rng = np.random.default_rng(3)
    moved, residual = rng.normal(size=(3, 40, 1)), rng.normal(size=40)
    tried = [Direction(at, Start(({"gain": 1.1},), ("gain",)), each) for at, each in zip((BOTH, *EACH), moved)]
    base = Fit((), np.zeros(1), float(residual @ residual), residual, np.empty(0))
    pairs = [{place for place, _ in members} for _, members in ranked_pairs(base, rng.normal(size=(40, 1)), tried)]
    assert pairs == [set(EACH)]

    class Nothing:
        """A residual that nobody is to ask for."""

    there = Fit((BOTH.effect({"gain": 0.9}),), np.zeros(1), 1.0, residual, np.empty(0))
    assert directions(Nothing(), there, EACH, SCALES) == []


def test_both_motors_are_told_and_drawn_as_both():
    assert str(BOTH) == "torque_gain at both motors" and str(EACH[1]) == "torque_gain at motor 2"
    assert (
        site_words("motor", 0) == "at both motors alike"
        and site_words("transmission", 0) == "in both transmissions alike"
    )
    sketch = JointSketch(arrangement="antagonistic", drive="torque", motors_seen=(True, True), torque_seen=True)
    shares = {("motor", 0): 0.6, ("motor", 2): 0.2, ("transmission", 0): 0.15}
    drawn = environment().get_template("page.svg").module.joint(JointPicture(sketch, shares))
    assert [drawn.count(f">{share} %<") for share in (60, 80, 15)] == [1, 1, 2]


def test_an_effect_and_one_that_contains_it_overlap_at_the_same_site():
    coulomb, stribeck = (Location(f"{name}_friction", "link", 0) for name in ("coulomb", "stribeck"))
    assert coulomb.overlaps(stribeck) and stribeck.overlaps(coulomb)
    assert not coulomb.overlaps(Location("viscous_friction", "link", 0))
    assert not stribeck.overlaps(Location("coulomb_friction", "motor", 1))


def test_a_late_stamp_of_the_only_angle_is_a_candidate_where_the_drive_can_show_it():
    both = log_of(flexible(), (), seed=1, duration=1.0)
    link = replace(both, measured=Signals(both.measured.time, {"q": both.measured["q"]}, {"q": "rad"}))

    def stamps(log):
        return [each.motor for each in locations(log.device, log) if each.name == "channel_skew"]

    assert stamps(both) == [0, 1] and stamps(link) == []
    assert stamps(log_of(rigid(), (), seed=2, duration=1.0)) == [0]
