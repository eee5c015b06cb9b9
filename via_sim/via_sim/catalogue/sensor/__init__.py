"""Errors of encoders and of their stamps."""

from via_sim.catalogue.sensor import (
    channel_skew,
    encoder_eccentricity,
    encoder_offset,
    encoder_quantisation,
)

KINDS = tuple(
    each.KIND
    for each in (
        encoder_offset,
        encoder_eccentricity,
        encoder_quantisation,
        channel_skew,
    )
)
