"""Friction at a motor or at the link."""

from via_sim.catalogue.friction import (
    asymmetric_coulomb,
    asymmetric_viscous,
    coulomb_friction,
    load_dependent_friction,
    presliding_friction,
    quadratic_drag,
    stribeck_friction,
    viscous_friction,
)

KINDS = tuple(
    each.KIND
    for each in (
        coulomb_friction,
        asymmetric_coulomb,
        stribeck_friction,
        viscous_friction,
        asymmetric_viscous,
        quadratic_drag,
        presliding_friction,
        load_dependent_friction,
    )
)
