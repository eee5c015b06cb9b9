"""Number 9: energy of cycles, compared with closed forms and with rigid joints."""

import numpy as np
import pytest
from via_bringup.demo.reference import damped_arm
from via_validation.control.bang_bang import free_motion
from via_validation.control.energy import (
    bang_bang_energy,
    energy,
    limit_cycle_energy,
    matched,
    positive_work,
    rigid_torque,
)
from via_validation.control.limit_cycle import limit_cycle_controller


def test_positive_work_of_a_harmonic():
    """A damper dissipates pi A B in a cycle; a spring takes A B and returns it, which does not count."""
    at = np.linspace(0.0, 2.0 * np.pi, 4001)
    angles = 0.3 * np.sin(at)[:, None]
    middle = 0.5 * (at[1:] + at[:-1])[:, None]
    assert positive_work(2.0 * np.cos(middle), angles).sum() == pytest.approx(np.pi * 2.0 * 0.3, rel=1e-5)
    assert positive_work(2.0 * np.sin(middle), angles).sum() == pytest.approx(2.0 * 0.3, rel=1e-5)
    both = positive_work(np.hstack([2.0 * np.sin(middle), -2.0 * np.sin(middle)]), np.hstack([angles, angles]))
    assert both.sum() == pytest.approx(2.0 * 2.0 * 0.3, rel=1e-5)  # one motor brakes while the other drives


def test_bang_bang_costs_less_than_half_of_rigid_joints():
    motion, arm = free_motion(1, 6.0), damped_arm()
    spent = bang_bang_energy(motion)
    assert spent.ratio < 0.45 and spent.ratio_links_only < 0.45 and spent.saturated == 0.0
    # in a cycle the motors supply exactly the energy that the links' friction dissipates
    late = motion.run.since(3.0)
    taken = float((late.velocity**2 @ arm.link_friction).mean()) / motion.frequency
    assert taken < spent.flexible < 2.0 * taken
    # the rigid joints' torque, accelerations differenced
    k = 1000
    qdd = (late.velocity[k + 1] - late.velocity[k - 1]) / 2e-3
    q, v = late.q[k], late.velocity[k]
    expected = arm.inertia(q) @ qdd + arm.coriolis(q, v) @ v + arm.link_friction * v + arm.gravity(q)
    found = rigid_torque(arm, late, rotors=False)[k]
    assert found == pytest.approx(expected, abs=0.02 * np.abs(expected).max())
    assert rigid_torque(arm, late)[k] - found == pytest.approx(arm.motor_inertia * qdd, abs=0.05)
    # half of the cycles cost as much each
    assert energy(arm, late.since(4.5), late.since(4.5).quantity("y")).flexible == pytest.approx(
        spent.flexible, rel=0.02
    )


def test_a_stiffness_matched_to_the_springs_saves_and_another_wastes():
    """The cycle of the reference set-up; too stiff a one drives its motors into their limits, half of it does not."""
    c, spent = limit_cycle_energy(0, duration=2.4)
    assert spent.ratio < 0.25 and spent.saturated == 0.0
    assert 1.3 < c < 1.5  # gravity helps mode 1, and loads its springs
    _, stiff = limit_cycle_energy(0, 3.0, 0.005, duration=1.2)
    assert stiff.ratio > 1.0 and stiff.saturated == 0.0


def test_matched_is_what_still_motors_make():
    """Mode 2 moves sideways, gravity hardly matters and the springs are those without load."""
    assert matched(limit_cycle_controller(1)) == pytest.approx(1.0, abs=0.05)
