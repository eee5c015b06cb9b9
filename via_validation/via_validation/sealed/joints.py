"""Joints of the benchmark as device files: families with parameters drawn around shipped devices and real robots.

A joint is two device files that differ only in numbers. MuJoCo's model is built from the true one; the diagnosis gets
the nominal one, in which every inertia, friction, stiffness and drive gain is wrong by up to a tolerance of 5 or 10 %.
The nominal file states a tolerance other than the default of 5 %.
"""

from __future__ import annotations

from copy import deepcopy
from math import pi
from typing import Any

import yaml
from numpy.random import Generator
from via_core.devices import Device, parse_device

from via_validation.sealed.stepping import Servo

NAME = "joint"
FAMILIES = ("rigid", "stiff", "series_elastic", "polynomial_pair", "exponential_pair", "variable_damping")
CONTROLLED = "controlled_motor"  # a light motor under velocity or position control; its torque rejects disturbances
POSITIONED = "position_drive"  # a drive that follows a goal angle and reports no torque
PAIRS = ("polynomial_pair", "exponential_pair")  # two torque motors
TOLERANCE = 0.05  # relative, of every inertia, friction and stiffness of the nominal file
WIDE = 0.10  # tolerance in some cases
_STATED = (
    "link_inertia", "link_friction", "gravity", "motor_inertia", "motor_friction", "bandwidth", "spring", "damper",
)  # fmt: skip
_OF_SERVO = ("kp", "kd", "torque_limit")
_SPRING = ("stiffness", "coefficient", "odd_coefficients", "k")  # parameters proportional to a spring's torque
Content = dict[str, Any]


def device_of(content: Content) -> Device:
    """The joint without its position drive; `servo_of` returns that."""
    plain = {key: value for key, value in content.items() if key not in ("drive", "servo", "tolerances")}
    if "servo" not in content and "drive" in content:
        plain["drive"] = content["drive"]
    return parse_device(as_yaml(plain), "joint.yaml")


def servo_of(content: Content) -> Servo | None:
    """The position drive; None for a joint without one."""
    return Servo(**content["servo"]) if "servo" in content else None


def as_yaml(content: Content) -> str:
    """The text of a device file."""
    return yaml.safe_dump(content, sort_keys=False, default_flow_style=None)


def draw_joint(rng: Generator, family: str) -> Content:
    """A true joint of `family`."""
    content: Content = {
        "name": NAME,
        "title": "One joint on a test bench",
        "source": ["data sheet and drawings of the bench"],
        "confidence": "identified",
    }
    return content | _FAMILIES[family](rng)


def believed(rng: Generator, true: Content, tolerance: float = TOLERANCE) -> tuple[Content, dict[str, float]]:
    """The nominal device file of a true joint, and the relative error of each of its parameters."""
    content, errors = deepcopy(true), {}
    if tolerance != TOLERANCE:
        stated = (*_STATED, *_OF_SERVO) if "servo" in true else _STATED
        content["tolerances"] = dict.fromkeys(stated, tolerance)

    def perturb(part: Content, where: str, *keys: str) -> None:
        """Scale all `keys` by one random factor."""
        there = [key for key in keys if part.get(key)]
        if there:
            factor = 1.0 + float(rng.uniform(-tolerance, tolerance))
            errors[f"{where}.{there[0]}"] = round(factor - 1.0, 6)
            for key in there:
                value = part[key]
                part[key] = [_round(v * factor) for v in value] if isinstance(value, list) else _round(value * factor)

    for key in ("inertia", "viscous_friction", "coulomb_friction"):
        perturb(content["link"], "link", key)
        for i, motor in enumerate(content.get("motors", ())):
            perturb(motor, f"motors.{i}", key)
    for i, spring in enumerate(content.get("springs", ())):
        perturb(spring, f"springs.{i}", *_SPRING)
    for key in _OF_SERVO if "servo" in content else ():
        perturb(content["servo"], "servo", key)
    return content, errors


def scaled(content: Content, where: str, factor: float) -> Content:
    """The device file with one parameter scaled, named as in the errors of `believed`; for a spring, its torque."""
    moved = deepcopy(content)
    part_name, _, key = where.rpartition(".")
    name, _, number = part_name.partition(".")
    part = moved[name][int(number)] if number else moved[name]
    for each in _SPRING if name == "springs" else (key,):
        if part.get(each):
            value = part[each]
            part[each] = [v * factor for v in value] if isinstance(value, list) else value * factor
    return moved


