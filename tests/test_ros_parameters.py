"""Parameters: declared from the dataclass, read back, and refused with a line that contains the value."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial

import pytest
from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from via_core.errors import ParameterError
from via_ros.parameters import declare


@dataclass(frozen=True)
class Example:
    rate: float = field(default=1.0, metadata={"description": "speed", "unit": "Hz", "range": (0.0, 10.0)})
    count: int = field(default=3, metadata={"description": "how many", "range": (1, float("inf"))})
    mode: str = field(default="free", metadata={"description": "how time runs", "choices": ("free", "lockstep")})
    quiet: bool = field(default=False, metadata={"description": "say nothing"})
    names: tuple[str, ...] = field(default=(), metadata={"description": "joints"})
    gains: tuple[float, ...] = field(default=(1.0, 2.0), metadata={"description": "gains", "unit": "-"})

    def __post_init__(self):
        if self.rate == 7.0:
            raise ParameterError(f"Example.rate must not be {self.rate}")


class Holder(Node):
    """A node that declares `Example` under a prefix."""

    def __init__(self, prefix, **options):
        super().__init__("example", **options)
        self.built = declare(self, Example, prefix)


@pytest.fixture
def declared(graph):
    def build(prefix="", **values):
        named = {f"{prefix}.{key}" if prefix else key: value for key, value in values.items()}
        node = graph.add(partial(Holder, prefix), **named)
        return node, node.built

    return build


def test_defaults_come_back_as_they_are(declared):
    assert declared()[1] == Example()


def test_given_values_arrive_with_their_types(declared):
    given = Example(2.5, 9, "lockstep", True, ("a", "b"), (3.0,))
    _, built = declared(rate=2.5, count=9, mode="lockstep", quiet=True, names=["a", "b"], gains=[3.0])
    assert built == given
    assert [type(value) for value in vars(built).values()] == [type(value) for value in vars(given).values()]


def test_an_integer_is_accepted_for_a_float(declared):
    built = declared(rate=2)[1]
    assert built.rate == 2.0
    assert isinstance(built.rate, float)


def test_prefix_is_prepended_to_every_name(declared):
    node, built = declared(prefix="inner", rate=4.0)
    assert built.rate == 4.0
    assert node.has_parameter("inner.rate")
    assert not node.has_parameter("rate")


def test_description_unit_and_range_are_published(declared):
    node, _ = declared()
    about = node.describe_parameter("rate")
    assert (about.description, about.read_only) == ("speed [Hz]", True)
    assert (about.floating_point_range[0].from_value, about.floating_point_range[0].to_value) == (0.0, 10.0)
    assert node.describe_parameter("count").integer_range[0].from_value == 1
    assert "lockstep" in node.describe_parameter("mode").additional_constraints


def test_parameters_cannot_be_changed_at_run_time(declared):
    node, built = declared()
    assert not node.set_parameters([Parameter("rate", value=2.0)])[0].successful
    assert built.rate == node.get_parameter("rate").value == 1.0


@dataclass(frozen=True)
class Tuned:
    gain: float = field(default=1.0, metadata={"description": "gain", "range": (0.0, 10.0), "live": True})
    limit: float = field(default=2.0, metadata={"description": "limit", "live": True})


def live(node):
    """Declare live parameters; returns a list of those in effect."""
    effective = []

    def changed(parameters):
        if parameters.gain > parameters.limit:
            raise ParameterError("gain exceeds limit")
        return partial(effective.append, parameters)

    effective.append(declare(node, Tuned, changed=changed))
    return effective


def values_of(**values):
    return [Parameter(name, value=value) for name, value in values.items()]


def test_live_parameters_of_one_request_take_effect_together(graph):
    node = graph.node("tuned")
    effective = live(node)
    assert node.set_parameters_atomically(values_of(gain=5.0, limit=6)).successful
    assert effective[1:] == [Tuned(5.0, 6.0)]
    refused = node.set_parameters_atomically(values_of(gain=3.0, limit=2.0))
    assert (refused.successful, refused.reason) == (False, "gain exceeds limit")
    assert node.set_parameters(values_of(gain=4.0))[0].successful
    assert effective[1:] == [Tuned(5.0, 6.0), Tuned(4.0, 6.0)]


@pytest.mark.parametrize("before", [True, False])
def test_a_request_that_another_part_of_the_node_refuses_changes_nothing(graph, before):
    """A user's node derived from ours has callbacks of its own, which ROS calls before or after."""

    def refuse_four(given):
        return SetParametersResult(successful=all(each.value != 4.0 for each in given))

    node = graph.node("tuned")
    if before:
        node.add_on_set_parameters_callback(refuse_four)
    effective = live(node)
    if not before:
        node.add_on_set_parameters_callback(refuse_four)
    assert not node.set_parameters_atomically(values_of(gain=1.5, limit=4.0)).successful
    assert node.get_parameter("gain").value == 1.0 and len(effective) == 1
    assert node.set_parameters(values_of(limit=3.0))[0].successful
    assert effective[1:] == [Tuned(1.0, 3.0)]


@pytest.mark.parametrize(
    ("values", "complaint"),
    [
        ({"rate": 11.0}, "rate.*0, 10.*Hz"),
        ({"rate": 11}, "rate.*0, 10.*Hz.*11"),
        ({"rate": float("nan")}, "rate"),
        ({"count": 0}, "count"),
        ({"count": 2.5}, "count.*int.*2.5"),
        ({"mode": "slow"}, "mode.*free, lockstep.*slow"),
        ({"quiet": 1}, "quiet.*bool"),
        ({"names": "a"}, "names.*list"),
        ({"rate": 7.0}, "rate must not be 7.0"),
    ],
)
def test_impossible_values_are_named(declared, values, complaint):
    with pytest.raises(ParameterError, match=complaint):
        declared(**values)
