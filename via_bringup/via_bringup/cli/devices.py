"""`via devices`: the shipped device files and how far to trust them."""

from __future__ import annotations

from via_core.devices import device_names, load_device

from via_bringup.cli.console import answers, table


def devices() -> None:
    """List the shipped devices."""
    listing = table("Devices", "name", "arrangement", "drive", "confidence", "what it is")
    listing.columns[4].justify = "left"
    for name in device_names():
        device = load_device(name)
        listing.add_row(name, device.arrangement, device.drive, device.confidence, device.title)
    answers.print(listing)
