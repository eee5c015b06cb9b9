"""Controller scenes: each simulates a robot, and writes a bag, phase plots and a short animation.

Simulator, controller and recorder run in one process, in lockstep over DDS. The pictures are drawn from the bag.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import pinocchio
from matplotlib.animation import FuncAnimation, PillowWriter
from scipy.signal import savgol_filter
from via_controllers.joint_methods import MaxVelocityParameters
from via_controllers.modal_transform import first_basis
from via_controllers.nodes.single import NODES
from via_core.bags.reader import Columns, read_bag
from via_core.devices import load_device
from via_core.errors import ParameterError
from via_core.hopper import Hopper
from via_core.signals import Array
from via_core.vsa_arms import VsaArm
from via_ros.composition import Composition
from via_ros.nodes.recorder import Recorder
from via_sim.nodes.arm_simulator import ArmSimulatorNode
from via_sim.nodes.hopper_simulator import HopperSimulatorNode
from via_sim.nodes.simulator import SimulatorNode

from via_bringup.demo.pictures import FAINT, MODEL, REAL, REFERENCE, STYLE
from via_bringup.demo.reference import ARM, EQUILIBRIUM, LEVEL, STIFFNESS, damped_arm, throwing_controller, wall_scene

FRAMES, SHOWN = 15, 4.0  # frame rate [Hz] and simulated time [s] of an animation
TIMEOUT = 60.0  # [s] of wall time per simulated second, at least one
WALL_AT, START_AT = 0.5, 1.2  # hitting scene: fractions of the distance to the free turning point
COLOURS = (REAL, MODEL, "#2a7f62", "#b08ea2")
Frame = Callable[[int], None]


@dataclass(frozen=True)
class Robot:
    """A simulated robot."""

    name: str  # of its topics
    node: Callable[..., Any]
    contact: str = ""  # type of its messages on `contact`; empty: none
    base: str = ""  # type of its messages on `base`; empty: the base is fixed


SIMULATED_ARM = Robot(ARM.name, ArmSimulatorNode, contact="geometry_msgs/msg/WrenchStamped")


@dataclass(frozen=True)
class Recorded:
    """Content of the bag of a scene, with N samples."""

    time: Array  # (N,) [s]
    position: Array  # (N, l) [rad] of links and motors, in the order of the JointState message
    speed: Array  # (N, l) [rad/s], NaN where it is not measured
    names: tuple[str, ...]  # of the controller's quantities
    values: Array  # (K, k) the controller's quantities in its ControlState messages
    trunk: Array  # (N, 3) x [m], z [m], pitch [rad] of a moving base; (N, 0) for a fixed base

    @property
    def q(self) -> Array:
        """(N, n) [rad] link angles of an arm, whose links and motors alternate."""
        return self.position[:, ::2]

    @property
    def velocity(self) -> Array:
        """(N, n) [rad/s] link velocities of an arm."""
        return self.speed[:, ::2]

    def quantity(self, name: str) -> Array:
        """(K,) the controller's quantity of this name."""
        return np.asarray(self.values[:, self.names.index(name)], dtype=float)


def run_scene(scene: str, out: Path, duration: float) -> list[Path]:
    """Run a scene and return the paths written to `out`; `duration` [s]. Raises ParameterError for an unknown name."""
    if scene not in SCENES:
        raise ParameterError(f"no scene '{scene}'; there are: {', '.join(SCENES)}")
    out.mkdir(parents=True, exist_ok=True)
    with plt.rc_context(STYLE):
        return SCENES[scene](out, duration)


