"""Number 6 of the specification over DDS in lockstep: arm and controller as nodes, every wall with every hold.

Like `control.hitting`, except that the links are set to the held posture at once, without an approach.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState
from via_bringup.demo.reference import DIRECTIONS, HITTING_MODE, MOTORS, damped_arm, wall_scene
from via_controllers.nodes.single import NODES
from via_core.errors import ViaError
from via_core.signals import Array
from via_interfaces.srv import Hold, Push
from via_ros import qos
from via_ros.composition import Composition
from via_sim.nodes.arm_simulator import ArmSimulatorNode

from via_validation.control.hitting import HELD, HOLDS, WALLS, Impacts, impacts
from via_validation.tables.rows import Progress, Row
from via_validation.tables.section6_bang_bang import hitting_rows

RATE = 1000.0  # [Hz]
DURATION = 10.0  # [s] after the release
PATIENCE = 30.0  # [s] of wall time, and as much per simulated second
SETTINGS = "reference_4dof, nodes bang_bang and arm_simulator over DDS in lockstep, 1 kHz"


def hitting_rows_over_dds(progress: Progress) -> list[Row]:
    """Rows of all nine cases."""
    rows, cases = [], [(wall, hold) for wall in WALLS for hold in HOLDS]
    for done, (wall, hold) in enumerate(cases):
        progress(done, len(cases), f"wall {wall:g}, hold {hold:g}")
        rows += hitting_rows("hitting", hitting_over_dds(wall, hold), SETTINGS)
    return rows


def hitting_over_dds(wall: float, hold: float, duration: float = DURATION) -> Impacts:
    """One case, for `duration` [s] after the release; wall and hold as fractions of the free turning point."""
    arm, scene = damped_arm(), wall_scene(wall, hold)
    links: list[Array] = []
    forces: list[tuple[float, float, float]] = []
    with Composition() as graph:
        graph.add(NODES["bang_bang"], motors=list(MOTORS), direction=list(DIRECTIONS[HITTING_MODE]), told_every=1000)
        body = graph.add(
            ArmSimulatorNode, mode="lockstep", rate=RATE, duration=HELD + duration + 0.1, listeners=2,
            posture=scene.rest.tolist(), walls=[*scene.face.tolist(), *(-scene.along).tolist()],
            link_friction=arm.link_friction.tolist(),
        )  # fmt: skip

        def receive_state(message: JointState) -> None:
            links.append(np.array(message.position)[0::2])

        def receive_force(message: WrenchStamped) -> None:
            force = message.wrench.force
            forces.append((force.x, force.y, force.z))

        body.create_subscription(JointState, "/joint_states", receive_state, qos.SAMPLES)
        body.create_subscription(WrenchStamped, f"/{arm.name}/contact", receive_force, qos.SAMPLES)
        _call(graph, body, Push, "push", Push.Request(deflection=(scene.start - scene.rest).tolist()))
        answer = _call(graph, body, Hold, "hold", Hold.Request(duration=HELD))
        released = int(answer.split()[-1])

        def complete() -> bool:
            return body.finished.done() and min(len(links), len(forces)) > body.ticks

        graph.run_until(complete, PATIENCE * (1.0 + duration), "the end of a case")
    motion = links[released:]
    tip = np.array([arm.tip_position(q) for q in motion])
    time: Array = np.arange(float(len(motion))) / RATE
    return Impacts(wall, hold, *impacts(scene, time, tip, np.array(forces[released:])))


def _call(graph: Composition, node: Any, kind: Any, name: str, request: Any) -> str:
    """The answer of a service of the simulator. Raises ViaError if it refuses."""
    client = node.create_client(kind, f"/arm_simulator/{name}")
    graph.run_until(client.service_is_ready, PATIENCE, f"a service {name}")
    answer = client.call_async(request)
    graph.run_until(answer.done, PATIENCE, f"an answer of {name}")
    if not answer.result().success:
        raise ViaError(answer.result().message)
    return str(answer.result().message)
