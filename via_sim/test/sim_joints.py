"""Small test devices, each the simplest with one property."""

from via_core.devices import Device, parse_device

LINK = "{inertia: 0.02, viscous_friction: 0.0}"


def device(arrangement: str, link: str = LINK, rest: str = "") -> Device:
    """A device with ideal sensors at 1 kHz."""
    text = f"""
name: joint
title: test joint
source: [made for a test]
confidence: assumed
arrangement: {arrangement}
link: {link}
sensors: {{rate: 1000.0}}
{rest}"""
    return parse_device(text, "test")


def rigid(link: str = LINK) -> Device:
    return device("rigid", link)


def positioned(link: str = LINK, servo: str = "{kp: 4.0, kd: 0.1}", rest: str = "") -> Device:
    """A rigid joint whose drive is commanded by a goal angle."""
    return device("rigid", link, f"drive: position\nservo: {servo}\n{rest}")


def flexible(
    stiffness: float = 10.0, link: str = LINK, motor: str = "{inertia: 0.01, viscous_friction: 0.0}"
) -> Device:
    spring = f"{{law: linear, stiffness: {stiffness}, max_deflection: 3.0}}"
    return device("flexible", link, f"motors: [{motor}]\nsprings: [{spring}]")


def antagonistic(link: str = LINK, motor: str = "{inertia: 0.01, viscous_friction: 0.3}") -> Device:
    spring = "{law: odd_polynomial, odd_coefficients: [5.0, 10.0], max_deflection: 2.0}"
    return device("antagonistic", link, f"motors: [{motor}, {motor}]\nsprings: [{spring}, {spring}]")


def servo_flexible(stiffness: float = 10.0, link: str = LINK) -> Device:
    spring = f"{{law: linear, stiffness: {stiffness}, max_deflection: 3.0}}"
    return device("flexible", link, f"drive: servo\nmotors: [{{bandwidth: 40.0}}]\nsprings: [{spring}]")


def serial_servo() -> Device:
    """Two servos, the second pretensions the spring; a damper at the link."""
    spring = (
        "{law: maccepa, k: 394.0, lever: 0.036, base: 0.135, free_length: 0.099, drum_radius: 0.015, "
        "max_deflection: 1.5}"
    )
    return device(
        "serial",
        "{inertia: 0.0036, viscous_friction: 0.0077}",
        f"drive: servo\nmotors: [{{bandwidth: 25.0}}, {{bandwidth: 25.0}}]\nsprings: [{spring}]\n"
        "damper: {site: link, map: linear, minimum: 0.0, maximum: 0.05}",
    )


# Friction that depends on the torques from both sides, as M5 and M6 of friction.py.
BOTH_SIDES = {
    "coefficient": 0.1, "counter_coefficient": 0.2, "stribeck": 0.15, "counter_stribeck": 0.05, "velocity": 0.7,
    "quadratic": 0.1,
}  # fmt: skip
# What a periodic effect may have beside its first harmonic.
RIPPLES = {"amplitude_2": 0.05, "order_2": 3.5, "phase_2": 1.0, "amplitude_8": 0.02, "order_8": 24.0, "phase_8": -0.4}
ENCODER_ERRORS = {
    "order": 2.0,
    "amplitude_2": 0.01,
    "order_2": 7.5,
    "phase_2": 1.0,
    "amplitude_4": 0.005,
    "order_4": 36.0,
}
GEAR_ERRORS = {"amplitude_2": 0.01, "order_2": 7.5, "phase_2": 1.0, "amplitude_4": 0.005, "order_4": 21.0}
# Beside what an effect must have.
MORE = {
    "gear_error": GEAR_ERRORS, "torque_ripple": RIPPLES, "encoder_eccentricity": ENCODER_ERRORS,
    "load_dependent_friction": BOTH_SIDES,
}  # fmt: skip

# A moderate amount of every effect, for joints that move with about 1 rad, 5 rad/s and 1 N m.
SIZES = {
    "coulomb_friction": {"torque": 0.1},
    "asymmetric_coulomb": {"forward": 0.15, "backward": 0.05},
    "stribeck_friction": {"breakaway": 0.3, "kinetic": 0.1, "velocity": 0.5},
    "viscous_friction": {"coefficient": 0.05},
    "asymmetric_viscous": {"forward": 0.08, "backward": 0.02},
    "quadratic_drag": {"coefficient": 0.02},
    "presliding_friction": {"torque": 0.1, "stiffness": 2.0},
    "load_dependent_friction": {"coefficient": 0.1},
    "backlash": {"gap": 0.05},
    "hysteresis": {"torque": 0.1, "stiffness": 3.0},
    "spring_damping": {"coefficient": 0.03},
    "spring_law": {"scale": 0.9, "hardening": 3.0},
    "stiffness_drift": {"rate": 0.1},
    "preset_error": {"offset": 0.05},
    "gear_error": {"amplitude": 0.03, "order": 3.0, "phase": 0.4},
    "joint_coupling": {"stiffness": 0.3},
    "torque_gain": {"gain": 0.8},
    "torque_bias": {"torque": 0.1},
    "torque_ripple": {"amplitude": 0.1, "order": 7.0, "phase": 0.5},
    "torque_saturation": {"limit": 0.8},
    "torque_deadband": {"threshold": 0.25},
    "dead_zone": {"width": 0.1},
    "position_deadband": {"width": 0.1},
    "position_gain": {"gain": 0.8},
    "integral_action": {"rate": 3.0, "start": 0.2},
    "velocity_feedforward": {"share": 0.7},
    "actuator_lag": {"time_constant": 0.02},
    "actuator_delay": {"delay": 0.0043},
    "speed_limit": {"limit": 2.5},
    "encoder_offset": {"offset": 0.05},
    "encoder_eccentricity": {"amplitude": 0.03, "phase": 0.7},
    "encoder_quantisation": {"quantum": 0.01},
    "channel_skew": {"delay": 0.0043},
    "payload": {"mass": 0.1, "distance": 0.2},
    "link_inertia": {"inertia": 0.005},
    "gravity_error": {"torque": 0.1, "angle": 0.1},
    "link_spring": {"stiffness": 0.2, "rest": 0.3},
    "contact": {"angle": 0.2, "stiffness": 30.0, "damping": 0.1, "side": 1.0},
    "external_torque": {"torque": 0.2, "start": 0.1, "stop": 2.0},
}
