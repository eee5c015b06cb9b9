"""An arm and its controller over DDS in real time at 1 kHz in one process: share of late commands and its effect.

The controllers are the limit cycle after a push and the bang-bang controller from a deflection, as in the lockstep
tests. A command is late if it arrives after the next sample was published; the simulator then keeps the previous one.
The process requests real-time scheduling and reports whether it was granted: without it the number of late commands
depends on the load of the machine.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from via_bringup.demo import reference
from via_controllers.arms.modal_transform import first_basis
from via_controllers.nodes.single import NODES
from via_core.errors import ViaError
from via_core.signals import Array
from via_interfaces.msg import ControlState
from via_interfaces.srv import Push
from via_ros import qos
from via_ros.composition import Composition
from via_sim.nodes.arm_simulator import ArmSimulatorNode

from via_validation.bench.scheduling import real_time
from via_validation.control import bang_bang
from via_validation.control.cycles import Cycles, relative_sd
from via_validation.tables.rows import Row

RATE = 1000.0  # [Hz]
REPORT_EVERY = 10  # samples: receiving a message takes as long as evaluating the controller
PATIENCE = 30.0  # [s] in addition to the simulated time
SETTINGS = "reference_4dof, realtime, 1 kHz, one process, one executor"


@dataclass(frozen=True)
class Live:
    """N samples of a controller in real time, every `REPORT_EVERY`-th one."""

    names: tuple[str, ...]
    values: Array  # (N, k) controller state
    late_commands: float  # share of all
    late_ticks: float  # share of all
    limited: float  # share of samples
    scheduling: str  # real-time or usual

    @property
    def settings(self) -> str:
        """Description of the measurement."""
        return f"{SETTINGS}, {self.scheduling} scheduling"

    def late(self, name: str) -> Array:
        """The quantity of this name in the second half."""
        return np.asarray(self.values[len(self.values) // 2 :, self.names.index(name)])


def live(
    kind: Callable[..., Any], parameters: dict[str, Any], simulator: dict[str, Any], push: Array, seconds: float
) -> Live:
    """Run the controller node `kind` for `seconds` [s] of real time from links deflected by `push` (n,) [rad].

    parameters, simulator  node parameters of the controller and of the simulator
    """
    with real_time() as granted, Composition() as graph:
        graph.add(kind, told_every=REPORT_EVERY, **parameters)
        arm = graph.add(ArmSimulatorNode, mode="realtime", rate=RATE, duration=seconds, listeners=1, **simulator)
        received: list[tuple[int, Array]] = []
        names: list[str] = []

        def receive(message: ControlState) -> None:
            names[:] = names or message.name
            received.append((message.limited, np.array(message.value)))

        arm.create_subscription(ControlState, "/reference_4dof/control", receive, qos.SAMPLES)
        pusher = arm.create_client(Push, "/arm_simulator/push")
        graph.run_until(lambda: pusher.service_is_ready() and len(received) > 1, PATIENCE, "the first samples")
        answer = pusher.call_async(Push.Request(deflection=push.tolist()))
        graph.run_until(answer.done, PATIENCE, "a push")
        if not answer.result().success:
            raise ViaError(answer.result().message)
        graph.run_until(arm.finished.done, seconds + PATIENCE, "the end")
        shares = arm.late_commands, arm.late_ticks / arm.ticks
    limited = float(np.mean([bool(each) for each, _ in received]))
    scheduling = "real-time" if granted else "usual"
    return Live(tuple(names), np.array([values for _, values in received]), *shares, limited, scheduling)


def arm_rows(seconds: float) -> list[Row]:
    """Rows of both controllers, each run for `seconds` [s]."""
    return [*_modal(seconds), *_bang_bang(seconds)]


def _modal(seconds: float) -> Iterator[Row]:
    k, level = 0, reference.LEVEL
    z = np.zeros(reference.ARM.n)
    z[k] = 0.5 * np.sqrt(2.0 * level)
    W = first_basis(reference.ARM.inertia(reference.EQUILIBRIUM), reference.STIFFNESS).W
    found = live(
        NODES["modal_limit_cycle"], {"mode": k + 1}, {"posture": reference.EQUILIBRIUM.tolist()}, W @ z, seconds
    )
    what = "limit cycle, mode 1"
    yield from _shares("arm.limit_cycle", what, found)
    error = float(np.abs(found.late("H") / level - 1.0).max())
    yield Row("arm.limit_cycle.H", what, "largest |H/H_d - 1|, second half [-]", None, error, 2e-3, found.settings)
    others = np.array([found.late(f"z_{i + 1}") for i in range(reference.ARM.n) if i != k])
    leak = float(np.abs(others).max() / np.sqrt(2.0 * level))
    yield Row("arm.limit_cycle.leak", what, "leak into other modes, second half [-]", None, leak, 1e-4, found.settings)


def _bang_bang(seconds: float) -> Iterator[Row]:
    arm = reference.damped_arm()
    direction = np.array(reference.DIRECTIONS[1])
    linear = reference.linear_modes(arm, np.array(reference.MOTORS))
    controller = bang_bang.reference_controller(arm, direction)
    found = live(
        NODES["bang_bang"],
        {"direction": direction.tolist()},
        {"posture": linear.rest.tolist(), "link_friction": arm.link_friction.tolist()},
        bang_bang.PUSH * controller.direction,
        seconds,
    )
    what = "bang-bang controller, mode 1"
    yield from _shares("arm.bang_bang", what, found)
    w = np.array([found.late(f"w_{i + 1}")[-1] for i in range(arm.n)])
    cosine = float(abs(w @ linear.directions[:, 0])) / float(np.linalg.norm(w))
    angle = float(np.degrees(np.arccos(min(1.0, cosine))))
    yield Row("arm.bang_bang.angle", what, "w_1 from the linear mode [deg]", None, angle, 3.0, found.settings)
    y = found.late("y")
    time: Array = np.arange(float(len(y))) * (REPORT_EVERY / RATE)
    cycles = Cycles(time, y)
    variation = relative_sd(cycles.periods)
    yield Row(
        "arm.bang_bang.period", what, "std / mean of the period, second half [-]", None, variation, 1e-3, found.settings
    )
    ratio = 1.0 / (float(cycles.periods.mean()) * float(linear.frequencies[0]))
    yield Row("arm.bang_bang.ratio", what, "f / f_lin, 1.03 to 1.15 [-]", None, ratio, 1.15, found.settings)


def _shares(at: str, what: str, found: Live) -> Iterator[Row]:
    late = f"late commands, {found.scheduling} scheduling [-]"
    yield Row(f"{at}.late_commands", what, late, None, found.late_commands, None, found.settings)
    yield Row(f"{at}.late_ticks", what, "late ticks [-]", None, found.late_ticks, None, found.settings)
    yield Row(f"{at}.limited", what, "samples at a limit [-]", None, found.limited, None, found.settings)
