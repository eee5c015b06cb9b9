"""Spring laws against their energies, finite differences, closed forms and published sources."""

from math import asin, cos, cosh, pi, sin, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from via_core.devices import device_names, load_device
from via_core.errors import ParameterError
from via_core.springs import (
    CubicSpring,
    ExponentialSpring,
    FourBarSpring,
    LinearSpring,
    MaccepaSpring,
    OddPolynomialSpring,
    SinhSpring,
    SpringLaw,
    TwoLeverSpring,
)

EDINBURGH = {
    "k": 424.0,
    "rest_length": 0.02737,
    "motor_lever": 0.026,
    "link_lever": 0.026,
    "offset": 0.027,
    "distance": 0.081,
}


def polynomial_energy(spring: SpringLaw, phi: float, preset: float) -> float:
    return sum(c * phi ** (2 * p + 2) / (2 * p + 2) for p, c in enumerate(spring.coefficients()))


def sinh_energy(spring: SinhSpring, phi: float, preset: float) -> float:
    return spring.k / spring.a * cosh(spring.a * phi)


def exponential_energy(spring: ExponentialSpring, phi: float, preset: float) -> float:
    return spring.k / spring.a * (spring.rise * np.exp(spring.a * phi) + spring.fall * np.exp(-spring.a * phi))


def four_bar_energy(spring: FourBarSpring, phi: float, preset: float) -> float:
    return spring.k * (asin(spring.ratio * sin(0.5 * phi)) - 0.5 * phi) ** 2  # U = k beta^2, eq. (50) is its derivative


def maccepa_energy(spring: MaccepaSpring, phi: float, preset: float) -> float:
    tip = spring.lever * np.array([np.cos(phi), np.sin(phi)])
    length = float(np.linalg.norm(np.array([spring.base, 0.0]) - tip))
    return 0.5 * spring.k * (length + spring.drum_radius * preset - spring.free_length) ** 2


def two_lever_energy(spring: TwoLeverSpring, phi: float, preset: float) -> float:
    q, u = phi + preset, -spring.side * preset
    link_tip = spring.side * spring.link_lever * np.array([np.cos(q), np.sin(q)])
    across = spring.side * (spring.offset + spring.motor_lever * np.sin(u))
    motor_tip = np.array([across, spring.motor_lever * np.cos(u) - spring.distance])
    return 0.5 * spring.k * (float(np.linalg.norm(motor_tip - link_tip)) - spring.rest_length) ** 2


LAWS = {
    "linear": (LinearSpring(1.0, 12.5), polynomial_energy),
    "cubic": (CubicSpring(1.5, 10.0), polynomial_energy),
    "polynomial": (OddPolynomialSpring(1.0, (3.0, -2.0, 5.0, 0.5)), polynomial_energy),
    "sinh": (SinhSpring(0.8, 0.0222, 6.7328), sinh_energy),
    "exponential": (ExponentialSpring(0.27, 1.6e5, 1.21e-6, 2.38e-6, 8.71), exponential_energy),
    "four_bar": (FourBarSpring(1.2, 0.5, 1.7), four_bar_energy),
    "maccepa": (MaccepaSpring(1.57, 394.0, 0.036, 0.135, 0.099, 0.015), maccepa_energy),
    "two_lever_1": (TwoLeverSpring(4.3, **EDINBURGH, side=-1.0), two_lever_energy),
    "two_lever_2": (TwoLeverSpring(4.3, **EDINBURGH, side=1.0), two_lever_energy),
}
EVERY_LAW = pytest.mark.parametrize(("spring", "energy"), LAWS.values(), ids=LAWS.keys())
PRESETS = (0.0, 0.4, 1.3)


def inside(spring: SpringLaw) -> np.ndarray:
    return np.linspace(-0.97, 0.97, 33) * min(spring.max_deflection, 1.5)


