"""Effects between command and torque."""

from via_sim.catalogue.drive import (
    actuator_delay,
    actuator_lag,
    dead_zone,
    integral_action,
    position_deadband,
    position_gain,
    speed_limit,
    torque_bias,
    torque_deadband,
    torque_gain,
    torque_ripple,
    torque_saturation,
    velocity_feedforward,
)

KINDS = tuple(
    each.KIND
    for each in (
        torque_gain,
        position_gain,
        integral_action,
        velocity_feedforward,
        torque_bias,
        torque_ripple,
        torque_saturation,
        torque_deadband,
        dead_zone,
        actuator_lag,
        actuator_delay,
        speed_limit,
        position_deadband,
    )
)
