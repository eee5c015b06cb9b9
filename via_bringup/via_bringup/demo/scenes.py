"""Controller scenes: each simulates a robot, and writes a bag, phase plots and a short animation.

Simulator, controller and recorder run in one process, in lockstep over DDS. The pictures are drawn from the bag.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy.signal import savgol_filter
from via_controllers.arms.modal_transform import first_basis
from via_controllers.joint_methods import MaxVelocityParameters
from via_controllers.nodes.single import NODES
from via_core.devices import load_device
from via_core.errors import ParameterError
from via_core.hopper import Hopper
from via_core.signals import Array
from via_sim.nodes.arm_simulator import ArmSimulatorNode
from via_sim.nodes.hopper_simulator import HopperSimulatorNode
from via_sim.nodes.simulator import SimulatorNode

from via_bringup.demo.animations import arm_animation, hopper_animation, throw_animation
from via_bringup.demo.pictures import FAINT, MODEL, REAL, REFERENCE, STYLE, save_figure
from via_bringup.demo.reference import ARM, EQUILIBRIUM, LEVEL, STIFFNESS, damped_arm, throwing_controller, wall_scene
from via_bringup.demo.scene_recording import Progress, Recorded, Robot, record_scene

WALL_AT, START_AT = 0.5, 1.2  # hitting scene: fractions of the distance to the free turning point
COLOURS = (REAL, MODEL, "#2a7f62", "#b08ea2")


SIMULATED_ARM = Robot(ARM.name, ArmSimulatorNode, contact="geometry_msgs/msg/WrenchStamped")


def run_scene(scene: str, out: Path, duration: float, progress: Progress) -> list[Path]:
    """Run a scene and return the paths written to `out`; `duration` [s]. Raises ParameterError for an unknown name."""
    if scene not in SCENES:
        raise ParameterError(f"no scene '{scene}'; there are: {', '.join(SCENES)}")
    out.mkdir(parents=True, exist_ok=True)
    with plt.rc_context(STYLE):
        return SCENES[scene](out, duration, progress)


def _limit_cycle(out: Path, duration: float, progress: Progress) -> list[Path]:
    z = np.zeros(ARM.n)
    z[0] = 0.3 * np.sqrt(2.0 * LEVEL)
    start = EQUILIBRIUM + first_basis(ARM.inertia(EQUILIBRIUM), STIFFNESS).W @ z
    seen = record_scene(
        out / "bag", SIMULATED_ARM, NODES["modal_limit_cycle"], duration, progress, posture=start.tolist()
    )
    figure, (modal, joints, level) = plt.subplots(1, 3, figsize=(14, 4.6), constrained_layout=True)
    step = float(np.diff(seen.time).mean())
    for i, colour in enumerate(COLOURS):
        mode = seen.quantity(f"z_{i + 1}")
        modal.plot(mode, np.gradient(mode, step), color=colour, linewidth=0.9, label=f"mode {i + 1}")
    modal.set(xlabel="z [sqrt(kg m^2) rad]", ylabel="zd [sqrt(kg m^2) rad/s]")
    modal.legend(loc="upper right", fontsize=9)
    _joints_plot(joints, seen, EQUILIBRIUM)
    level.plot(step * np.arange(len(seen.values)), seen.quantity("H") / LEVEL, color=REAL)
    level.set(xlabel="time [s]", ylabel="H / H_d [-]")
    return [out / "bag", save_figure(figure, out / "phase.png"), arm_animation(ARM, seen, None, out / "motion.gif")]


def _hitting(out: Path, duration: float, progress: Progress) -> list[Path]:
    arm, scene = damped_arm(), wall_scene(WALL_AT, START_AT)
    point, normal = scene.face, -scene.along
    seen = record_scene(
        out / "bag", SIMULATED_ARM, NODES["bang_bang"], duration, progress, posture=scene.start.tolist(),
        walls=[*point.tolist(), *normal.tolist()], link_friction=arm.link_friction.tolist(),
    )  # fmt: skip
    figure, (tip, joints) = plt.subplots(1, 2, figsize=(11, 4.6), constrained_layout=True)
    path = np.array([arm.tip_position(q) for q in seen.q])
    tip.plot(seen.time, 1e3 * (path - point) @ -normal, color=REAL)
    tip.axhspan(0.0, 5.0, color=FAINT, alpha=0.5, linewidth=0)
    tip.set(xlabel="time [s]", ylabel="tip beyond the wall's face [mm]")
    _joints_plot(joints, seen, scene.rest)
    return [out / "bag", save_figure(figure, out / "phase.png"), arm_animation(arm, seen, point, out / "motion.gif")]


def _throw(out: Path, duration: float, progress: Progress) -> list[Path]:
    device, parameters = load_device("visco_elastic_demo"), MaxVelocityParameters()
    controller, ideal = throwing_controller(device, parameters.damping, parameters.turns)
    robot = Robot(device.name, SimulatorNode)
    seen = record_scene(
        out / "bag", robot, NODES["max_velocity"], controller.horizon + 0.4, progress, device=device.name
    )
    q, theta = seen.position[:, 0], seen.position[:, 1]
    # Velocities are not measured, so they are estimated over 11 ms, in which the link hardly turns.
    velocity, motor = savgol_filter(seen.position, 11, 2, deriv=1, delta=1e-3, axis=0).T
    figure, (speeds, phase) = plt.subplots(1, 2, figsize=(11, 4.6), constrained_layout=True)
    speeds.plot(seen.time, motor, color=MODEL, linewidth=0.9, label="motor")
    speeds.plot(seen.time, velocity, color=REAL, label="link")
    speeds.plot(
        [controller.horizon], [parameters.speed_share * ideal], "o", color=REFERENCE, label="closed form, ideal motor"
    )
    speeds.set(xlabel="time [s]", ylabel="velocity [rad/s]")
    speeds.legend(loc="upper left", fontsize=10)
    phase.plot(q - theta, velocity, color=REAL)
    phase.set(xlabel="deflection of the spring [rad]", ylabel="velocity of the link [rad/s]")
    drawn = save_figure(figure, out / "phase.png")
    return [out / "bag", drawn, throw_animation(seen, velocity, out / "motion.gif")]


def _hopper(out: Path, duration: float, progress: Progress) -> list[Path]:
    robot = Hopper()
    simulated = Robot("hopper", HopperSimulatorNode, SIMULATED_ARM.contact, base="geometry_msgs/msg/PoseStamped")
    seen = record_scene(out / "bag", simulated, NODES["hopping"], duration, progress)
    figure, (height, phase) = plt.subplots(1, 2, figsize=(11, 4.6), constrained_layout=True)
    height.plot(seen.time, seen.trunk[:, 1], color=REAL)
    height.set(xlabel="time [s]", ylabel="height of the trunk [m]")
    phase.plot(seen.trunk[:, 1], np.gradient(seen.trunk[:, 1], seen.time), color=REAL, linewidth=0.8)
    phase.set(xlabel="height of the trunk [m]", ylabel="its rate [m/s]")
    drawn = save_figure(figure, out / "phase.png")
    return [out / "bag", drawn, hopper_animation(robot, seen, out / "motion.gif")]


SCENES: dict[str, Callable[[Path, float, Progress], list[Path]]] = {
    "limit-cycle": _limit_cycle,
    "hitting": _hitting,
    "hopper": _hopper,
    "throw": _throw,
}


def _joints_plot(axes: plt.Axes, seen: Recorded, about: Array) -> None:
    for i, colour in enumerate(COLOURS):
        axes.plot(seen.q[:, i] - about[i], seen.velocity[:, i], color=colour, linewidth=0.8, label=f"joint {i + 1}")
    axes.set(xlabel="link angle about rest [rad]", ylabel="link velocity [rad/s]")
    axes.legend(loc="upper right", fontsize=9)
