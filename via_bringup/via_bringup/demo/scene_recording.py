"""Simulator, controller and recorder in one process, in lockstep over DDS: the bag of a scene and its content."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from via_core.bags.reader import Columns, read_bag
from via_core.signals import Array
from via_ros.composition import Composition
from via_ros.nodes.recorder import Recorder

Progress = Callable[[str, float], None]  # step, share of it that is done
TIMEOUT = 60.0  # [s] of wall time per simulated second, at least one


@dataclass(frozen=True)
class Robot:
    """A simulated robot."""

    name: str  # of its topics
    node: Callable[..., Any]
    contact: str = ""  # type of its messages on `contact`; empty: none
    base: str = ""  # type of its messages on `base`; empty: the base is fixed


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


def record_scene(
    bag: Path, robot: Robot, controller: Callable[..., Any], duration: float, progress: Progress, **simulator: Any
) -> Recorded:
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
    progress("starting the nodes", 0.0)
    with Composition() as graph:
        graph.add(controller)
        recorded = [f"{topic}:{kind}" for topic, kind in topics.items() if kind]
        recorder = graph.add(Recorder, bag=str(bag), topics=recorded)
        simulated = graph.add(robot.node, mode="lockstep", duration=duration, listeners=2, **simulator)
        least = round(duration * 1e3)

        def done() -> bool:
            progress("simulating and recording", simulated.ticks / least)
            return bool(simulated.finished.done())

        graph.run_until(done, wait, "the scene")
        graph.run_until(lambda: all(recorder.counts[topic].messages >= least for topic in needed), wait, "recording")
    progress("drawing pictures and animation", float("nan"))
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