def _limit_cycle(out: Path, duration: float) -> list[Path]:
    z = np.zeros(ARM.n)
    z[0] = 0.3 * np.sqrt(2.0 * LEVEL)
    start = EQUILIBRIUM + first_basis(ARM.inertia(EQUILIBRIUM), STIFFNESS).W @ z
    seen = _record(out / "bag", SIMULATED_ARM, NODES["modal_limit_cycle"], duration, posture=start.tolist())
    figure, (modal, joints, level) = plt.subplots(1, 3, figsize=(14, 4.6), constrained_layout=True)
    step = float(np.diff(seen.time).mean())
    for i, colour in enumerate(COLOURS):
        mode = seen.quantity(f"z_{i + 1}")
        modal.plot(mode, np.gradient(mode, step), color=colour, linewidth=0.9, label=f"mode {i + 1}")
    modal.set_xlabel("z [sqrt(kg m^2) rad]")
    modal.set_ylabel("zd [sqrt(kg m^2) rad/s]")
    modal.legend(loc="upper right", fontsize=9)
    _joints_plot(joints, seen, EQUILIBRIUM)
    level.plot(step * np.arange(len(seen.values)), seen.quantity("H") / LEVEL, color=REAL)
    level.set_xlabel("time [s]")
    level.set_ylabel("H / H_d [-]")
    return [out / "bag", _saved(figure, out / "phase.png"), _arm_animation(ARM, seen, None, out / "motion.gif")]


def _hitting(out: Path, duration: float) -> list[Path]:
    arm, scene = damped_arm(), wall_scene(WALL_AT, START_AT)
    point, normal = scene.face, -scene.along
    seen = _record(
        out / "bag", SIMULATED_ARM, NODES["bang_bang"], duration, posture=scene.start.tolist(),
        walls=[*point.tolist(), *normal.tolist()], link_friction=arm.link_friction.tolist(),
    )  # fmt: skip
    figure, (tip, joints) = plt.subplots(1, 2, figsize=(11, 4.6), constrained_layout=True)
    path = np.array([arm.tip_position(q) for q in seen.q])
    tip.plot(seen.time, 1e3 * (path - point) @ -normal, color=REAL)
    tip.axhspan(0.0, 5.0, color=FAINT, alpha=0.5, linewidth=0)
    tip.set_xlabel("time [s]")
    tip.set_ylabel("tip beyond the wall's face [mm]")
    _joints_plot(joints, seen, scene.rest)
    return [out / "bag", _saved(figure, out / "phase.png"), _arm_animation(arm, seen, point, out / "motion.gif")]


def _throw(out: Path, duration: float) -> list[Path]:
    device, parameters = load_device("visco_elastic_demo"), MaxVelocityParameters()
    controller, ideal = throwing_controller(device, parameters.damping, parameters.turns)
    robot = Robot(device.name, SimulatorNode)
    seen = _record(out / "bag", robot, NODES["max_velocity"], controller.horizon + 0.4, device=device.name)
    q, theta = seen.position[:, 0], seen.position[:, 1]
    # Velocities are not measured, so they are estimated over 11 ms, in which the link hardly turns.
    velocity, motor = savgol_filter(seen.position, 11, 2, deriv=1, delta=1e-3, axis=0).T
    figure, (speeds, phase) = plt.subplots(1, 2, figsize=(11, 4.6), constrained_layout=True)
    speeds.plot(seen.time, motor, color=MODEL, linewidth=0.9, label="motor")
    speeds.plot(seen.time, velocity, color=REAL, label="link")
    speeds.plot(
        [controller.horizon], [parameters.speed_share * ideal], "o", color=REFERENCE, label="closed form, ideal motor"
    )
    speeds.set_xlabel("time [s]")
    speeds.set_ylabel("velocity [rad/s]")
    speeds.legend(loc="upper left", fontsize=10)
    phase.plot(q - theta, velocity, color=REAL)
    phase.set_xlabel("deflection of the spring [rad]")
    phase.set_ylabel("velocity of the link [rad/s]")
    drawn = _saved(figure, out / "phase.png")

    figure, axes = plt.subplots(figsize=(4.5, 4.5), constrained_layout=True)
    axes.set(xlim=(-1.2, 1.2), ylim=(-1.2, 1.2), aspect="equal", xticks=[], yticks=[])
    (link,), (motor,) = axes.plot([], [], color=REAL, linewidth=5), axes.plot([], [], color=MODEL, linewidth=2)
    slow = 4  # times slower than real time
    pick = np.arange(0, len(seen.time), max(1, round(1.0 / (FRAMES * slow) / (seen.time[1] - seen.time[0]))))

    def show(frame: int) -> None:
        k = pick[frame]
        link.set_data([0.0, np.cos(q[k])], [0.0, np.sin(q[k])])
        motor.set_data([0.0, 0.6 * np.cos(theta[k])], [0.0, 0.6 * np.sin(theta[k])])
        axes.set_title(f"{seen.time[k]:.2f} s, link {velocity[k]:+.1f} rad/s ({slow} times slower)", fontsize=11)

    return [out / "bag", drawn, _animated(figure, show, len(pick), out / "motion.gif")]


