"""One executable per method: the estimator node with a fixed method, e.g.

ros2 run via_estimators modulated_torque --ros-args -p device:=cubic_demo

The entry points in setup.py are `<method> = via_estimators.nodes.single:<method>` for each of METHODS.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from via_ros.spin import run

from via_estimators.methods import METHODS
from via_estimators.nodes.estimator import EstimatorNode, single


def __getattr__(name: str) -> Callable[[], int]:
    if name not in METHODS:
        raise AttributeError(f"no method '{name}'; there are: {', '.join(METHODS)}")
    return partial(run, partial(EstimatorNode, single(name)))