@EVERY_LAW
def test_torque_is_the_slope_of_an_independent_energy(spring, energy) -> None:
    h = 1e-5
    for preset in PRESETS:
        for phi in inside(spring):
            slope = (energy(spring, phi + h, preset) - energy(spring, phi - h, preset)) / (2 * h)
            assert float(spring.torque(phi, preset)) == pytest.approx(slope, rel=1e-6, abs=1e-8)


@EVERY_LAW
def test_stiffness_is_the_slope_of_the_torque(spring, energy) -> None:
    h = 1e-6
    phi = inside(spring)
    for preset in PRESETS:
        slope = (spring.torque(phi + h, preset) - spring.torque(phi - h, preset)) / (2 * h)
        np.testing.assert_allclose(spring.stiffness(phi, preset), slope, rtol=1e-6, atol=1e-6)


@EVERY_LAW
def test_stiffness_slope_is_the_slope_of_the_stiffness(spring, energy) -> None:
    phi, h = np.linspace(-0.9, 0.9, 41) * spring.max_deflection, 1e-5
    for preset in PRESETS:
        slope = (spring.stiffness(phi + h, preset) - spring.stiffness(phi - h, preset)) / (2.0 * h)
        scale = float(np.max(np.abs(slope)))
        np.testing.assert_allclose(spring.stiffness_slope(phi, preset), slope, rtol=1e-6, atol=1e-6 * scale)


@EVERY_LAW
def test_oddness_is_as_declared(spring, energy) -> None:
    phi = inside(spring)
    mirrored = np.allclose(spring.torque(-phi, 0.7), -spring.torque(phi, 0.7), rtol=1e-12, atol=1e-15)
    assert mirrored == spring.odd


@EVERY_LAW
def test_shapes_broadcast_and_inputs_stay_untouched(spring, energy) -> None:
    phi = inside(spring).reshape(3, 11)
    phi.flags.writeable = False
    torque = spring.torque(phi, np.array([[0.0], [0.4], [1.3]]))
    assert torque.shape == (3, 11)
    assert torque[2, 7] == spring.torque(phi[2, 7], 1.3)
    assert spring.stiffness(0.1).shape == ()
    assert spring.torque([]).shape == (0,)


INCREASING = [name for name in LAWS if not name.startswith("two_lever")]


@pytest.mark.parametrize("name", INCREASING)
@given(share=st.floats(-1.0, 1.0), preset=st.floats(0.0, 1.5))
def test_inverse_undoes_torque(name: str, share: float, preset: float) -> None:
    spring = LAWS[name][0]
    torque = float(spring.torque(share * spring.max_deflection, preset))
    found = spring.inverse(torque, preset)
    assert abs(found) <= spring.max_deflection
    assert float(spring.torque(found, preset)) == pytest.approx(torque, rel=1e-9, abs=1e-12)
    if float(spring.stiffness(share * spring.max_deflection, preset)) > 1e-2:
        assert found == pytest.approx(share * spring.max_deflection, abs=1e-9)


@pytest.mark.parametrize("name", INCREASING)
def test_inverse_refuses_what_the_stop_does_not_allow(name: str) -> None:
    spring = LAWS[name][0]
    beyond = 1.001 * float(spring.torque(spring.max_deflection))
    with pytest.raises(ParameterError, match=r"no deflection within .* N m; the spring reaches"):
        spring.inverse(beyond)
    with pytest.raises(ParameterError, match="nan"):
        spring.inverse(float("nan"))
    assert spring.inverse(float(spring.torque(spring.max_deflection))) == spring.max_deflection
    assert spring.inverse(float(spring.torque(-spring.max_deflection))) == -spring.max_deflection


def test_cubic_spring_is_equation_35() -> None:
    assert float(CubicSpring(1.0, 10.0).torque(-0.5)) == -1.25
    assert float(CubicSpring(1.0, 10.0).stiffness(-0.5)) == 7.5


