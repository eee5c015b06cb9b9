"""A series elastic joint with a linear spring, for tests of planted motions."""

from via_core.devices import Device


def elastic(link: float, motor: dict[str, float], spring: dict[str, float], **sensors: float) -> Device:
    """The device; link inertia [kg m^2], sensors at 1 kHz."""
    return Device(
        name="stiff",
        title="A stiff joint",
        source=("assumed",),
        confidence="assumed",
        arrangement="flexible",
        link={"inertia": link, "viscous_friction": 0.1},
        motors=[motor],
        springs=[{"law": "linear", **spring}],
        sensors={"rate": 1000.0, **sensors},
    )