def _hopper(out: Path, duration: float) -> list[Path]:
    robot = Hopper()
    simulated = Robot("hopper", HopperSimulatorNode, SIMULATED_ARM.contact, base="geometry_msgs/msg/PoseStamped")
    seen = _record(out / "bag", simulated, NODES["hopping"], duration)
    figure, (height, phase) = plt.subplots(1, 2, figsize=(11, 4.6), constrained_layout=True)
    height.plot(seen.time, seen.trunk[:, 1], color=REAL)
    height.set_xlabel("time [s]")
    height.set_ylabel("height of the trunk [m]")
    phase.plot(seen.trunk[:, 1], np.gradient(seen.trunk[:, 1], seen.time), color=REAL, linewidth=0.8)
    phase.set_xlabel("height of the trunk [m]")
    phase.set_ylabel("its rate [m/s]")
    drawn = _saved(figure, out / "phase.png")

    figure, axes = plt.subplots(figsize=(4.5, 4.5), constrained_layout=True)
    axes.set(xlim=(-0.5, 0.5), ylim=(-0.05, 0.75), aspect="equal", xticks=[])
    axes.axhline(0.0, color=REFERENCE, linewidth=2)
    legs = [axes.plot([], [], color=colour, linewidth=3)[0] for colour in (REAL, MODEL)]
    (trunk,) = axes.plot([], [], color=REFERENCE, linewidth=8)
    pick = np.arange(0, min(len(seen.time), round(SHOWN * 1e3)), round(1e3 / FRAMES))

    def show(frame: int) -> None:
        k = pick[frame]
        points = skeleton(robot, seen.trunk[k], seen.q[k])
        trunk.set_data(*points[0].T)
        for line, leg in zip(legs, points[1:], strict=True):
            line.set_data(*leg.T)
        axes.set_title(f"{seen.time[k]:.2f} s", fontsize=11)

    return [out / "bag", drawn, _animated(figure, show, len(pick), out / "motion.gif")]


SCENES: dict[str, Callable[[Path, float], list[Path]]] = {
    "limit-cycle": _limit_cycle,
    "hitting": _hitting,
    "hopper": _hopper,
    "throw": _throw,
}


def skeleton(robot: Hopper, trunk: Array, q: Array) -> list[Array]:
    """Points (k, 2) [m] (forward from the trunk, up) of the trunk, and of both legs from hip to foot."""
    half, length, pitch = 0.5 * robot.trunk_length, robot.segment_length, trunk[2]
    ahead = np.array([np.cos(pitch), -np.sin(pitch)])
    middle = np.array([0.0, trunk[1]])
    hips = middle + half * ahead, middle - half * ahead
    legs = []
    for hip, (first, second) in zip(hips, (q[:2], q[2:]), strict=True):
        knee = hip + length * np.array([np.sin(first - pitch), -np.cos(first - pitch)])
        bend = first + second - pitch
        legs.append(np.array([hip, knee, knee + length * np.array([np.sin(bend), -np.cos(bend)])]))
    return [np.array(hips), *legs]