@pytest.mark.parametrize(("name", "ratio"), [("vsa2", 1.7), ("vsa2_v2", 1.5), ("vsa2_v3", 1.7)])
def test_vsa_2_in_the_documents_unit(name: str, ratio: float) -> None:
    spring = load_device(name).springs[0]
    # beta' (0) = (C - 1)/2, so sigma(0) = 2 k beta'^2 with k = 500 N mm/rad: 122.5 or 62.5 N mm/rad
    assert 1e3 * float(spring.stiffness(0.0)) == pytest.approx(2.0 * 500.0 * (0.5 * (ratio - 1.0)) ** 2, rel=1e-12)
    # eqs. (50)-(51) at .8 rad, with C sin(phi/2) = sin(beta + phi/2) differentiated by hand
    beta = asin(ratio * sin(0.4)) - 0.4
    slope = 0.5 * ratio * cos(0.4) / cos(beta + 0.4) - 0.5
    assert 1e3 * float(spring.torque(0.8)) == pytest.approx(2.0 * 500.0 * beta * slope, rel=1e-12)


@pytest.mark.parametrize(("name", "expected"), [("qbmove_a", 3.8), ("qbmove_b", 8.5), ("qbmove_alterego", 162.0)])
def test_qbmove_sets_give_the_known_stiffness_at_preset_point_six(name: str, expected: float) -> None:
    device = load_device(name)
    assert float(device.stiffness(0.0, device.motor_angles(0.0, 0.6))) == pytest.approx(expected, rel=0.01)


def bavs_plugin(q1: float, q2: float, link: float) -> tuple[float, float]:
    """Torque on the link and stiffness, as the source writes them (deflections there are theta - q)."""
    a, b, k, k_e = 1.21e-6, 2.38e-6, 1.6e5, 8.71
    e1, e2 = k_e * (q1 - link), k_e * (q2 - link)
    t1 = -k * (np.exp(-e1) * (a - b * np.exp(2 * e1)))
    t2 = -k * (np.exp(-e2) * (b - a * np.exp(2 * e2)))
    sigma = -k_e * t1 + 2 * k_e * k * b * np.exp(e1) - k_e * t2 + 2 * k_e * k * a * np.exp(e2)
    return t1 + t2, sigma


def test_bavs_equals_its_source() -> None:
    device = load_device("dlr_bavs")
    for q, theta in ((0.03, (0.2, -0.1)), (-0.05, (0.1, 0.1)), (0.0, (0.2, -0.2))):
        torque, sigma = bavs_plugin(*theta, q)
        assert device.torque_each(q, theta).sum() == pytest.approx(-torque, rel=1e-12, abs=1e-12)
        assert float(device.stiffness(q, theta)) == pytest.approx(sigma, rel=1e-12)


def edinburgh_source(q: float, u: tuple[float, float]) -> float:
    """Torque on the link as the source writes it, with both servo angles counted outwards."""
    a, length, h, d, k, rest = 0.026, 0.026, 0.027, 0.081, 424.0, 0.02737
    arm = a * np.array([np.cos(q), np.sin(q)])
    total = 0.0
    for side, servo in ((-1.0, u[0]), (1.0, u[1])):
        spring = np.array([side * (h + length * np.sin(servo)), length * np.cos(servo) - d]) - side * arm
        size = np.linalg.norm(spring)
        force = k * (size - rest) * spring / size
        total += side * (arm[0] * force[1] - arm[1] * force[0])
    return total


def test_edinburgh_vsa_equals_its_source() -> None:
    device = load_device("edinburgh_vsa")
    rng = np.random.default_rng(5)
    for q, u1, u2 in zip(rng.uniform(-1.1, 1.1, 50), rng.uniform(0, pi, 50), rng.uniform(0, pi, 50), strict=True):
        ours = device.torque_each(q, (u1, -u2)).sum()
        assert ours == pytest.approx(-edinburgh_source(q, (u1, u2)), rel=1e-10, abs=1e-12)


def test_edinburgh_vsa_turns_with_its_equilibrium_and_stiffens_with_its_preset() -> None:
    device = load_device("edinburgh_vsa")
    at_rest = device.torque_each(0.0, device.motor_angles(0.0, 0.6)).sum()
    assert at_rest == pytest.approx(0.0, abs=1e-15)
    assert device.torque_each(0.0, device.motor_angles(0.2, 0.6)).sum() < -1e-3  # pulled towards +
    soft, stiff = device.stiffness(0.0, device.motor_angles(0.0, [0.1, 1.0]))
    assert 0.0 < soft < stiff


