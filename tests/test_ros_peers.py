"""The names of all drivers are asked for only where there can be several."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from via_ros.peers import DriverOrigin


class AskedError(Exception):
    pass


@pytest.mark.parametrize(("publishers", "subscribers"), [(1, 2), (2, 1), (0, 0)])
def test_one_publisher_of_samples_or_one_subscriber_of_commands_is_one_driver(publishers, subscribers):
    def ask(_):
        raise AskedError

    node = SimpleNamespace(
        count_publishers=lambda _: publishers, count_subscribers=lambda _: subscribers,
        get_publishers_info_by_topic=ask, get_subscriptions_info_by_topic=ask,
    )  # fmt: skip
    origin = DriverOrigin(node, "/joint_states", "/joint/command", ["joint"])
    origin.look()
    assert origin.is_alone()
    node.count_publishers = node.count_subscribers = lambda _: 2
    with pytest.raises(AskedError):
        origin.look()
