"""Effects between motor and link."""

from via_sim.catalogue.transmission import (
    backlash,
    gear_error,
    hysteresis,
    joint_coupling,
    preset_error,
    spring_damping,
    spring_law,
    stiffness_drift,
)

KINDS = tuple(
    each.KIND
    for each in (
        backlash,
        hysteresis,
        spring_damping,
        spring_law,
        stiffness_drift,
        preset_error,
        gear_error,
        joint_coupling,
    )
)
