"""Arms of flexible joints: bodies against closed forms and finite differences, springs per joint, refused files."""

from dataclasses import replace
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from via_core.errors import DeviceError, ParameterError
from via_core.vsa_arms import inertia_of, load_vsa_arm, vsa_arm_names

ARMS = [load_vsa_arm(name) for name in vsa_arm_names()]
EVERY_ARM = pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
SHIPPED = Path(str(resources.files("via_core").joinpath("vsa_arms")))


def motion(arm, seed):
    random = np.random.default_rng(seed)
    return random.uniform(-1.5, 1.5, (3, arm.n))


def test_planar_arm_equals_the_textbook_equations():
    """Two bodies in the vertical plane; a positive angle about y turns x downwards, where gravity pulls."""
    arm = load_vsa_arm("reference_2dof")
    (q1, q2), (v1, v2), _ = motion(arm, 1)
    q, v = np.array([q1, q2]), np.array([v1, v2])
    m1, m2, I1, I2, l1, c1, c2, g = 3.0, 2.2, 0.045, 0.035, 0.4, 0.2, 0.2, 9.81
    far, near = I2 + m2 * c2**2, m2 * l1 * c2 * np.cos(q2)
    M = [[I1 + m1 * c1**2 + m2 * l1**2 + far + 2.0 * near, far + near], [far + near, far]]
    h = m2 * l1 * c2 * np.sin(q2)
    centrifugal = [-h * (2.0 * v1 * v2 + v2**2), h * v1**2]
    low = -m2 * g * c2 * np.cos(q1 + q2)
    gravity = [-(m1 * c1 + m2 * l1) * g * np.cos(q1) + low, low]
    assert arm.inertia(q) == pytest.approx(np.array(M), rel=1e-12)
    assert arm.coriolis(q, v) @ v == pytest.approx(centrifugal, rel=1e-12)
    assert arm.gravity(q) == pytest.approx(gravity, rel=1e-12)


def test_four_joints_with_two_of_them_still_are_the_planar_arm():
    four, two = load_vsa_arm("reference_4dof"), load_vsa_arm("reference_2dof")
    q, v, a = np.zeros((3, 4))
    q[[1, 3]], v[[1, 3]], a[[1, 3]] = motion(two, 2)
    collar = (0.01 + 1.5 * 0.05**2) * a[1] - 1.5 * 9.81 * 0.05 * np.cos(q[1])
    expected = two.link_torque(q[[1, 3]], v[[1, 3]], a[[1, 3]]) + np.array([collar, 0.0])
    assert four.link_torque(q, v, a)[[1, 3]] == pytest.approx(expected, rel=1e-12)


@EVERY_ARM
@settings(deadline=None, max_examples=20)
@given(seed=st.integers(1, 9999))
def test_bodies_fit_together(arm, seed):
    q, v, a = motion(arm, seed)
    M, C, h = arm.inertia(q), arm.coriolis(q, v), 1e-6
    assert np.array_equal(M, M.T)
    assert np.linalg.eigvalsh(M).min() > 0.0
    rate = (arm.inertia(q + h * v) - arm.inertia(q - h * v)) / (2.0 * h)
    assert arm.inertia_rate(q, v) == pytest.approx(rate, abs=1e-8)
    assert np.tensordot(v, arm.inertia_slopes(q), 1) == pytest.approx(arm.inertia_rate(q, v), abs=1e-12)
    d = 1e-3
    second = (arm.inertia(q + d * v) - 2.0 * M + arm.inertia(q - d * v)) / d**2
    assert arm.inertia_second(q, v) == pytest.approx(second, abs=1e-4)
    assert np.array_equal(inertia_of(*arm.inertia_terms(q, v))[0], M)
    skew = rate - 2.0 * C
    assert skew == pytest.approx(-skew.T, abs=1e-8)
    torque = arm.link_torque(q, v, a)
    assert torque == pytest.approx(M @ a + C @ v + arm.gravity(q), abs=1e-11)
    assert arm.link_acceleration(q, v, torque) == pytest.approx(a, abs=1e-9)


@EVERY_ARM
def test_the_tip_is_at_the_end_of_the_forearm(arm):
    """Stretched at zero angles; its Jacobian against finite differences."""
    assert arm.tip_position(np.zeros(arm.n)) == pytest.approx([0.85, 0.0, 0.0], abs=1e-12)
    (q, v, _), h = motion(arm, 6), 1e-6
    velocity = (arm.tip_position(q + h * v) - arm.tip_position(q - h * v)) / (2.0 * h)
    assert arm.tip_jacobian(q) @ v == pytest.approx(velocity, abs=1e-8)


@EVERY_ARM
def test_an_arm_at_rest_keeps_its_inertia(arm):
    assert np.array_equal(arm.inertia_second(np.ones(arm.n), np.zeros(arm.n)), np.zeros((arm.n, arm.n)))


