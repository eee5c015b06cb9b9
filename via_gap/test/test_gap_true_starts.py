"""Starts of segments without encoder errors: the compiled loop against numpy, axis by axis."""

import numpy as np
from via_core.devices import load_device
from via_gap.residual.true_starts import correct
from via_sim.effects import Effect
from via_sim.joint.encoders import true_motion
from via_sim.joint.parameters import P
from via_sim.plants import JointPlant

RATE, AXES = 500.0, np.array([0, 2])


def test_late_eccentric_and_shifted_encoders_are_undone_at_every_tick():
    plant = JointPlant.from_device(load_device("cubic_aa_vsa"))
    late = Effect("channel_skew", "timing", {"delay": 0.0031}, 2)
    eccentric = Effect("encoder_eccentricity", "sensor", {"amplitude": 0.03, "order": 1.0, "phase": 0.4}, 0)
    shifted = Effect("encoder_offset", "sensor", {"offset": 0.2}, 2)
    rows = np.stack([plant.parameters, *(plant.with_effects([each]).parameters for each in (late, eccentric, shifted))])
    start = np.cumsum(np.random.default_rng(0).normal(size=(400, 6)), axis=0)
    ticks = np.array([0, 150, 398, 399])  # the last ones have no measurement as late as their skew
    for row in rows:
        found = start[ticks]
        correct(np.repeat(row[None], len(ticks), axis=0), start, ticks, AXES, RATE, found)
        expected = start[ticks]
        for axis in AXES:
            at = np.minimum(ticks + row[P.skew + axis] * RATE, 399.0)
            for place in (axis, 3 + axis):
                expected[:, place] = np.interp(at, np.arange(400), start[:, place])
            expected[:, axis], expected[:, 3 + axis] = np.array(
                [true_motion.py_func(row, axis, *each) for each in expected[:, [axis, 3 + axis]]]
            ).T
        np.testing.assert_allclose(found, expected, atol=1e-12)
    assert np.any(rows[1:] != rows[0], axis=1).all()
