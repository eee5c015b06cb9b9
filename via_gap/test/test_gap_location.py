"""Every effect of the catalogue is a candidate, or the report says why it is not."""

import pytest
from gap_logs import flexible, log_of, servo
from via_core.devices import load_device
from via_core.signals import Signals
from via_gap.candidates.location import MEASUREMENT_ONLY, Location, locations, unjudged
from via_gap.logs.log import JointLog
from via_sim.catalogue import EFFECTS


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
    told = " ".join(unjudged(device, log))
    for name in EFFECTS:
        assert (name in offered) != (name in told) or name in MEASUREMENT_ONLY, name


def test_a_torque_driven_joint_beside_a_neighbour_can_have_all_thirty():
    log = beside(log_of(flexible(), (), seed=5, duration=2.0), "neighbour")
    assert {location.name for location in locations(log.device, log)} | set(MEASUREMENT_ONLY) == EFFECTS.keys()
    assert unjudged(log.device, log) == ()


def test_an_encoder_that_was_not_recorded_is_no_candidate():
    log = log_of(flexible(), (), seed=5, duration=2.0)
    blind = Signals(log.measured.time, {"q": log.measured["q"]}, {"q": "rad"})
    unseen = JointLog("unseen", log.device, blind, log.commands)
    assert Location("encoder_offset", "sensor", 1) in locations(log.device, log)
    assert Location("encoder_offset", "sensor", 1) not in locations(log.device, unseen)
    assert Location("encoder_offset", "sensor", 0) in locations(log.device, unseen)