def noisier_content(content: Content, factor: float) -> Content:
    """The device file with coarser encoders and more torque noise."""
    sensors = {key: value if key == "rate" else _round(value * factor) for key, value in content["sensors"].items()}
    return content | {"sensors": sensors}


def _round(value: float) -> float:
    return float(f"{value:.6g}")


def _between(rng: Generator, low: float, high: float) -> float:
    """A log-uniform random number."""
    return _round(float(low * (high / low) ** rng.uniform()))


def _gravity(rng: Generator, link: Content, size: float) -> Content:
    """The link, with gravity in three of five joints."""
    if rng.uniform() < 0.6:
        link |= {
            "gravity_torque": _between(rng, 0.3 * size, size),
            "gravity_angle": _round(float(rng.uniform(-0.3, 0.3))),
        }
    return link


def _sensors(rng: Generator, torque: float) -> Content:
    """Encoders of 14 to 17 bits, and torque noise in proportion to the joint's torques."""
    step, own = (_round(2.0 * pi / 2 ** int(rng.integers(14, 18))) for _ in range(2))
    return {
        "rate": float(rng.choice([1000.0, 1000.0, 500.0])),
        "link_quantum": step,
        "motor_quantum": own,
        "torque_noise": _between(rng, 0.002 * torque, 0.02 * torque),
    }


def _motor(rng: Generator, inertia: float, viscous: float, dry: float, limit: float) -> Content:
    motor: Content = {"inertia": _between(rng, 0.7 * inertia, 1.4 * inertia)}
    motor["viscous_friction"] = _between(rng, 0.7 * viscous, 1.4 * viscous)
    if rng.uniform() < 0.3:
        motor["coulomb_friction"] = _between(rng, 0.5 * dry, dry)
    return motor | {"torque_limit": limit}


def _rigid(rng: Generator) -> Content:
    """A rigid joint; its torque is commanded at the link."""
    link: Content = {"inertia": _between(rng, 0.02, 0.08), "viscous_friction": _between(rng, 0.05, 0.2)}
    if rng.uniform() < 0.3:
        link["coulomb_friction"] = _between(rng, 0.01, 0.04)
    sensors = {key: value for key, value in _sensors(rng, 1.0).items() if key in ("rate", "link_quantum")}
    return {"arrangement": "rigid", "link": _gravity(rng, link, 1.5), "sensors": sensors}


def _stiff(rng: Generator) -> Content:
    """A geared joint: a stiff spring between motor and link."""
    link = {"inertia": _between(rng, 0.02, 0.08), "viscous_friction": _between(rng, 0.01, 0.06)}
    return {
        "arrangement": "flexible",
        "link": _gravity(rng, link, 1.5),
        "motors": [_motor(rng, 0.03, 0.2, 0.03, 20.0)],
        "springs": [{"law": "linear", "stiffness": _between(rng, 150.0, 600.0), "max_deflection": 0.3}],
        "sensors": _sensors(rng, 1.5),
    }


def _series_elastic(rng: Generator) -> Content:
    link = {"inertia": _between(rng, 0.01, 0.05), "viscous_friction": _between(rng, 0.01, 0.03)}
    stiffness = _between(rng, 6.0, 50.0)
    spring: Content = {"law": "linear", "stiffness": stiffness, "max_deflection": 1.5}
    if rng.uniform() < 0.5:
        hardening = _round(stiffness * float(rng.uniform(0.5, 3.0)))
        spring = {"law": "odd_polynomial", "odd_coefficients": [stiffness, hardening], "max_deflection": 1.5}
    return {
        "arrangement": "flexible",
        "link": _gravity(rng, link, 0.8),
        "motors": [_motor(rng, 0.015, 0.12, 0.02, 10.0)],
        "springs": [spring],
        "sensors": _sensors(rng, 1.0),
    }


def _pair(rng: Generator, spring: Content, inertia: float, torque: float, weight: float) -> Content:
    link = {"inertia": _between(rng, 0.7 * inertia, 2.0 * inertia), "viscous_friction": _between(rng, 0.008, 0.02)}
    motor = _motor(rng, 0.015, 0.15, 0.02, 10.0)
    return {
        "arrangement": "antagonistic",
        "link": _gravity(rng, link, weight),
        "motors": [dict(motor), dict(motor)],
        "springs": [dict(spring), dict(spring)],
        "sensors": _sensors(rng, torque),
    }


