"""Servo step against the matrix exponential; damper maps against their printed formulas."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm
from via_core.dampers import LINEAR, TWO_STAGE, LinearDamper, TwoStageDamper, damper_value
from via_core.devices import load_device
from via_core.errors import ParameterError
from via_core.servos import servo_acceleration, servo_step

ANGLE = st.floats(-3.0, 3.0)


@given(x=ANGLE, v=st.floats(-20.0, 20.0), u=ANGLE, w=st.floats(0.5, 200.0), dt=st.floats(0.0, 0.2))
def test_servo_step_is_the_exact_solution(x: float, v: float, u: float, w: float, dt: float) -> None:
    system = np.array([[0.0, 1.0, 0.0], [-w * w, -2.0 * w, w * w], [0.0, 0.0, 0.0]])
    expected = expm(system * dt) @ [x, v, u]
    got = servo_step(x, v, u, w, dt)
    np.testing.assert_allclose(got, expected[:2], rtol=1e-8, atol=1e-8)


def test_servo_steps_compose_and_settle_without_overshoot() -> None:
    whole = servo_step(0.2, -1.0, 0.9, 25.0, 0.03)
    half = servo_step(*servo_step(0.2, -1.0, 0.9, 25.0, 0.012), 0.9, 25.0, 0.018)
    np.testing.assert_allclose(half, whole, rtol=1e-13)
    path = [servo_step(0.0, 0.0, 1.0, 25.0, t)[0] for t in np.linspace(0.0, 1.0, 200)]
    assert max(path) <= 1.0 and path[-1] == pytest.approx(1.0, abs=1e-9)
    assert np.all(np.diff(path) >= 0.0)


def test_servo_acceleration_belongs_to_the_same_servo() -> None:
    h = 1e-4
    x, v = 0.3, -2.0
    _, after = servo_step(x, v, 1.1, 25.0, h)
    _, before = servo_step(x, v, 1.1, 25.0, -h)
    assert servo_acceleration(x, v, 1.1, 25.0) == pytest.approx((after - before) / (2 * h), rel=1e-4)


def test_maccepavd_damper_is_the_published_formula() -> None:
    d_max = 0.0212**2 * 40**2 / (21.2 + 25.3)
    u = np.linspace(-0.5, 1.5, 201)
    expected = d_max * np.clip(u / 0.5, 0, 1) + 0.848 * d_max * np.clip((u - 0.5) / 0.5, 0, 1)
    np.testing.assert_allclose(load_device("maccepavd").damping_of(u), expected, rtol=1e-12)


def test_linear_damper_covers_the_range_of_equation_80() -> None:
    t = np.linspace(0.0, 20.0, 400)
    wanted = 1 + 1.4 * np.sin(0.05 * np.pi * t) ** 2 + 1.7 * np.sin(0.1 * np.pi * t) ** 2
    damper = LinearDamper(site="link", minimum=1.0, maximum=4.1)
    np.testing.assert_allclose(damper.value((wanted - 1.0) / 3.1), wanted, rtol=1e-12)
    np.testing.assert_array_equal(damper.value([[-1.0, 2.0]]), [[1.0, 4.1]])


LINEAR_DAMPER = LinearDamper(site="link", minimum=0.2, maximum=3.0)
TWO_STAGES = TwoStageDamper(site="link", minimum=0.1, stage=2.0, second=0.5)


@pytest.mark.parametrize("damper", [LINEAR_DAMPER, TWO_STAGES])
def test_damping_never_falls_with_the_command_and_kernel_equals_method(damper) -> None:
    u = np.linspace(-0.2, 1.2, 57)
    values = damper.value(u)
    assert np.all(np.diff(values) >= 0.0) and values[0] == damper.minimum
    assert {LINEAR, TWO_STAGE} == {0, 1}
    for command, value in zip(u, values, strict=True):
        assert damper_value(damper.kind, damper.coefficients(), command) == value


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: replace(LINEAR_DAMPER, minimum=-0.1), "minimum must be finite and >= 0"),
        (lambda: replace(LINEAR_DAMPER, maximum=float("nan")), "maximum must be finite"),
        (lambda: replace(LINEAR_DAMPER, minimum=3.0), "must grow with the command"),
        (lambda: replace(LINEAR_DAMPER, minimum=4.0), "must grow with the command"),
        (lambda: replace(TWO_STAGES, stage=0.0), "must grow with the command"),
        (lambda: replace(TWO_STAGES, second=-0.5), "second must be finite and >= 0"),
    ],
)
def test_impossible_dampers_are_refused(make, message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        make()
