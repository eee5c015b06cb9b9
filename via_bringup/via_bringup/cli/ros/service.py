"""`via service list|call`, `via action send` and `via node list`."""

from __future__ import annotations

from typing import Annotated

import typer
from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.task import Future
from via_core.errors import ViaError
from via_ros.interfaces import interface_class

from via_bringup.cli.console import answers, errors
from via_bringup.cli.ros.session import Session, absolute, session
from via_bringup.cli.ros.values import filled, shown

CANCELLING = 0.5  # [s] until a goal is cancelled


def list_services(
    types: Annotated[bool, typer.Option("--show-types", "-t", help="Also show the types.")] = False,
) -> None:
    """List the services."""
    with session() as now:
        now.discover()
        for name, kinds in sorted(now.node.get_service_names_and_types()):
            if "/_" not in name:
                answers.print(f"{name} [{', '.join(kinds)}]" if types else name)


def call(
    service: Annotated[str, typer.Argument(help="Service, e.g. /arm_simulator/push.")],
    type_name: Annotated[str, typer.Argument(help="Type, e.g. via_interfaces/srv/Push.")],
    values: Annotated[str, typer.Argument(help="Values of the request as YAML.")] = "{}",
) -> None:
    """Call a service and print its response as YAML."""
    kind = interface_class(type_name, "srv", "service")
    request = filled(kind.Request(), values)
    with session() as now:
        print(shown(now.call(kind, absolute(service), request)), end="")


def send(
    action: Annotated[str, typer.Argument(help="Action, e.g. /gap_monitor/diagnose.")],
    type_name: Annotated[str, typer.Argument(help="Type, e.g. via_interfaces/action/DiagnoseGap.")],
    values: Annotated[str, typer.Argument(help="Values of the goal as YAML.")] = "{}",
    feedback: Annotated[bool, typer.Option("--feedback", "-f", help="Print the feedback too.")] = False,
) -> None:
    """Send a goal to an action and print its result as YAML. Ctrl-C cancels the goal."""
    kind = interface_class(type_name, "action", "action")
    goal = filled(kind.Goal(), values)
    with session() as now:
        client = ActionClient(now.node, kind, absolute(action))
        now.until(client.server_is_ready, f"action {absolute(action)}")
        hear = (lambda each: print(shown(each.feedback), "---", sep="", flush=True)) if feedback else None
        now.introduced(f"{absolute(action)}/_action/send_goal")
        sent = client.send_goal_async(goal, feedback_callback=hear)
        try:
            handle = now.result(sent)
            if not handle.accepted:
                raise ViaError(f"{absolute(action)} refused the goal")
            outcome = now.result(handle.get_result_async())
        except KeyboardInterrupt:
            _cancel(now, sent)
            raise
    print(shown(outcome.result), end="")
    if outcome.status != GoalStatus.STATUS_SUCCEEDED:
        ended = {GoalStatus.STATUS_ABORTED: "aborted", GoalStatus.STATUS_CANCELED: "cancelled"}
        raise ViaError(f"the goal was {ended.get(outcome.status, 'not reached')}")


def _cancel(now: Session, sent: Future) -> None:
    """Cancel a goal that was sent; prints a line if the cancellation is not confirmed."""
    if now.wait(sent.done, CANCELLING) and not sent.result().accepted:
        return
    if not (sent.done() and now.wait(sent.result().cancel_goal_async().done, CANCELLING)):
        errors.print("the goal may still run: its cancellation was not confirmed")


def list_nodes() -> None:
    """List the nodes."""
    with session() as now:
        now.discover()
        for name in sorted(now.nodes()):
            answers.print(name)
