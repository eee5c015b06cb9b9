"""Arms of rigid joints: torques of the bodies in closed form, planted friction found at each joint, what is refused."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pinocchio
import pytest
import via_core
from typer.testing import CliRunner
from via_bringup.cli import app
from via_core.device_parts import PositionDrive
from via_core.errors import DeviceError, SignalError, ViaError
from via_core.signals import Array, Signals
from via_gap.diagnosis import diagnose
from via_gap.logs.log import JointLog
from via_gap.report.report import read_report
from via_gap.residual.inverse_dynamics import InverseDynamics
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import cut_log
from via_gap.run.arm_body import BodyError
from via_gap.run.arm_cause import ArmCause, find_causes, is_cause, read_cause, with_causes
from via_gap.run.arm_gravity import Gravity, with_gravity
from via_gap.run.arm_model import Arm, body_of, load_arm, under
from via_gap.run.arm_offset import AngleOffset
from via_gap.run.arm_payload import Payload, with_payload
from via_gap.run.arms import arm_logs, read_arm_log
from via_sim.effects import Effect

RATE, FINE = 300.0, 10  # [Hz] of the log; steps of the integration per sample
FRICTION = (0.3, 0.12)  # [N m] planted


@pytest.fixture(scope="module")
def arm() -> Arm:
    return load_arm("dfki_double_pendulum")


def pendulum(q: Array, v: Array, a: Array) -> Array:
    """Torques [N m] of the shipped arm, written out (Spong, Robot modeling and control, planar elbow manipulator)."""
    m1, m2, l1, r1, r2, i1, i2, g = 0.608, 0.63, 0.3, 0.275, 0.166, 0.05472, 0.02522, 9.81
    h = m2 * l1 * r2
    c, s = np.cos(q[:, 1]), np.sin(q[:, 1])
    inner = i2 + h * c
    first = (i1 + i2 + m2 * l1**2 + 2.0 * h * c + 0.0022466) * a[:, 0] + inner * a[:, 1]
    first += -2.0 * h * s * v[:, 0] * v[:, 1] - h * s * v[:, 1] ** 2
    far = m2 * g * r2 * np.sin(q[:, 0] + q[:, 1])
    first += (m1 * r1 + m2 * l1) * g * np.sin(q[:, 0]) + far
    return np.stack([first, inner * a[:, 0] + (i2 + 0.00218588) * a[:, 1] + h * s * v[:, 0] ** 2 + far], axis=1)


KP, KD = (30.0, 8.0), (3.0, 0.6)  # [N m/rad], [N m s/rad] of the controllers


def wanted(t: Array | float) -> Array:
    """Goals (2, ...) [rad] at times t [s]."""
    return np.array([1.5 * np.sin(1.1 * t) + 0.5 * np.sin(2.9 * t), 1.2 * np.sin(1.7 * t) + 0.4 * np.sin(4.3 * t)])


def moved(arm: Arm, seconds: float, phase: float = 0.0, bodies: Arm | None = None) -> list[JointLog]:
    """The arm with dry friction, and with the `bodies` of another, follows waves, recorded with the encoders' steps."""
    model, dt = (bodies or arm).model, 1.0 / (RATE * FINE)
    data = model.createData()
    viscous = np.array([device.link.viscous_friction for device in arm.devices])
    q, v = np.zeros(2), np.zeros(2)
    angles, torques = [], []
    for k in range(round(seconds * RATE)):
        t = k / RATE + phase
        tau = np.array(KP) * (wanted(t) - q) - np.array(KD) * v
        angles.append(q.copy())
        torques.append(tau)
        for _ in range(FINE):
            friction = viscous * v + np.array(FRICTION) * np.tanh(v / 1e-3)
            configuration = np.array([np.cos(q[0]), np.sin(q[0]), np.cos(q[1]), np.sin(q[1])])
            v = v + dt * pinocchio.aba(model, data, configuration, v, tau - friction)
            q = q + dt * v
    time, read, sent = np.arange(len(angles)) / RATE, np.array(angles), np.array(torques)
    quantum = 3.8148e-4
    logs = []
    for i, device in enumerate(arm.devices):
        measured = Signals(time, {"q": quantum * np.rint(read[:, i] / quantum)}, {"q": "rad"})
        drive = Signals(
            time, {"external_torque": sent[:, i]}, {"external_torque": "N m"}, frozenset({"external_torque"})
        )
        logs.append(JointLog(f"wave {phase:g}", device, measured, drive))
    return arm_logs(logs, arm)


