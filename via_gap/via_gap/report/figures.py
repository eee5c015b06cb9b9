"""What a report's pictures show, as numbers: residuals and errors by region, traces of the worst held-out stretches.

All of it is optional in a report: the answer stands without. Numbers keep six digits.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from via_gap.candidates.localisation import Quantity
from via_gap.logs.findings import Number, Record

NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]


class Member(Record):
    """An effect at a site; `motor` numbers motors, transmissions and sensors, 0 the link's, both or none."""

    effect: str
    site: str
    motor: int = 0


class JointSketch(Record):
    """What a picture of the joint needs to know."""

    arrangement: Literal["rigid", "flexible", "antagonistic", "serial"]
    drive: Literal["torque", "servo"]
    motors_seen: tuple[bool, ...]  # per motor: whether its angle was measured
    torque_seen: bool


class ResidualBin(Record):
    """Windows whose quantity lies in [low, high]: torque that acts on the axis and is not in the model.

    centre median of the quantity
    mean   [N m]; against the speed it counts along the motion: what brakes is negative
    rms    [N m]
    floor  [N m] rms that the sensors explain
    """

    low: Number
    high: Number
    centre: Number
    mean: Number
    rms: NotNegative
    floor: NotNegative


class ResidualFigure(Record):
    """Residual of one equation of the device, its numbers tuned inside their tolerance, against one quantity."""

    equation: str  # link, motor 1, motor 2
    by: Quantity  # deflection: of the transmission between link and that motor, of the first for the link
    unit: str  # of the quantity
    bins: tuple[ResidualBin, ...]


class ErrorBin(Record):
    """Held-out samples whose quantity lies in [low, high], median `centre`: rms of simulated minus measured.

    [rad], of signal tau [N m].
    """

    low: Number
    high: Number
    centre: Number
    before: NotNegative
    after: NotNegative
    floor: NotNegative


class ErrorFigure(Record):
    """Error of one simulated signal, before and after the repair, against one quantity."""

    signal: str
    by: Quantity
    unit: str
    bins: tuple[ErrorBin, ...]


class TraceFigure(Record):
    """One signal over a held-out stretch [rad]: measured, and simulated by the device as filed and as repaired.

    Signal tau [N m]: the drive's torque as it was sent, and as the motion needs it by the two models.

    worst     what this stretch is the worst of: the error before, or what the repair leaves
    time      (N,) [s] since the log began
    restarts  indices at which the simulation starts anew from the measured state; none in a free run
    """

    log: str
    signal: str
    worst: Literal["before", "after"]
    time: tuple[Number, ...]
    measured: tuple[Number, ...]
    before: tuple[Number, ...]
    after: tuple[Number, ...]
    restarts: tuple[int, ...] = ()


class Trial(Record):
    """A cause, or several together, fitted to the end and judged on held-out data.

    left       of the squared held-out error, relative to the device's tuned numbers alone
    behind     of its score, how far behind the best of all trials
    behind_sd  standard deviation of that by resampled blocks
    """

    effects: tuple[Member, ...]
    left: Number
    behind: Number
    behind_sd: NotNegative


class Figures(Record):
    """The numbers behind the pictures of one report.

    trials      best score first
    screened    places where an effect was tried and did too little to be fitted to the end
    untried     effects of the catalogue that this device cannot have or this log cannot show
    """

    joint: JointSketch
    residuals: tuple[ResidualFigure, ...] = ()
    errors: tuple[ErrorFigure, ...] = ()
    traces: tuple[TraceFigure, ...] = ()
    trials: tuple[Trial, ...] = ()
    screened: tuple[Member, ...] = ()
    untried: tuple[str, ...] = ()
