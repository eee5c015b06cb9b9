"""Stiffness estimators of other schools, for comparison: the part of the registry `methods` that names them."""

from __future__ import annotations

from via_estimators.contract import Estimator
from via_estimators.extended_kalman import ExtendedKalman
from via_estimators.moving_horizon import MovingHorizon
from via_estimators.unknown_input_observer import UnknownInputObserver
from via_estimators.unscented_kalman import UnscentedKalman

PEERS: dict[str, type[Estimator]] = {
    "moving_horizon": MovingHorizon,
    "unknown_input_observer": UnknownInputObserver,
    "extended_kalman": ExtendedKalman,
    "unscented_kalman": UnscentedKalman,
}
