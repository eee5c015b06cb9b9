"""Numbers that must not change unnoticed; `python tests/test_golden.py` rewrites golden.json, a commit states why."""

import json
import tempfile
from pathlib import Path

import numpy as np
import pytest
from via_core.bags.importing import import_recordings
from via_core.bags.joints import joint_signals
from via_core.bags.reader import read_bag
from via_core.devices import load_device
from via_core.signals import Signals
from via_estimators.contract import summarise
from via_estimators.methods import estimator_for
from via_estimators.rows import estimate_bag
from via_gap.logs.replay import gap_to, simulated_log
from via_sim.effects import Effect
from via_sim.plants import JointPlant
from via_sim.simulate import simulate

GOLDEN = Path(__file__).with_name("golden.json")
SAMPLE = Path(__file__).resolve().parent.parent / "via_core" / "via_core" / "samples" / "maccepavd"
CLOSE = 1e-6  # relative: rounding of another processor or compiler passes, another result does not


def real_runs() -> dict[str, dict[str, float]]:
    """Damping, stiffness, their standard deviations and the gap of every good run of the sample."""
    device, numbers = load_device("maccepavd"), {}
    with tempfile.TemporaryDirectory() as folder:
        for file in import_recordings(SAMPLE, "maccepavd", folder).accepted:
            bag = read_bag(file.bag)
            estimates = estimate_bag(bag, device, estimator_for(device)).estimates
            measured, commands, _ = joint_signals(bag, device)
            row = {"nrmse": gap_to(simulated_log(device, measured, commands), measured).nrmse}
            for output in ("damping", "stiffness"):
                value, sd, _ = summarise(estimates, output)
                row |= {output: value, f"{output}_deviation": sd}
            numbers[file.bag.name] = row
    return numbers


def simulated_joint() -> dict[str, dict[str, float]]:
    """A stiff antagonistic joint with Coulomb friction and backlash, and what is estimated from it.

    Ideal sensors: a quantiser would make a whole step of a rounding error.
    """
    device, time = load_device("cubic_aa_vsa"), np.arange(4000) * 1e-3
    ramp = np.minimum(time / 0.3, 1.0)
    motor = np.stack([ramp * (60 + 20 * np.sin(np.pi * time)), -ramp * (60 + 20 * np.sin(1.6 * np.pi * time))], axis=1)
    commands = Signals(time, {"motor": motor}, {"motor": "N m"}, frozenset({"motor"}))
    effects = (
        Effect("coulomb_friction", "link", {"torque": 0.05}),
        Effect("backlash", "transmission", {"gap": 0.02}, motor=1),
    )
    run = simulate(JointPlant.from_device(device).with_effects(effects), commands, 3.999, 1000.0)
    estimates = estimator_for(device).run(run.measured)
    value, sd = estimates.column("stiffness")
    return {
        "cubic_aa_vsa": {
            "q": float(run.truth["q"][-1]),
            "q_velocity": float(run.truth["q_velocity"][-1]),
            "theta_1": float(run.measured["theta"][-1, 0]),
            "stiffness": float(value[-1]),
            "stiffness_deviation": float(sd[-1]),
        }
    }


def measured_now() -> dict[str, dict[str, float]]:
    return real_runs() | simulated_joint()


def test_numbers_equal_the_recorded_ones():
    recorded, now = json.loads(GOLDEN.read_text(encoding="utf-8")), measured_now()
    assert now.keys() == recorded.keys()
    for name, row in recorded.items():
        assert now[name] == pytest.approx(row, rel=CLOSE), name


if __name__ == "__main__":
    GOLDEN.write_text(json.dumps(measured_now(), indent=1) + "\n", encoding="utf-8")
