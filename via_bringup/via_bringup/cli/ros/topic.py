"""`via topic`: list, info, echo, hz and pub. Subscriptions take the QoS of the publishers, as `via bag record` does."""

from __future__ import annotations

import os
import sys
import time
from collections import deque
from typing import Annotated, Any

import numpy as np
import typer
from rclpy.qos import DurabilityPolicy
from via_core.errors import ViaError
from via_ros import qos
from via_ros.interfaces import message_class

from via_bringup.cli.console import answers
from via_bringup.cli.ros.session import Session, absolute, session
from via_bringup.cli.ros.values import LONGEST, filled, member, shown

Topic = Annotated[str, typer.Argument(help="Topic, e.g. /joint_states.")]
Values = Annotated[str, typer.Argument(help="Values of the members as YAML, e.g. '{equilibrium: 0.2}'.")]
TypeName = Annotated[str, typer.Argument(help="Type of the messages; default: that of the publishers.")]


def list_topics(
    types: Annotated[bool, typer.Option("--show-types", "-t", help="Also show the types.")] = False,
) -> None:
    """List the topics."""
    with session() as now:
        now.discover()
        for name, kinds in sorted(now.topics().items()):
            answers.print(f"{name} [{', '.join(kinds)}]" if types else name)


def info(topic: Topic) -> None:
    """Show type, publishers and subscribers of a topic, with their QoS."""
    with session() as now:
        name = absolute(topic)
        if not now.discover(lambda: name in now.topics()):
            raise ViaError(f"no topic {name}; there are: {', '.join(sorted(now.topics())) or 'none'}")
        now.discover()  # its other ends
        answers.print(f"type: {', '.join(now.topics()[name])}")
        for role, found in (
            ("publishers", now.node.get_publishers_info_by_topic(name)),
            ("subscribers", now.node.get_subscriptions_info_by_topic(name)),
        ):
            answers.print(f"{role}: {len(found)}")
            for each in found:
                offered = qos.as_offered(each.qos_profile)
                node = f"{each.node_namespace.rstrip('/')}/{each.node_name}"
                answers.print(f"  {node}: {offered.reliability}, {offered.durability}")


def echo(
    topic: Topic,
    type_name: TypeName = "",
    once: Annotated[bool, typer.Option("--once", help="End after the first message.")] = False,
    field: Annotated[str, typer.Option(help="Print this member only, e.g. header.stamp or position.0.")] = "",
    full: Annotated[bool, typer.Option("--full-length", "-f", help="Print long lists whole.")] = False,
) -> None:
    """Print the messages of a topic as YAML until interrupted."""
    with session() as now:
        done: list[bool] = []
        closed: list[bool] = []

        def take(message: Any) -> None:
            if done and once:
                return
            part = member(message, field) if field else message
            try:
                print(shown(part, None if full else LONGEST), end="---\n", flush=True)
            except BrokenPipeError:  # the reader has enough: `via topic echo .. | head`
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
                closed.append(True)
            done.append(True)

        _subscribe(now, topic, type_name, take)
        now.wait(lambda: bool(closed) or (once and bool(done)))


def hz(
    topic: Topic,
    window: Annotated[int, typer.Option("--window", "-w", min=2, help="Number of messages that are averaged.")] = 10000,
) -> None:
    """Print the rate of a topic and the intervals between its messages every second, until interrupted."""
    with session() as now:
        arrivals: deque[float] = deque(maxlen=window)
        _subscribe(now, topic, "", lambda _: arrivals.append(time.monotonic()), raw=True)
        now.until(lambda: len(arrivals) > 0, f"the first message of {absolute(topic)}")
        while True:
            before, until = len(arrivals) and arrivals[-1], time.monotonic() + 1.0
            now.wait(lambda: time.monotonic() >= until)  # noqa: B023
            gaps = np.diff(arrivals)
            if not len(gaps) or arrivals[-1] == before:
                answers.print("no new message")
                continue
            answers.print(
                f"{1.0 / gaps.mean():.3f} Hz; interval from {1e3 * gaps.min():.3f} to {1e3 * gaps.max():.3f} ms, "
                f"standard deviation {1e3 * gaps.std():.3f} ms, {len(arrivals)} messages"
            )


def pub(
    topic: Topic,
    type_name: Annotated[str, typer.Argument(help="Type, e.g. via_interfaces/msg/JointReference.")],
    values: Values = "{}",
    once: Annotated[bool, typer.Option("--once", "-1", help="Publish one message and end.")] = False,
    times: Annotated[int, typer.Option("--times", "-t", min=0, help="Messages to publish; 0: until interrupted.")] = 0,
    rate: Annotated[float, typer.Option("--rate", "-r", min=1e-3, max=1e3, help="Messages per second \\[Hz].")] = 1.0,
) -> None:
    """Publish a message, once it has a subscriber; until interrupted, unless --once or --times is given."""
    kind, name, count = message_class(type_name), absolute(topic), 1 if once else times
    message = filled(kind(), values)
    with session() as now:
        now.until(lambda: now.node.count_subscribers(name) > 0, f"a subscriber of {name}")
        wanted = [each.qos_profile for each in now.node.get_subscriptions_info_by_topic(name)]
        latched = any(each.durability == DurabilityPolicy.TRANSIENT_LOCAL for each in wanted)
        profile = qos.matching([])
        profile.durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        publisher = now.node.create_publisher(kind, name, profile)
        now.until(lambda: publisher.get_subscription_count() > 0, f"a subscriber of {name} with this type")
        published = 0
        while count == 0 or published < count:
            publisher.publish(filled(kind(), values) if "now" in values else message)
            published += 1
            print(f"published {published}: {values}", file=sys.stderr)
            until = time.monotonic() + 1.0 / rate
            if count == 0 or published < count:
                now.wait(lambda: time.monotonic() >= until)  # noqa: B023
        publisher.wait_for_all_acked()


def _subscribe(now: Session, topic: str, type_name: str, take: Any, raw: bool = False) -> None:
    """Subscribe with a QoS that suits all publishers there are."""
    name = absolute(topic)
    kind = message_class(type_name or now.type_of(name))
    now.discover(lambda: now.node.count_publishers(name) > 0)
    offers = [each.qos_profile for each in now.node.get_publishers_info_by_topic(name)]
    now.node.create_subscription(kind, name, take, qos.matching(offers), raw=raw)