def _record(bag: Path, robot: Robot, controller: Callable[..., Any], duration: float, **simulator: Any) -> Recorded:
    """Record the controller node on the simulated robot, in lockstep; `simulator` are parameters of its node."""
    base, control = f"/{robot.name}/base", f"/{robot.name}/control"
    topics = {
        "/joint_states": "sensor_msgs/msg/JointState",
        f"/{robot.name}/command": "via_interfaces/msg/VsaCommand",
        control: "via_interfaces/msg/ControlState",
        f"/{robot.name}/contact": robot.contact,
        base: robot.base,
    }
    needed = ["/joint_states", control, *([base] if robot.base else [])]
    wait = TIMEOUT * max(1.0, duration)
    with Composition() as graph:
        graph.add(controller)
        recorded = [f"{topic}:{kind}" for topic, kind in topics.items() if kind]
        recorder = graph.add(Recorder, bag=str(bag), topics=recorded)
        simulated = graph.add(robot.node, mode="lockstep", duration=duration, listeners=2, **simulator)
        graph.run_until(simulated.finished.done, wait, "the scene")
        least = round(duration * 1e3)
        graph.run_until(lambda: all(recorder.counts[topic].messages >= least for topic in needed), wait, "recording")
    found = read_bag(bag, needed)
    states, quantities = found["/joint_states"], found[control]
    stamps = found.topic("/joint_states").stamp
    return Recorded(
        time=1e-9 * (stamps - stamps[0]),
        position=np.array(list(states["position"]), dtype=float),
        speed=np.array(list(states["velocity"]), dtype=float),
        names=tuple(quantities["name"][0]),
        values=np.array(list(quantities["value"]), dtype=float),
        trunk=_trunk(found[base]) if robot.base else np.empty((len(stamps), 0)),
    )


def _trunk(poses: Columns) -> Array:
    """(N, 3) x [m], z [m] and pitch [rad] of a base that moves in the x-z plane."""
    x, z = poses["pose.position.x"], poses["pose.position.z"]
    return np.column_stack([x, z, 2.0 * np.arctan2(poses["pose.orientation.y"], poses["pose.orientation.w"])])


def _joints_plot(axes: plt.Axes, seen: Recorded, about: Array) -> None:
    for i, colour in enumerate(COLOURS):
        axes.plot(seen.q[:, i] - about[i], seen.velocity[:, i], color=colour, linewidth=0.8, label=f"joint {i + 1}")
    axes.set_xlabel("link angle about rest [rad]")
    axes.set_ylabel("link velocity [rad/s]")
    axes.legend(loc="upper right", fontsize=9)


def _arm_animation(arm: VsaArm, seen: Recorded, wall: Array | None, path: Path) -> Path:
    """Animate the last seconds of the arm, seen from the side and from above, with the path of its tip."""
    last = seen.time >= seen.time[-1] - SHOWN
    pick = np.flatnonzero(last)[:: max(1, round(1.0 / FRAMES / float(np.diff(seen.time).mean())))]
    data, points = arm.model.createData(), []
    for k in pick:
        pinocchio.forwardKinematics(arm.model, data, seen.q[k])
        points.append([np.zeros(3), np.array(data.oMi[arm.n].translation), arm.tip_position(seen.q[k])])
    bodies = np.array(points)
    figure, panels = plt.subplots(1, 2, figsize=(8, 4.2), constrained_layout=True)
    lines = []
    for axes, (i, j), words in zip(panels, ((0, 2), (0, 1)), (("x", "z"), ("x", "y")), strict=True):
        axes.set(xlim=(-0.1, 1.0), ylim=(-0.8, 0.3) if j == 2 else (-0.5, 0.6), aspect="equal")
        axes.set_xlabel(f"{words[0]} [m]")
        axes.set_ylabel(f"{words[1]} [m]")
        axes.plot(bodies[:, 2, i], bodies[:, 2, j], color=FAINT, linewidth=0.8)
        if wall is not None:
            axes.plot(wall[i], wall[j], "s", color=REFERENCE, markersize=7)
        lines.append((axes.plot([], [], "o-", color=REAL, linewidth=4, markersize=6)[0], i, j))

    def show(frame: int) -> None:
        for line, i, j in lines:
            line.set_data(bodies[frame, :, i], bodies[frame, :, j])
        figure.suptitle(f"{seen.time[pick[frame]]:.2f} s", fontsize=11)

    return _animated(figure, show, len(pick), path)


def _animated(figure: plt.Figure, show: Frame, frames: int, path: Path) -> Path:
    def drawn(frame: int) -> list[Any]:
        show(frame)
        return []

    FuncAnimation(figure, drawn, frames=frames, blit=False).save(path, writer=PillowWriter(fps=FRAMES), dpi=70)
    plt.close(figure)
    return path


def _saved(figure: plt.Figure, path: Path) -> Path:
    figure.savefig(path)
    plt.close(figure)
    return path