def _polynomial_pair(rng: Generator) -> Content:
    """Parameters around those of cubic_demo."""
    spring: Content = {"law": "cubic", "coefficient": _between(rng, 7.0, 14.0), "max_deflection": 1.5}
    if rng.uniform() < 0.5:
        coefficients = [_between(rng, 0.5, 3.0), _between(rng, 5.0, 14.0)]
        spring = {"law": "odd_polynomial", "odd_coefficients": coefficients, "max_deflection": 1.5}
    return _pair(rng, spring, 0.015, 1.0, 0.5)


def _exponential_pair(rng: Generator) -> Content:
    """Parameters around those of the qbmoves."""
    spring = {
        "law": "sinh",
        "k": _between(rng, 0.004, 0.02),
        "a": _round(float(rng.uniform(7.0, 9.5))),
        "max_deflection": 1.0,
    }
    return _pair(rng, spring, 0.006, 1.0, 0.2)


def _controlled_motor(rng: Generator) -> Content:
    """A bare or lightly geared rotor whose drive mainly works against dry friction."""
    inertia = _between(rng, 1.5e-4, 2e-3)
    link: Content = {"inertia": inertia, "viscous_friction": _between(rng, 0.3, 2.0) * inertia}
    link["coulomb_friction"] = _round(float(rng.uniform(20.0, 70.0)) * inertia)  # [rad/s^2] for a bare rotor
    step = _round(2.0 * pi / 2 ** int(rng.integers(14, 18)))
    return {"arrangement": "rigid", "link": link, "sensors": {"rate": 1000.0, "link_quantum": step}}


def _position_drive(rng: Generator) -> Content:
    """A hobby or industrial servo with a pendulum."""
    link: Content = {"inertia": _between(rng, 4e-3, 4e-2)}
    inertia = link["inertia"]
    w, ratio = float(rng.uniform(18.0, 40.0)), float(rng.uniform(0.3, 0.8))
    link["viscous_friction"] = _round(0.1 * inertia * w)
    if rng.uniform() < 0.6:
        link["coulomb_friction"] = _round(float(rng.uniform(0.03, 0.15)) * inertia * w)
    link |= {"gravity_torque": _round(inertia * float(rng.uniform(20.0, 60.0)))}
    kp = _round(inertia * w * w)
    servo = {"kp": kp, "kd": _round(2.0 * ratio * inertia * w), "torque_limit": _round(kp * rng.uniform(0.3, 0.6))}
    if rng.uniform() < 0.4:
        servo["speed_limit"] = _round(float(rng.uniform(4.0, 12.0)))
    servo["delay"] = float(rng.choice([0.0, 0.002, 0.005, 0.01, 0.02]))
    step = _round(2.0 * pi / 2 ** int(rng.integers(12, 16)))
    sensors = {"rate": 250.0, "link_quantum": step}
    return {"arrangement": "rigid", "drive": "position", "link": link, "servo": servo, "sensors": sensors}


def _variable_damping(rng: Generator) -> Content:
    """Parameters around those of maccepavd, with finer encoders."""
    lever, base = _between(rng, 0.03, 0.045), _between(rng, 0.11, 0.15)
    step, own = (_round(2.0 * pi / 2 ** int(rng.integers(14, 18))) for _ in range(2))
    return {
        "arrangement": "serial",
        "drive": "servo",
        "link": {"inertia": _between(rng, 2.5e-3, 6e-3), "viscous_friction": _between(rng, 0.005, 0.012)},
        "motors": [{"bandwidth": _between(rng, 18.0, 35.0)} for _ in range(2)],
        "springs": [
            {
                "law": "maccepa",
                "k": _between(rng, 250.0, 500.0),
                "lever": lever,
                "base": base,
                "free_length": _round(base - lever),
                "drum_radius": _between(rng, 0.01, 0.02),
                "max_deflection": 1.57,
            }
        ],
        "damper": {"site": "link", "map": "two_stage", "stage": _between(rng, 0.01, 0.03), "second": 0.848},
        "sensors": {"rate": float(rng.choice([500.0, 250.0])), "link_quantum": step, "motor_quantum": own},
    }


_FAMILIES = {
    "rigid": _rigid,
    "stiff": _stiff,
    "series_elastic": _series_elastic,
    "polynomial_pair": _polynomial_pair,
    "exponential_pair": _exponential_pair,
    "variable_damping": _variable_damping,
    CONTROLLED: _controlled_motor,
    POSITIONED: _position_drive,
}