@pytest.mark.parametrize("name", device_names())
def test_every_shipped_spring_increases_up_to_its_stop(name: str) -> None:
    for spring in load_device(name).springs:
        if isinstance(spring, TwoLeverSpring):
            continue
        phi = np.linspace(-1.0, 1.0, 401) * spring.max_deflection
        assert np.all(spring.stiffness(phi, 0.5) >= 0.0)


@pytest.mark.parametrize(
    ("make", "names"),
    [
        (lambda: LinearSpring(1.0, -1.0), "k must be > 0"),
        (lambda: LinearSpring(1.0, float("nan")), "k must be finite"),
        (lambda: LinearSpring(0.0, 1.0), "max_deflection must be > 0"),
        (lambda: LinearSpring(float("inf"), 1.0), "max_deflection must be finite"),
        (lambda: OddPolynomialSpring(1.0, ()), "needs 1 to 8 values"),
        (lambda: OddPolynomialSpring(1.0, (1.0,) * 9), "needs 1 to 8 values"),
        (lambda: OddPolynomialSpring(1.0, (0.0, 0.0)), "must not all be 0"),
        (lambda: OddPolynomialSpring(1.0, (1.0, -2.0, 1.0)), r"negative stiffness of .* at a deflection of 0\.77"),
        (lambda: SinhSpring(1.0, 0.0, 2.0), "k must be > 0"),
        (lambda: SinhSpring(1.0, 1.0, -2.0), "a must be > 0"),
        (lambda: ExponentialSpring(1.0, 1.0, 0.0, 1.0, 1.0), "rise must be > 0"),
        (lambda: FourBarSpring(1.0, -1.0, 1.7), "k must be > 0"),
        (lambda: FourBarSpring(1.0, 1.0, 1.0), "ratio must be > 1"),
        (lambda: FourBarSpring(1.26, 1.0, 1.7), r"below the linkage's dead point 1\.2577"),
        (lambda: MaccepaSpring(1.0, 394.0, 0.1, 0.1, 0.099, 0.015), "lever and base must differ"),
        (lambda: MaccepaSpring(1.0, 394.0, 0.1, 0.2, -0.1, 0.015), "free_length must be > 0"),
        (lambda: TwoLeverSpring(1.0, **EDINBURGH, side=0.0), "side must be -1 or 1"),
        (lambda: TwoLeverSpring(1.0, **{**EDINBURGH, "link_lever": 0.08}, side=1.0), "circles overlap"),
    ],
)
def test_impossible_springs_are_refused(make, names: str) -> None:
    with pytest.raises(ParameterError, match=names):
        make()


def test_polynomial_may_soften_as_long_as_its_stop_comes_first() -> None:
    softening = (1.0, -1.0)  # sigma = 1 - 3 phi^2
    assert float(OddPolynomialSpring(0.5, softening).stiffness(0.5)) == pytest.approx(0.25)
    with pytest.raises(ParameterError, match="negative stiffness"):
        OddPolynomialSpring(0.6, softening)


def test_polynomial_that_just_touches_zero_stiffness_is_allowed() -> None:
    # sigma = 1 - 2 s + s^2 = (1 - s)^2 with s = phi^2
    spring = OddPolynomialSpring(1.5, (1.0, -2.0 / 3.0, 1.0 / 5.0))
    assert float(spring.stiffness(1.0)) == pytest.approx(0.0, abs=1e-12)
    assert float(spring.stiffness(sqrt(2.0))) == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("name", device_names())
def test_the_torque_at_one_deflection_is_that_of_the_array(name: str) -> None:
    for spring in load_device(name).springs:
        phi = np.linspace(-0.9, 0.9, 7) * spring.max_deflection
        assert [spring.torque_at(float(each), 0.1) for each in phi] == spring.torque(phi, 0.1).tolist()
