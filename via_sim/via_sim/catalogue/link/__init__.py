"""Effects on the link and from its environment."""

from via_sim.catalogue.link import (
    contact,
    external_torque,
    gravity_error,
    link_inertia,
    link_spring,
    payload,
)

KINDS = tuple(
    each.KIND
    for each in (
        payload,
        link_inertia,
        gravity_error,
        link_spring,
        contact,
        external_torque,
    )
)