@EVERY_ARM
def test_springs_are_those_of_the_joints_and_invert(arm):
    phi = np.linspace(-0.3, 0.4, arm.n)
    torque, stiffness, slope = arm.spring_state(phi)
    for i, spring in enumerate(arm.springs):
        assert torque[i] == float(spring.torque(phi[i]))
        assert stiffness[i] == float(spring.stiffness(phi[i]))
        assert slope[i] == float(spring.stiffness_slope(phi[i]))
    assert arm.deflection(torque) == pytest.approx(phi, abs=1e-12)
    at_rest = [100.0, 60.0] if arm.n == 2 else [100.0, 100.0, 60.0, 60.0]
    assert arm.spring_state(np.zeros(arm.n))[1] == pytest.approx(at_rest)
    with pytest.raises(ParameterError, match="no deflection"):
        arm.deflection(np.full(arm.n, 1e3))


@EVERY_ARM
def test_accelerations_are_equations_9_and_10(arm):
    (q, v, _), (theta, thd, torque) = motion(arm, 4), motion(arm, 5)
    theta, external = q + 0.2 * theta, np.linspace(1.0, 2.0, arm.n)
    arm = replace(arm, motor_friction=np.full(arm.n, 0.4), link_friction=np.full(arm.n, 0.3))
    qdd, thdd = arm.accelerations(q, v, theta, thd, torque, external)
    tau_e = np.array([float(spring.torque(d)) for spring, d in zip(arm.springs, q - theta, strict=True)])
    assert arm.inertia(q) @ qdd + arm.coriolis(q, v) @ v + arm.gravity(q) + 0.3 * v == pytest.approx(
        external - tau_e, abs=1e-9
    )
    assert arm.link_torque(q, v, qdd) == pytest.approx(external - tau_e, abs=1e-9)
    assert arm.motor_inertia * thdd == pytest.approx(torque + tau_e - 0.4 * thd)


@EVERY_ARM
def test_at_rest_springs_carry_gravity_and_motors_carry_the_springs(arm):
    q, still = np.linspace(0.2, 1.0, arm.n), np.zeros(arm.n)
    theta = arm.rest(q)
    tau_e, _, _ = arm.spring_state(q - theta)
    qdd, thdd = arm.accelerations(q, still, theta, still, -tau_e, still)
    assert qdd == pytest.approx(still, abs=1e-9) and thdd == pytest.approx(still, abs=1e-9)
    assert -tau_e == pytest.approx(arm.gravity(q), abs=1e-10)


def test_unknown_limits_are_none(tmp_path):
    text = (SHIPPED / "reference_2dof.yaml").read_text().replace(", torque_limit: 150.0, speed_limit: 12.0", "")
    (tmp_path / "mine.yaml").write_text(text)
    (tmp_path / "reference_2dof.urdf").write_text((SHIPPED / "reference_2dof.urdf").read_text())
    arm = load_vsa_arm(tmp_path / "mine.yaml")
    assert arm.torque_limit.tolist() == [np.inf, 100.0] and arm.speed_limit.tolist() == [np.inf, 12.0]


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("inertia: 0.5", "inertia: 0.0", "joints.0.motor"),
        ("name: elbow", "name: wrist", "wrist"),
        ("law: sinh", "law: sine", "joints.0.spring"),
        ("viscous_friction: 0.0", "viscous_friction: 0.0, coulomb_friction: 0.1", "Coulomb friction"),
        ("urdf: reference_2dof.urdf", "urdf: none.urdf", "none.urdf"),
        ("tip: tip", "tip: hand", "no link 'hand'"),
        ("- name: elbow", "- link_friction: -1.0\n    name: elbow", "joints.1.link_friction"),
        ("joints:", "joints: [", "mine.yaml"),
        ('type="revolute"', 'type="continuous"', "continuous joints"),
        ("<robot name", "<rabbit name", "mine.yaml"),
    ],
)
def test_invalid_arm_files_are_refused(tmp_path, old, new, match):
    yaml, urdf = ((SHIPPED / f"reference_2dof.{kind}").read_text() for kind in ("yaml", "urdf"))
    assert old in yaml + urdf
    (tmp_path / "mine.yaml").write_text(yaml.replace(old, new, 1))
    (tmp_path / "reference_2dof.urdf").write_text(urdf.replace(old, new))
    with pytest.raises(DeviceError, match=match) as error:
        load_vsa_arm(tmp_path / "mine.yaml")
    assert "\n" not in str(error.value)


def test_an_unknown_name_gives_an_error_with_the_shipped_ones():
    with pytest.raises(DeviceError, match="reference_2dof, reference_4dof"):
        load_vsa_arm("reference_9dof")


@pytest.mark.parametrize(
    "change",
    [
        {"motor_inertia": [0.5, 0.0]},
        {"torque_limit": [1.0]},
        {"presets": [0, np.nan]},
        {"tip": "hand"},
        {"springs": ()},
    ],
)
def test_impossible_arms_are_refused(change):
    with pytest.raises(ParameterError):
        replace(load_vsa_arm("reference_2dof"), **change)
