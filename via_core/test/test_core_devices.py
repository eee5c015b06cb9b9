"""Device files: shipped numbers equal the published ones; impossible values are refused in one line."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from via_core.device_parts import ServoMotor, TorqueMotor
from via_core.devices import Device, device_names, load_device, parse_device
from via_core.errors import DeviceError, ParameterError

EVERY_DEVICE = pytest.mark.parametrize("name", device_names())

GOOD = {
    "name": "joint",
    "title": "A joint",
    "source": ["a test"],
    "confidence": "assumed",
    "arrangement": "antagonistic",
    "drive": "torque",
    "link": {"inertia": 0.1, "viscous_friction": 0.0},
    "motors": [{"inertia": 0.01, "viscous_friction": 0.1}, {"inertia": 0.01, "viscous_friction": 0.1}],
    "springs": [
        {"law": "cubic", "coefficient": 10.0, "max_deflection": 1.0},
        {"law": "cubic", "coefficient": 10.0, "max_deflection": 1.0},
    ],
    "damper": {"site": "transmission", "map": "linear", "maximum": 2.0},
    "sensors": {"rate": 1000.0, "link_quantum": 1e-4},
}


LEVER_IS_BASE = {
    "law": "maccepa",
    "k": 394.0,
    "lever": 0.1,
    "base": 0.1,
    "free_length": 0.1,
    "drum_radius": 0.01,
    "max_deflection": 1.0,
}


def edited(key: str, value) -> dict:
    """GOOD with one dotted key replaced; numbers index lists."""
    content = yaml.safe_load(yaml.safe_dump(GOOD))
    *path, last = [int(part) if part.isdigit() else part for part in key.split(".")]
    inner = content
    for part in path:
        inner = inner[part]
    inner[last] = value
    return content


def refusal(content) -> str:
    with pytest.raises(DeviceError) as caught:
        parse_device(content if isinstance(content, str) else yaml.safe_dump(content), "file.yaml")
    text = str(caught.value)
    assert text.startswith("file.yaml:"), text
    assert len(text.splitlines()) == 1
    return text


def test_the_valid_file_is_accepted() -> None:
    device = parse_device(yaml.safe_dump(GOOD), "file.yaml")
    assert device.motor_joints == ("joint_motor_1_joint", "joint_motor_2_joint")
    assert (device.link_joint, device.command_topic) == ("joint_shaft_joint", "/joint/command")


@EVERY_DEVICE
def test_every_shipped_file_loads_and_carries_its_origin(name: str) -> None:
    device = load_device(name)
    assert device.name == name
    assert device.source and device.remark
    assert device.n_motors == len(device.motors) and device.n_transmissions == len(device.springs)
    wanted = ServoMotor if device.drive == "servo" else TorqueMotor
    assert all(isinstance(motor, wanted) for motor in device.motors)


@EVERY_DEVICE
def test_every_shipped_file_round_trips_through_yaml(name: str, tmp_path: Path) -> None:
    device = load_device(name)
    file = tmp_path / "copy.yaml"
    file.write_text(yaml.safe_dump(device.model_dump(mode="json", exclude_none=True)), encoding="utf-8")
    assert load_device(file) == device
    assert load_device(str(file)) == device


@pytest.mark.parametrize(
    ("name", "key", "value"),
    [
        ("qbmove_a", "springs.0.a", 8.9992),
        ("qbmove_a", "springs.1.k", 0.0019),
        ("qbmove_a", "motors.0.inertia", 0.0233),
        ("qbmove_a", "motors.0.viscous_friction", 0.2698),
        ("qbmove_a", "motors.1.torque_limit", 6.0),
        ("qbmove_a_urdf", "motors.0.viscous_friction", 0.0019),
        ("qbmove_a_urdf", "motors.0.coulomb_friction", 0.5),
        ("qbmove_b", "springs.0.a", 6.7328),
        ("qbmove_b", "springs.0.k", 0.0222),
        ("qbmove_alterego", "springs.0.a", 11.0),
        ("qbmove_alterego_stiff", "springs.1.k", 0.04),
        ("dlr_bavs", "springs.0.a", 8.71),
        ("dlr_bavs", "springs.0.fall", 2.38e-6),
        ("maccepavd", "springs.0.k", 394.0),
        ("maccepavd_k231", "springs.0.k", 231.0),
        ("maccepavd", "link.inertia", 3.6e-3),
        ("maccepavd", "motors.0.bandwidth", 25.0),
        ("maccepa_2link_elbow", "springs.0.k", 771.0),
        ("maccepa_2link_shoulder", "springs.0.drum_radius", 0.01),
        ("edinburgh_vsa", "springs.0.rest_length", 0.02737),
        ("vsa2", "springs.0.k", 0.5),
        ("vsa2", "motors.0.inertia", 7.3e-3),
        ("vsa2", "motors.0.viscous_friction", 1e-3),
        ("cubic_aa_vsa", "springs.0.coefficient", 10.0),
        ("cubic_aa_vsa", "motors.1.inertia", 1e-4),
        ("cubic_aa_vsa", "motors.1.viscous_friction", 1.27),
        ("cubic_aa_vsa", "link.inertia", 0.0179),
        ("compact_vpda", "damper.maximum", 4.1),
    ],
)
def test_shipped_numbers_are_the_published_ones(name: str, key: str, value: float) -> None:
    inner = load_device(name).model_dump()
    for part in key.split("."):
        inner = inner[int(part)] if part.isdigit() else inner[part]
    assert inner == value


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("name", "Joint 1", ["name: must be of lower case letters, digits and _", "got 'Joint 1'"]),
        ("name", "", ["name: "]),
        ("source", [], ["source: ", "got []"]),
        ("confidence", "sure", ["confidence: must be 'measured'", "'assumed'", "got 'sure'"]),
        ("arrangement", "parallel", ["arrangement: must be", "got 'parallel'"]),
        ("link.inertia", -0.1, ["link.inertia: must be greater than 0, got -0.1"]),
        ("link.inertia", 0, ["link.inertia: must be greater than 0, got 0"]),
        ("link.inertia", float("nan"), ["link.inertia: must be a finite number, got nan"]),
        ("link.inertia", float("inf"), ["link.inertia: must be a finite number, got inf"]),
        ("link.inertia", "heavy", ["link.inertia: must be a valid number, got 'heavy'"]),
        ("link.inertia", True, ["link.inertia: must be a valid number, got True"]),
        ("link.inertia", None, ["link.inertia: must be a valid number, got None"]),
        ("link.viscous_friction", -1e-9, ["link.viscous_friction: must be greater than or equal to 0"]),
        ("link.mass", 1.0, ["link.mass: is no known key"]),
        ("motors.1.inertia", -0.01, ["motors.1.inertia: must be greater than 0, got -0.01"]),
        ("motors.0.torque_limit", 0.0, ["motors.0.torque_limit: must be greater than 0"]),
        ("motors.0", {"bandwidth": 25.0}, ["motors.0: drive is 'torque' but this is a servo motor"]),
        ("motors.0", {"bandwidth": 0.0}, ["motors.0.bandwidth: must be greater than 0, got 0.0"]),
        ("motors.0", 3.0, ["motors.0: ", "got 3.0"]),
        ("motors", [], ["motors: arrangement 'antagonistic' needs exactly 2, got 0"]),
        ("drive", "servo", ["motors.0: drive is 'servo' but this is a torque motor"]),
        ("arrangement", "flexible", ["motors: arrangement 'flexible' needs exactly 1, got 2"]),
        ("arrangement", "serial", ["springs: arrangement 'serial' needs exactly 1, got 2"]),
        ("springs.0.law", "rubber", ["springs.0.law: must be one of 'linear', ", "got 'rubber'"]),
        ("springs.0", {"max_deflection": 1.0}, ["springs.0.law: is missing"]),
        ("springs.0.max_deflection", 0.0, ["springs.0.max_deflection: must be greater than 0, got 0.0"]),
        ("springs.1.coefficient", -10.0, ["springs.1.coefficient: must be greater than 0, got -10.0"]),
        (
            "springs.1",
            {"law": "four_bar", "k": 0.5, "ratio": 1.7, "max_deflection": 1.3},
            ["springs.1: max_deflection must be below the linkage's dead point 1.25", "got 1.3"],
        ),
        (
            "springs.0",
            {"law": "four_bar", "k": 0.5, "ratio": 1.0, "max_deflection": 1.0},
            ["springs.0.ratio: must be greater than 1, got 1.0"],
        ),
        (
            "springs.0",
            LEVER_IS_BASE,
            ["springs.0: lever and base must differ", "0.1"],
        ),
        (
            "springs.0",
            {"law": "odd_polynomial", "odd_coefficients": [1.0, -9.0], "max_deflection": 1.0},
            ["springs.0: odd_coefficients (1.0, -9.0) give a negative stiffness"],
        ),
        ("damper.site", "motor", ["damper.site: must be 'link' or 'transmission', got 'motor'"]),
        ("damper.map", "cubic", ["damper.map: must be one of 'linear', 'two_stage', got 'cubic'"]),
        ("damper.minimum", 3.0, ["damper: the damping must grow with the command"]),
        ("sensors.rate", 0.0, ["sensors.rate: must be greater than 0, got 0.0"]),
        ("sensors.link_quantum", 0.0, ["sensors.link_quantum: must be greater than 0, got 0.0"]),
        ("sensors.torque_noise", -1.0, ["sensors.torque_noise: must be greater than or equal to 0"]),
        ("wire", {"motors": ["only_one"]}, ["wire.motors: needs 0 or 2 names, got 1"]),
        ("colour", "red", ["colour: is no known key"]),
        ("two\nlines", 1.0, ["two lines: is no known key"]),
    ],
)
def test_impossible_devices_are_refused(key: str, value, says: list[str]) -> None:
    text = refusal(edited(key, value))
    for part in says:
        assert part in text


def test_a_damper_in_a_transmission_needs_one() -> None:
    content = {**GOOD, "arrangement": "rigid", "motors": [], "springs": []}
    assert "damper.site: 'transmission' needs a transmission" in refusal(content)


@pytest.mark.parametrize("key", ["name", "title", "source", "confidence", "arrangement", "link", "sensors"])
def test_missing_keys_are_named(key: str) -> None:
    content = {k: v for k, v in GOOD.items() if k != key}
    assert f"{key}: is missing" in refusal(content)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "must be a mapping of keys, got None"),
        ("- a\n- b", "must be a mapping of keys, got ['a', 'b']"),
        ("name: a\nname: b", "line 2 duplicate key 'name'"),
        ("link: {inertia: 1, inertia: 2}", "line 1 duplicate key 'inertia'"),
        ("name: [", "line 1"),
        ("name: !!python/object:os.system x", "could not determine a constructor"),
        ("? [a, b]\n: 1", "unhashable"),
        ("a: \x00", "special characters are not allowed"),
    ],
)
def test_invalid_yaml_gives_one_line(text: str, says: str) -> None:
    assert says in refusal(text)


KEYS = sorted({"name", "link.inertia", "motors.1", "springs.0", "springs", "damper", "sensors.rate", "wire", "source"})
JUNK = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=5,
)


@given(key=st.sampled_from(KEYS), value=JUNK)
def test_random_values_give_a_device_or_one_line(key: str, value) -> None:
    text = yaml.safe_dump(edited(key, value))
    try:
        parse_device(text, "file.yaml")
    except DeviceError:
        refusal(text)


@given(text=st.text(alphabet="abl:{}[]-&*!|>?#'\"%@`, \n\t019.e+", max_size=40))
def test_random_text_is_not_a_device(text: str) -> None:
    refusal(text)


def test_a_long_value_is_cut_short() -> None:
    assert len(refusal(edited("name", "X" * 5000))) < 250


def test_exponents_without_a_dot_are_numbers() -> None:
    text = yaml.safe_dump(GOOD).replace("inertia: 0.1", "inertia: 1e-4")
    assert parse_device(text, "file.yaml").link.inertia == 1e-4


def test_unknown_names_and_unreadable_files(tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match=r"no device 'qbmove'; there are: .*qbmove_a, .*vsa2"):
        load_device("qbmove")
    with pytest.raises(DeviceError, match=r"nowhere\.yaml: cannot be read: No such file"):
        load_device(tmp_path / "nowhere.yaml")
    with pytest.raises(DeviceError, match="cannot be read: Is a directory"):
        load_device(tmp_path)
    with pytest.raises(DeviceError, match=r"cannot be read: .*embedded null"):
        load_device("a\0.yaml")
    latin = tmp_path / "latin.yaml"
    latin.write_bytes(b"title: \xe9")
    with pytest.raises(DeviceError, match="not UTF-8 text"):
        load_device(latin)


def test_one_file_serves_joints_of_several_names(tmp_path: Path) -> None:
    elbow, shoulder = load_device("elbow=qbmove_a"), load_device("shoulder=qbmove_a")
    assert (elbow.name, elbow.link_joint, elbow.command_topic) == ("elbow", "elbow_shaft_joint", "/elbow/command")
    assert not {elbow.link_joint, *elbow.motor_joints} & {shoulder.link_joint, *shoulder.motor_joints}
    assert elbow.model_copy(update={"name": "qbmove_a"}) == load_device("qbmove_a")
    path = tmp_path / "joint.yaml"
    path.write_text(yaml.safe_dump({**yaml.safe_load(elbow.model_dump_json()), "wire": {"link": "j3"}}))
    assert load_device(f"wrist={path}").link_joint == "j3"
    for strange in ("elbow=", "Elbow=qbmove_a", "elbow=no_such", "=qbmove_a"):
        with pytest.raises(DeviceError, match="no device"):
            load_device(strange)


def test_a_changed_copy_has_its_own_springs_and_damper() -> None:
    device, other = load_device("maccepavd"), load_device("maccepavd_k231")
    theta = device.motor_angles(0.0, 1.0)
    before = float(device.stiffness(0.3, theta)), float(device.damping_of(0.5))
    assert device.damper is not None
    changed = device.model_copy(update={"springs": other.springs, "damper": replace(device.damper, minimum=1.0)})
    assert float(changed.stiffness(0.3, theta)) == pytest.approx(float(other.stiffness(0.3, theta)), rel=1e-12)
    assert float(changed.stiffness(0.3, theta)) < 0.9 * before[0]
    assert float(changed.damping_of(0.5)) > before[1] + 0.5
    assert (float(device.stiffness(0.3, theta)), float(device.damping_of(0.5))) == before


def test_a_device_is_frozen() -> None:
    device = load_device("maccepavd")
    with pytest.raises(ValueError, match="frozen"):
        device.name = "other"  # type: ignore[misc]
    with pytest.raises(ValueError, match="frozen"):
        device.link.inertia = 1.0  # type: ignore[misc]


def test_stiffness_is_the_slope_of_the_torque_on_the_link() -> None:
    h = 1e-6
    for name in device_names():
        device = load_device(name)
        theta = device.motor_angles(0.05, 0.1)
        slope = (device.torque_each(h, theta).sum() - device.torque_each(-h, theta).sum()) / (2 * h)
        assert float(device.stiffness(0.0, theta)) == pytest.approx(slope, rel=1e-6, abs=1e-9)


def test_a_serial_device_takes_its_preset_from_motor_two_or_from_the_caller() -> None:
    device = load_device("maccepavd")
    q, theta = np.array([0.1, 0.2]), np.array([[0.0, 0.5], [0.0, 1.0]])
    own = device.stiffness(q, theta)
    assert own.shape == (2,)
    np.testing.assert_array_equal(own, device.stiffness(q, theta, preset=[0.5, 1.0]))
    assert np.all(device.stiffness(q, theta, preset=2.0) > own)
    assert device.stiffness_each(q, theta).shape == (2, 1)


def test_antagonistic_motors_are_at_equilibrium_plus_and_minus_preset() -> None:
    device = load_device("qbmove_a")
    theta = device.motor_angles([0.2, 0.3], 0.5)
    np.testing.assert_allclose(theta, [[0.7, -0.3], [0.8, -0.2]])
    np.testing.assert_allclose(device.torque_each([0.2, 0.3], theta).sum(axis=-1), 0.0, atol=1e-15)


def test_theta_of_another_device_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"theta must end in \(2,\) for 'qbmove_a', got shape \(4, 1\)"):
        load_device("qbmove_a").stiffness(np.zeros(4), np.zeros((4, 1)))


def test_a_rigid_joint_has_neither_motors_nor_stiffness() -> None:
    device = load_device("compact_vpda")
    assert device.motor_angles([0.1, 0.2]).shape == (2, 0)
    np.testing.assert_array_equal(device.stiffness([0.1, 0.2], np.empty((2, 0))), [0.0, 0.0])
    np.testing.assert_allclose(device.damping_of([0.0, 1.0]), [1.0, 4.1])


def test_a_device_without_damper_adds_no_damping() -> None:
    device: Device = load_device("qbmove_a")
    assert device.damper is None
    np.testing.assert_array_equal(device.damping_of(np.ones((2, 3))), np.zeros((2, 3)))


POSITIONED = {
    "name": "joint",
    "title": "A joint",
    "source": ["a test"],
    "confidence": "assumed",
    "arrangement": "rigid",
    "drive": "position",
    "link": {"inertia": 0.1, "viscous_friction": 0.0},
    "servo": {"kp": 2.0, "kd": 0.1, "torque_limit": 1.0, "speed_limit": 5.0, "delay": 0.01},
    "sensors": {"rate": 100.0},
    "tolerances": {"kp": 0.65, "torque_limit": 0.01},
    "wire": {"columns": {"q": "angle", "equilibrium": {"column": "goal", "scale": 0.5, "enable": "torque_on"}}},
}


def test_a_position_drive_is_described_by_its_servo() -> None:
    device = parse_device(yaml.safe_dump(POSITIONED), "file.yaml")
    assert (device.n_motors, device.n_drives, device.drive) == (0, 1, "position")
    assert device.servo is not None and device.servo.kp == 2.0 and device.servo.delay == 0.01
    assert (device.tolerances.kp, device.tolerances.kd, device.tolerances.torque_limit) == (0.65, 0.05, 0.01)
    columns = device.wire.columns
    assert (columns["q"].column, columns["q"].scale, columns["q"].offset) == ("angle", 1.0, 0.0)
    assert (columns["equilibrium"].scale, columns["equilibrium"].enable) == (0.5, "torque_on")
    error, speed = np.array([0.1, 2.0, -2.0, 0.1]), np.array([1.0, 0.5, -20.0, -9.0])
    np.testing.assert_allclose(device.servo.torque(error, speed), [0.1, 0.95, 1.0, 1.1])
    whole = device.servo.model_copy(update={"limited": "sum"})
    np.testing.assert_allclose(whole.torque(error, speed), [0.1, 1.0, -1.0, 1.0])
    plain = parse_device(yaml.safe_dump(POSITIONED | {"servo": {"kp": 2.0, "kd": 0.0}}), "file.yaml").servo
    assert plain is not None and plain.torque_limit is None and plain.speed_limit is None and plain.delay == 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"servo": None}, "servo: is missing"),
        ({"drive": "torque"}, "servo: drive 'torque' has none"),
        ({"servo": {"kp": 0.0, "kd": 0.1}}, "servo.kp: must be greater than 0, got 0.0"),
        ({"servo": {"kp": 1.0}}, "servo.kd: is missing"),
        ({"servo": {"kp": 1.0, "kd": 0.1, "delay": 0.2}}, "servo.delay: must be less than or equal to 0.1, got 0.2"),
        ({"tolerances": {"kp": 0.7}}, "tolerances.kp: must be less than or equal to 0.65, got 0.7"),
        ({"wire": {"columns": {"q": {"column": "a", "gain": 2.0}}}}, "wire.columns.q.gain: is no known key"),
        ({"wire": {"columns": {"q": {"scale": 2.0}}}}, "wire.columns.q.column: is missing"),
    ],
)
def test_impossible_position_drives_and_columns_are_refused(change: dict, message: str) -> None:
    assert message in refusal(POSITIONED | change)


def test_only_rigid_joints_have_a_position_drive() -> None:
    assert "drive: 'position' needs arrangement 'rigid', got 'antagonistic'" in refusal(edited("drive", "position"))