def test_torques_of_the_bodies_are_those_written_out(arm: Arm) -> None:
    q, v, a = np.random.default_rng(1).normal(size=(3, 40, 2))
    np.testing.assert_allclose(arm.torques(q, v, a), pendulum(q, v, a), atol=1e-6)


def written(logs: list[JointLog], file: Path) -> str:
    """A table of the whole arm."""
    columns = [logs[0].measured.time, *(log.measured["q"] for log in logs)]
    columns += [log.commands["external_torque"] for log in logs if log.commands is not None]
    header = "time,pos1,pos2,tau1,tau2"
    np.savetxt(file, np.column_stack(columns), delimiter=",", header=header, comments="", fmt="%.12g")
    return str(file)


@pytest.fixture(scope="module")
def answered(arm: Arm, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of two runs and what `via gap diagnose --arm` made of them: a report, a page and a repair per joint."""
    here = tmp_path_factory.mktemp("arm")
    written(moved(arm, 12.0), here / "run.csv")
    written(moved(arm, 8.0, 20.0), here / "held.csv")
    asked = ["--json", str(here / "report.json"), "--html", str(here / "page.html")]
    asked += ["--effects-out", str(here / "repair.yaml")]
    done = CliRunner().invoke(
        app, ["gap", "diagnose", str(here / "run.csv"), "--arm", arm.name, "--holdout", str(here / "held.csv"), *asked]
    )
    assert done.exit_code == 0, done.output
    return here


def test_friction_withheld_is_found_at_each_joint_on_a_log_not_fitted(arm: Arm, answered: Path) -> None:
    for device, planted in zip(arm.devices, FRICTION, strict=True):
        report = read_report((answered / f"report_{device.name}.json").read_text(), "report")
        assert report.verdict == "effect"
        assert (report.causes[0].effect, report.causes[0].site) == ("coulomb_friction", "link")
        assert report.causes[0].parameters["torque"].value == pytest.approx(planted, rel=0.1)
        assert report.gap is not None
        assert report.gap.by == "inverse dynamics"
        assert report.gap.after < 0.5 * report.gap.before
        assert report.where[0].equation == "link"
        assert report.figures is not None
        (against_speed,) = (figure for figure in report.figures.residuals if figure.by == "speed")
        fast = [each.before for each in against_speed.bins if each.low > 0.4]
        assert fast == pytest.approx([-planted] * len(fast), rel=0.2)  # the residual brakes as the friction does
        traces = [figure for figure in report.figures.traces if figure.signal == "tau"]
        assert traces and all(len(figure.time) > 20 for figure in traces)


def find_cause(arm: Arm, logs: list[list[JointLog]]) -> ArmCause | None:
    """The only cause."""
    found = find_causes(arm, logs)
    assert len(found) < 2
    return found[0] if found else None


def mounted(link: str, mass: float, *position: float) -> Payload:
    x, y, z = position
    return Payload(link, (), mass, 0.0, (x, y, z), (0.0, 0.0, 0.0), 1.0)


def test_a_wrong_centre_of_mass_is_a_wrong_body_and_no_payload(arm: Arm) -> None:
    moment = 0.08  # [kg m] across the elbow's body
    planted = BodyError("dfki_elbow", (), (0.0, moment, *8 * [0.0]), 10 * (0.0,), 1.0)
    found = find_cause(arm, [moved(arm, 40.0, bodies=with_causes(arm, [planted]))])
    assert isinstance(found, BodyError) and (found.link, found.tied) == ("dfki_elbow", ())
    assert found.numbers[1] == pytest.approx(moment, abs=max(4.0 * found.numbers_sd[1], 0.002))
    assert "not that of the model" in found.text()


@pytest.mark.parametrize("share", [0.4, -0.25])
def test_a_body_of_another_density_is_one_unknown(arm: Arm, share: float, tmp_path: Path) -> None:
    """A point mass at its centre of mass explains it as well, with four unknowns."""
    link = "dfki_elbow"
    numbers = share * arm.model.inertias[body_of(arm, 1)].toDynamicParameters()
    planted = BodyError(link, (), tuple(numbers), 10 * (0.0,), 1.0)
    found = find_cause(arm, [moved(arm, 40.0, bodies=with_causes(arm, [planted]))])
    assert (
        isinstance(found, BodyError) and found.link == link and found.share is not None and found.share_sd is not None
    )
    assert abs(found.share - share) < 3.0 * found.share_sd and found.share_sd < 0.02
    assert f"{'heavier' if share > 0.0 else 'lighter'} than in the model" in found.text()
    np.testing.assert_allclose(found.numbers, numbers * found.share / share, rtol=1e-9)
    (file := tmp_path / "report_body.json").write_text(json.dumps(asdict(found)))
    assert read_cause(file) == found


def test_one_heavier_link_is_preferred_to_wrong_gains_of_two_drives(arm: Arm) -> None:
    """In a horizontal plane both explain the torques; so does a payload."""
    level = under(arm, np.zeros(3))
    planted = BodyError("dfki_elbow", (), tuple(0.3 * level.model.inertias[2].toDynamicParameters()), 10 * (0.0,), 1.0)
    found = find_cause(level, [moved(level, 40.0, bodies=with_causes(level, [planted]))])
    assert isinstance(found, BodyError) and found.share == pytest.approx(0.3, abs=0.02)
    assert "a payload at dfki_elbow" in found.tied and "wrong gains of dfki_shoulder, dfki_elbow" in found.tied


@pytest.mark.parametrize("joint", [0, 1])
def test_the_zero_of_an_angle_is_found_from_all_joints_together(arm: Arm, joint: int, tmp_path: Path) -> None:
    run, link = moved(arm, 40.0), arm.devices[joint].name
    shifted = run[joint].measured
    channels = {**shifted.channels, "q": shifted["q"] + 0.05}
    run[joint] = replace(run[joint], measured=replace(shifted, channels=channels))
    found = find_cause(arm, [run])
    assert isinstance(found, AngleOffset) and found.link == link
    assert abs(found.offset - 0.05) < 3.0 * found.offset_sd + 0.05**2 / 2.0 and found.offset_sd < 0.005
    assert "check the zero of its encoder" in found.text()
    (file := tmp_path / "report_offset.json").write_text(json.dumps(asdict(found)))
    assert read_cause(file) == found
    q, v, a = np.random.default_rng(2).normal(size=(3, 5, 2))
    there = q + found.offset * np.eye(2)[joint]
    np.testing.assert_allclose(with_causes(arm, [found]).torques(there, v, a), arm.torques(q, v, a), atol=1e-12)


@pytest.mark.parametrize("offset", [0.0, 0.05])
def test_one_unknown_is_found_in_noise_that_differs_from_block_to_block(arm: Arm, offset: float) -> None:
    """Errors of ten held-out blocks do not show it, but their noise moves the unknown by a tenth of its value."""
    run, rng = moved(arm, 40.0), np.random.default_rng(8)
    for i, log in enumerate(run):
        noise = 0.15 * rng.standard_normal(len(log.commands)) * (1.0 + np.sin(0.2 * log.commands.time))
        sent = {**log.commands.channels, "external_torque": log.commands["external_torque"] + noise}
        commands = Signals(log.commands.time, sent, log.commands.units, log.commands.held)
        angle = {**log.measured.channels, "q": log.measured["q"] + offset * (i == 1)}
        run[i] = replace(log, commands=commands, measured=replace(log.measured, channels=angle))
    found = find_cause(arm, [run])
    if offset:
        assert isinstance(found, AngleOffset) and found.link == arm.devices[1].name
        assert abs(found.offset - offset) < 3.0 * found.offset_sd < 0.03
    else:
        assert found is None


def test_what_one_joint_shows_clearly_is_not_hidden_by_the_errors_of_the_others(arm: Arm) -> None:
    """Of the squared errors of all joints together the cause explains a tenth, of those of one joint a quarter."""
    bodies, offset, rng = spatial(arm), 0.02, np.random.default_rng(0)
    run = []
    for log in waves(arm, bodies, bodies, 0, (0.0, offset, 0.0)):
        assert log.torque is not None
        noisy = {**log.measured.channels, "tau": log.torque + rng.normal(0.0, 0.5, log.torque.shape)}
        run.append(replace(log, measured=replace(log.measured, channels=noisy)))
    found = find_cause(bodies, [run])
    assert isinstance(found, AngleOffset) and found.link == "lift"
    assert abs(found.offset - offset) < 3.0 * found.offset_sd < 0.01


def test_several_causes_are_fitted_beside_each_other(arm: Arm) -> None:
    run = moved(arm, 40.0, bodies=with_payload(arm, mounted("dfki_elbow", 0.3, 0.0, 0.0, -0.2)))
    shifted = run[0].measured
    channels = {**shifted.channels, "q": shifted["q"] + 0.05}
    run[0] = replace(run[0], measured=replace(shifted, channels=channels))
    by_name = {each.name: each for each in find_causes(arm, [run])}
    payload, offset = by_name["payload"], by_name["offset"]
    assert isinstance(payload, Payload) and isinstance(offset, AngleOffset) and len(by_name) == 2
    assert abs(payload.mass - 0.3) < 3.0 * payload.mass_sd + 0.002 and payload.mass_sd < 0.01
    assert abs(offset.offset - 0.05) < 3.0 * offset.offset_sd + 0.05**2 / 2.0 and offset.offset_sd < 0.005


def test_zeros_of_several_angles_that_no_single_one_explains_are_found(arm: Arm) -> None:
    bodies, offsets = spatial(arm), (0.05, 0.06, -0.05)
    run = waves(arm, bodies, bodies, 3, offsets)
    found = {each.link: each for each in find_causes(bodies, [run])}
    for name, offset in (("lift", offsets[1]), ("elbow", offsets[2])):  # the first one turns about the vertical axis
        assert isinstance(found[name], AngleOffset)
        assert abs(found[name].offset - offset) < 3.0 * found[name].offset_sd + 0.06**2 / 2.0
    assert len(found) == 2


def test_a_payload_that_another_cause_has_moved_is_fitted_again(arm: Arm) -> None:
    """Beside a wrong zero alone, the first fit of the payload is off by many standard deviations."""
    bodies = spatial(arm)
    loaded = with_payload(bodies, mounted("elbow", 0.7, 0.1, -0.3, 0.2))
    found = {each.name: each for each in find_causes(bodies, [waves(arm, bodies, loaded, 0, (0.0, 0.05, 0.0))])}
    payload, offset = found["payload"], found["offset"]
    assert isinstance(payload, Payload) and isinstance(offset, AngleOffset) and len(found) == 2
    assert abs(payload.mass - 0.7) < 3.0 * payload.mass_sd + 0.002


def pulled(*gravity: float) -> Gravity:
    x, y, z = gravity
    return Gravity((x, y, z), (0.0, 0.0, 0.0), (0.0, 0.0, -9.81), (), 1.0)


@pytest.mark.parametrize("degrees", [4.0, -4.0])
def test_a_tilted_base_is_found_from_all_joints_together(arm: Arm, degrees: float) -> None:
    """No torque depends on gravity along y, the direction of both axes."""
    angle = np.radians(degrees)
    planted = pulled(9.81 * np.sin(angle), 0.0, -9.81 * np.cos(angle))
    found = find_cause(arm, [moved(arm, 40.0, bodies=with_gravity(arm, planted))])
    assert isinstance(found, Gravity) and not found.absent and "Check how the base is mounted" in found.text()
    for value, sd, true in zip(found.gravity, found.gravity_sd, planted.gravity, strict=True):
        assert abs(value - true) < max(4.0 * sd, 0.02)
    assert np.degrees(found.tilt) == pytest.approx(4.0, abs=0.2) and found.gravity_sd[1] > 10.0


def test_gravity_of_another_size_is_no_tilt(arm: Arm) -> None:
    found = find_cause(arm, [moved(arm, 40.0, bodies=with_gravity(arm, pulled(0.0, 0.0, -7.0)))])
    assert isinstance(found, Gravity) and not found.tilted and not found.absent
    assert "Gravity is 0.71" in found.text() and "base is mounted" not in found.text()


def test_a_cause_of_another_arm_is_refused_in_one_line(arm: Arm) -> None:
    error = BodyError("wrist", (), 10 * (0.0,), 10 * (0.0,), 1.0)
    for cause in (error, mounted("wrist", 0.3, 0.0, 0.0, 0.0)):
        with pytest.raises(SignalError, match="has no joint 'wrist'; it has: dfki_shoulder, dfki_elbow"):
            with_causes(arm, [cause])


def test_gravity_that_the_controller_subtracted_is_absent(arm: Arm, tmp_path: Path) -> None:
    found = find_cause(arm, [moved(arm, 40.0, bodies=with_gravity(arm, pulled(0.0, 0.0, 0.0)))])
    assert isinstance(found, Gravity) and found.absent and "absent from the recorded torques" in found.text()
    (file := tmp_path / "report_gravity.json").write_text(json.dumps(asdict(found)))
    assert read_cause(file) == found
    assert np.linalg.norm(with_causes(arm, [found]).model.gravity.linear) < 0.2


@pytest.mark.parametrize("position", [(0.0, 0.0, -0.2), (0.05, 0.0, -0.2)])
def test_a_payload_is_found_from_all_joints_together(arm: Arm, position: tuple[float, float, float]) -> None:
    """Beside friction of both joints, which each joint can explain alone; no torque depends on y, along the axes."""
    planted = mounted("dfki_elbow", 0.3, *position)
    found = find_cause(arm, [moved(arm, 40.0, bodies=with_payload(arm, planted))])
    assert found is not None and found.link == "dfki_elbow" and not found.tied and found.explained > 0.9
    assert found.mass == pytest.approx(0.3, abs=3.0 * found.mass_sd) and found.mass_sd < 0.005
    assert found.position_sd[1] == pytest.approx(1.0, rel=1e-3)
    for axis in (0, 2):
        assert found.position[axis] == pytest.approx(position[axis], abs=3.0 * found.position_sd[axis])
        assert found.position_sd[axis] < 0.005
    restored = with_payload(with_payload(arm, planted), replace(planted, mass=-planted.mass))
    q, v, a = np.random.default_rng(2).normal(size=(3, 5, 2))
    np.testing.assert_allclose(restored.torques(q, v, a), arm.torques(q, v, a), atol=1e-9)


def test_joints_are_diagnosed_with_the_payload_and_their_gap_comes_again_with_it(arm: Arm, tmp_path: Path) -> None:
    planted = mounted("dfki_elbow", 0.3, 0.0, 0.0, -0.2)
    loaded, name = with_payload(arm, planted), "dfki_elbow"
    run, held = (
        written(moved(arm, 12.0, phase, loaded), tmp_path / f"{name}.csv")
        for name, phase in (("run", 0.0), ("held", 20.0))
    )
    words = ["gap", "diagnose", run, "--arm", arm.name, "--holdout", held, "--json", str(tmp_path / "report.json")]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0 and done.output.startswith("Payload at dfki_elbow: mass 0.3"), done.output
    report = read_report((tmp_path / f"report_{name}.json").read_text(), "report")
    assert (report.causes[0].effect, report.verdict) == ("coulomb_friction", "effect") and report.gap is not None
    assert report.causes[0].parameters["torque"].value == pytest.approx(FRICTION[1], rel=0.1)
    words = ["gap", "simulate", held, "--arm", arm.name, "--device", name, "--json", str(tmp_path / "again.json")]
    words += ["--report", str(tmp_path / f"report_{name}.json")]
    for payload, same in (([], False), (["--payload", str(tmp_path / "report_payload.json")], True)):
        assert CliRunner().invoke(app, [*words, *payload]).exit_code == 0
        after = json.loads((tmp_path / "again.json").read_text())["after"]
        assert (after == pytest.approx(report.gap.after, rel=1e-6)) is same


def spatial(arm: Arm) -> Arm:
    """Pan, lift and elbow, with the devices of the shipped arm under other names."""
    model, parent = pinocchio.Model(), 0
    inertia = pinocchio.Inertia(2.0, np.array([0.12, 0.0, 0.04]), np.diag([0.006, 0.03, 0.03]))
    for name, joint, place in (
        ("pan", pinocchio.JointModelRZ(), (0.0, 0.0, 0.1)),
        ("lift", pinocchio.JointModelRY(), (0.0, 0.05, 0.1)),
        ("elbow", pinocchio.JointModelRY(), (0.3, 0.0, 0.0)),
    ):
        parent = model.addJoint(parent, joint, pinocchio.SE3(np.eye(3), np.array(place)), name)
        model.appendBodyToJoint(parent, inertia, pinocchio.SE3.Identity())
    devices = tuple(arm.devices[0].model_copy(update={"name": name}) for name in ("pan", "lift", "elbow"))
    return Arm("spatial", devices, model, np.arange(3))


def waves(
    arm: Arm, bodies: Arm, loaded: Arm, seed: int, offsets: tuple[float, ...] = (0.0, 0.0, 0.0)
) -> list[JointLog]:
    """Three joints with bodies `loaded` move along random waves; their angles are read with offsets."""
    time = np.arange(round(30.0 * RATE)) / RATE
    rng = np.random.default_rng(seed)
    speed, phase = 2.0 * np.pi * rng.uniform(0.15, 1.3, (4, 3)), rng.uniform(0.0, 6.28, (4, 3))
    at = speed * time[:, None, None] + phase
    q, v, a = (0.2 * np.sum(speed**k * np.sin(at + 0.5 * np.pi * k), axis=1) for k in range(3))
    link = arm.devices[0].link
    drive = loaded.torques(q, v, a) + link.viscous_friction * v + (link.coulomb_friction + 0.3) * np.sign(v)
    drive += rng.normal(0.0, 0.03, q.shape)
    read, units = q + np.array(offsets) + rng.normal(0.0, 5e-5, q.shape), {"q": "rad", "tau": "N m"}
    return [
        JointLog("wave", device, Signals(time, {"q": read[:, i], "tau": drive[:, [i]]}, units), None)
        for i, device in enumerate(bodies.devices)
    ]


@pytest.mark.parametrize(
    ("position", "seed"), [((0.1, -0.3, 0.2), 5), ((0.1, -0.3, 0.2), 0), ((0.28, 0.0, -0.28), 0), ((0.3, 0.1, 0.0), 1)]
)
def test_the_least_of_several_minima_is_found(arm: Arm, position: tuple[float, float, float], seed: int) -> None:
    """In the first case a fit that starts at the joint ends at another place, with the whole forearm absent. In the
    others cubic smoothing, whose accelerations are too small, moves the place by up to nine standard deviations."""
    bodies = spatial(arm)
    loaded = with_payload(bodies, mounted("elbow", 0.7, *position))
    found = find_cause(bodies, [waves(arm, bodies, loaded, seed)])
    assert found is not None and found.link == "elbow" and not found.tied
    assert found.mass == pytest.approx(0.7, abs=3.0 * found.mass_sd) and found.mass_sd < 0.01
    for value, sd, wanted in zip(found.position, found.position_sd, position, strict=True):
        assert value == pytest.approx(wanted, abs=3.0 * sd) and sd < 0.01


def test_a_payload_is_found_in_a_recording_that_rests(arm: Arm) -> None:
    """Blocks in which every joint stands have no window that counts."""
    loaded = with_payload(arm, mounted("dfki_elbow", 0.3, 0.0, 0.0, -0.2))
    run = moved(arm, 40.0, bodies=loaded)
    rest = round(6.0 * RATE)
    still = []
    for log in run:
        assert log.commands is not None
        late = np.concatenate([log.measured.time, log.measured.time[-1] + np.arange(1, rest + 1) / RATE])
        measured, sent = (
            Signals(
                late, {key: np.pad(x, (0, rest), mode="edge") for key, x in each.channels.items()}, each.units, held
            )
            for each, held in ((log.measured, frozenset()), (log.commands, frozenset(log.commands.channels)))
        )
        still.append(replace(log, measured=measured, commands=sent))
    found, moving = find_cause(arm, [still]), find_cause(arm, [run])
    assert found is not None and moving is not None
    assert found.mass == pytest.approx(moving.mass, abs=moving.mass_sd)


def test_a_payload_is_found_at_a_low_rate(arm: Arm) -> None:
    """50 Hz, where the smoothing has few samples."""
    rare, taken = [], slice(None, None, round(RATE / 50.0))
    for log in moved(arm, 40.0, bodies=with_payload(arm, mounted("dfki_elbow", 0.3, 0.0, 0.0, -0.2))):
        assert log.torque is not None
        channels = {"q": log.measured["q"][taken], "tau": log.torque[taken]}
        rare.append(replace(log, measured=Signals(log.measured.time[taken], channels, {"q": "rad", "tau": "N m"})))
    found = find_cause(arm, [rare])
    assert found is not None and found.mass == pytest.approx(0.3, abs=0.03)


def test_a_payload_is_found_from_the_goals_of_position_drives(arm: Arm) -> None:
    """Their torque follows from goal, angle and speed."""
    logs = []
    for i, log in enumerate(moved(arm, 40.0, bodies=with_payload(arm, mounted("dfki_elbow", 0.3, 0.0, 0.0, -0.2)))):
        goal = {"equilibrium": wanted(log.measured.time)[i]}
        commands = Signals(log.measured.time, goal, {"equilibrium": "rad"}, frozenset(goal))
        drive = {"drive": "position", "servo": PositionDrive(kp=KP[i], kd=KD[i])}
        logs.append(replace(log, device=log.device.model_copy(update=drive), commands=commands))
        assert logs[-1].torque is None
    found = find_cause(arm, [logs])
    assert isinstance(found, Payload) and found.link == "dfki_elbow"
    assert found.mass == pytest.approx(0.3, abs=0.03)


def test_a_payload_file_is_read_back_and_others_are_refused(arm: Arm, tmp_path: Path) -> None:
    payload, file = mounted("dfki_elbow", 0.3, 0.0, 0.0, -0.2), tmp_path / "report_payload.json"
    file.write_text(json.dumps(asdict(payload)))
    assert read_cause(file) == payload and is_cause(file)
    file.write_text('{"link": "dfki_elbow"}')
    assert not is_cause(file)
    with pytest.raises(SignalError, match=r"report_payload\.json: no payload, body, offset or gravity of an arm: "):
        read_cause(file)
    with pytest.raises(SignalError, match="has no joint 'wrist'; it has: dfki_shoulder, dfki_elbow"):
        with_payload(arm, replace(payload, link="wrist"))


def test_no_payload_is_found_where_none_is(arm: Arm) -> None:
    """Friction of the joints and a mass within the tolerance of the bodies are none, nor can a recording without torque
    show one; at the first joint mass and distance cannot be separated, which is left to the diagnosis of this joint."""
    assert find_cause(arm, [moved(arm, 40.0)]) is None
    light = mounted("dfki_elbow", 0.02, 0.0, 0.0, -0.1)  # the body has .63 kg, the tolerance is 5 %
    assert find_cause(arm, [moved(arm, 40.0, bodies=with_payload(arm, light))]) is None
    at_first = mounted("dfki_shoulder", 0.4, 0.0, 0.0, -0.1)
    assert find_cause(arm, [moved(arm, 40.0, bodies=with_payload(arm, at_first))]) is None
    silent = [replace(log, commands=None) for log in moved(arm, 8.0)]
    assert find_cause(arm, [silent]) is None


@pytest.mark.parametrize(("tolerance", "named"), [(0.0, ["torque_gain"]), (0.05, [])])
def test_torques_that_are_wrong_within_their_tolerance_are_no_cause(arm: Arm, tolerance: float, named: list[str]):
    """The forces of the other joints are not scaled by any other number, as those of a single joint are."""
    device = arm.devices[1]
    link = device.link.model_copy(update={"coulomb_friction": FRICTION[1]})
    known = device.tolerances.model_copy(update={"torque_scale": tolerance})
    log = moved(arm, 20.0)[1]
    scaled = {**log.commands.channels, "external_torque": 1.04 * log.commands["external_torque"]}
    commands = Signals(log.commands.time, scaled, log.commands.units, frozenset(scaled))
    stated = device.model_copy(update={"link": link, "tolerances": known})
    report = diagnose([replace(log, device=stated, commands=commands)], stated, only_equations=True)
    assert [each.effect for each in report.effects] == named
    if not named:
        (scale,) = (each for each in report.nuisance if each.name == "torque scale")
        assert scale.fitted == pytest.approx(1.0 / 1.04, abs=0.012)


def test_an_arms_page_draws_torques_in_their_unit(arm: Arm, answered: Path) -> None:
    page = (answered / f"page_{arm.devices[1].name}.html").read_text()
    assert "computed from the measured motion by inverse dynamics" in page
    assert 'data-y-unit="N m"' in page and 'data-y-unit="rad"' not in page
    assert page.count("<svg") >= 8


def test_the_gap_claimed_of_an_arms_joint_comes_again_from_its_files(arm: Arm, answered: Path) -> None:
    name = arm.devices[1].name
    report = read_report((answered / f"report_{name}.json").read_text(), "report")
    words = ["gap", "simulate", str(answered / "held.csv"), "--arm", arm.name, "--device", name]
    words += ["--effects", str(answered / f"repair_{name}.yaml"), "--json", str(answered / "again.json")]
    assert CliRunner().invoke(app, [*words, "--report", str(answered / f"report_{name}.json")]).exit_code == 0
    again = json.loads((answered / "again.json").read_text())
    assert report.gap is not None
    assert (again["before"], again["after"]) == pytest.approx((report.gap.before, report.gap.after), rel=1e-9)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["diagnose", "run.csv"], "give either --device or --arm"),
        (["diagnose", "run.csv", "--arm", "nobody"], "no arm 'nobody'"),
        (
            ["simulate", "run.csv", "--arm", "dfki_double_pendulum", "--device", "maccepavd"],
            "'maccepavd' is not a joint of 'dfki_double_pendulum', which has: dfki_shoulder, dfki_elbow",
        ),
    ],
)
def test_a_question_about_no_joint_is_refused(words: list[str], message: str) -> None:
    done = CliRunner().invoke(app, ["gap", *words])
    assert isinstance(done.exception, ViaError)
    assert message in str(done.exception)


def test_the_equation_needs_the_friction_that_was_there_and_counts_none_where_it_stands(arm: Arm) -> None:
    """Along a log with friction the missing torque is that friction with the sign of the motion, whatever the pose."""
    log = moved(arm, 8.0)[0]
    segments = cut_log(log)
    problem = ResidualModel.of([segments], [np.flatnonzero(segments.valid)], InverseDynamics.of)
    view = problem.views[0]
    assert isinstance(view, InverseDynamics)
    missing = problem.residual([problem.row([])])[0].reshape(view.first.shape) * view.windows.floor[0]
    speed = np.abs(view.segments.start[view.first + 18, 3])
    fast = speed > 0.4
    assert np.median(np.abs(missing[fast])) == pytest.approx(FRICTION[0], rel=0.05)
    right = Effect("coulomb_friction", "link", {"torque": FRICTION[0]})
    left = problem.residual([problem.row([right])])[0].reshape(view.first.shape) * view.windows.floor[0]
    assert np.sqrt(np.mean(left**2)) < 0.25 * np.sqrt(np.mean(missing**2))


def test_logs_that_are_not_of_one_recording_are_refused(arm: Arm) -> None:
    first, second = moved(arm, 1.0)
    late = replace(second, measured=Signals(second.measured.time + 0.1, {"q": second.measured["q"]}, {"q": "rad"}))
    with pytest.raises(SignalError, match="not recorded with the rest of the arm"):
        arm_logs([first, late], arm)
    with pytest.raises(SignalError, match="neither torque nor goal of the drive of 'dfki_elbow' was recorded"):
        arm_logs([first, replace(second, commands=None)], arm)


def test_a_table_of_the_whole_arm_becomes_one_log_per_joint(arm: Arm, tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    time = np.arange(200) / RATE
    table = np.column_stack([time, np.sin(time), np.cos(time), 0.1 * time, 0.2 * time])
    np.savetxt(path, table, delimiter=",", header="time,pos1,pos2,tau1,tau2", comments="")
    logs = read_arm_log(path, arm)
    assert [log.device.name for log in logs] == ["dfki_shoulder", "dfki_elbow"]
    for i, log in enumerate(logs):
        assert log.commands is not None
        np.testing.assert_allclose(log.measured["q"], table[:, 1 + i])
        np.testing.assert_allclose(log.commands["external_torque"], table[:, 3 + i])
        np.testing.assert_allclose(log.commands["neighbour"], table[:, 2 - i], atol=1e-4)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            ("joints: [dfki_shoulder, dfki_elbow]", "joints: [dfki_shoulder, maccepavd]"),
            "an arm's joints must be rigid",
        ),
        (
            ("joints: [dfki_shoulder, dfki_elbow]", "joints: [dfki_shoulder, compact_vpda]"),
            "no joint 'compact_vpda_shaft",
        ),
        (("rotors: [0.0022466, 0.00218588]", "rotors: [0.1]"), "rotors needs 0 or 2 numbers, got 1"),
        (("title:", "tiddle:"), "arm.yaml: title: is missing"),
    ],
)
def test_arm_files_that_cannot_be_are_refused(change: tuple[str, str], message: str, tmp_path: Path) -> None:
    folder = Path(via_core.__file__).parent / "arms"
    for name in ("dfki_double_pendulum.yaml", "dfki_double_pendulum.urdf"):
        text = (folder / name).read_text()
        (tmp_path / name.replace("dfki_double_pendulum.yaml", "arm.yaml")).write_text(text.replace(*change))
    with pytest.raises(DeviceError, match=message):
        load_arm(tmp_path / "arm.yaml")
    with pytest.raises(DeviceError, match="no arm 'nobody'; there are: dfki_double_pendulum"):
        load_arm("nobody")
