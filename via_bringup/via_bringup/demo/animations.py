"""Short animations of the robots of the scenes, drawn from their bags."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pinocchio
from matplotlib.animation import FuncAnimation, PillowWriter
from via_core.hopper import Hopper
from via_core.signals import Array
from via_core.vsa_arms import VsaArm

from via_bringup.demo.pictures import FAINT, MODEL, REAL, REFERENCE
from via_bringup.demo.scene_recording import Recorded

FRAMES, SHOWN = 15, 4.0  # frame rate [Hz] and simulated time [s] of an animation
Frame = Callable[[int], None]


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


def throw_animation(seen: Recorded, velocity: Array, path: Path) -> Path:
    """Animate link and motor of a throw in slow motion; `velocity` (N,) [rad/s] of the link is written beside it."""
    q, theta = seen.position[:, 0], seen.position[:, 1]
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

    return _animated(figure, show, len(pick), path)


def hopper_animation(robot: Hopper, seen: Recorded, path: Path) -> Path:
    """Animate the first seconds of the hopper, seen from the side."""
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

    return _animated(figure, show, len(pick), path)


def arm_animation(arm: VsaArm, seen: Recorded, wall: Array | None, path: Path) -> Path:
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
        axes.set(xlabel=f"{words[0]} [m]", ylabel=f"{words[1]} [m]")
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
