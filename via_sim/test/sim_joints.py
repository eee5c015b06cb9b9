"""Small devices the tests share, as text: each the simplest that shows one thing."""

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
