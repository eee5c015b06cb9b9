"""The loop of this project's nodes, by their roles."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from rclpy.parameter import Parameter
from via_controllers.nodes.single import NODES
from via_estimators.nodes.estimator import BANK, EstimatorNode
from via_sim.nodes.simulator import SimulatorNode

from via_validation.bench.realtime.loop import DEVICE, LISTENERS, METHODS, RATE, Part, simulated


def _given(**values: Any) -> dict[str, Any]:
    return {"parameter_overrides": [Parameter(name, value=value) for name, value in values.items()]}


def simulator(seconds: float) -> Part:
    """The simulator, which ends after `seconds` of its samples."""
    node = SimulatorNode(**_given(device=DEVICE, rate=RATE, duration=seconds, listeners=LISTENERS))

    def counts() -> dict[str, float]:
        return simulated(node.ticks + 1, node.late_ticks / max(node.ticks, 1), node.round_trips)

    return Part(node, counts, node.finished, lambda: node.ticks > 0)


def estimator(number: int) -> Part:
    """The estimator node with one method."""
    kind = replace(BANK, name=f"estimator_{number}")
    node = EstimatorNode(kind, **_given(device=DEVICE, methods=[METHODS[number]]))
    (channel,) = node.pipelines[0].channels
    return Part(node, lambda: {"samples": channel.sequence})


def controller() -> Part:
    """The controller node."""
    node = NODES["excitation"](**_given(device=DEVICE))
    return Part(node, lambda: {"samples": node.answered})
