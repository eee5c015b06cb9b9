"""Numbers behind a report's charts: missing torque, its order spectrum, errors by region, traces of held-out intervals.

All of it is optional in a report. Numbers keep six digits.
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
    """The data of the picture of a joint."""

    arrangement: Literal["rigid", "flexible", "antagonistic", "serial"]
    drive: Literal["torque", "servo"]
    motors_seen: tuple[bool, ...]  # per motor: whether its angle was measured
    torque_seen: bool


class ResidualBin(Record):
    """Windows whose quantity lies in [low, high]: torque that acts on the axis and is missing in the model [N m].

    centre                 median of the quantity
    before, after          mean, of the device as filed and as repaired; against speed, positive along the motion
    before_rms, after_rms  root mean square of the same
    floor                  root mean square that sensor noise explains
    """

    low: Number
    high: Number
    centre: Number
    before: Number
    after: Number
    before_rms: NotNegative
    after_rms: NotNegative
    floor: NotNegative


class ResidualFigure(Record):
    """Torque missing in one equation against one quantity, before and after the repair."""

    equation: str  # link, motor 1, motor 2
    by: Quantity  # deflection: of the transmission between link and that motor, of the first for the link
    unit: str  # of the quantity
    bins: tuple[ResidualBin, ...]


class OrderSpectrum(Record):
    """Order spectrum of the missing torque: amplitude of its sinusoid over the angle of the axis, order by order.

    orders         (K,) periods per turn; the lowest has one period in the travelled angle
    before, after  (K,) [N m] amplitudes, of the device as filed and as repaired
    level          [N m] amplitude that sensor noise alone exceeds at 5 % of the orders
    turns          travelled angle
    """

    equation: str  # link, motor 1, motor 2
    orders: tuple[Number, ...]
    before: tuple[NotNegative, ...]
    after: tuple[NotNegative, ...]
    level: NotNegative
    turns: NotNegative


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
    """One signal over a held-out interval [rad]: measured, and simulated by the device as filed and as repaired.

    Signal tau [N m]: the drive's torque as commanded or measured, and as the motion requires it by the two models.

    worst     in which error this interval is the largest: before or after the repair
    time      (N,) [s] since the log began
    restarts  indices at which the simulation restarts from the measured state; none in a free run
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
    """A cause, or several together, fitted to convergence and evaluated on held-out data.

    left       squared held-out error, relative to that of the fitted device parameters without an effect
    behind     difference of its score to the best of all trials
    behind_sd  standard deviation of that difference, from resampled blocks
    """

    effects: tuple[Member, ...]
    left: Number
    behind: Number
    behind_sd: NotNegative


class Figures(Record):
    """The numbers behind the charts of one report.

    spectra     one per equation, where a periodic effect is named or compared
    trials      best score first
    screened    candidates that were dropped after a first fit
    untried     effects that this device cannot have or this log cannot show
    """

    joint: JointSketch
    residuals: tuple[ResidualFigure, ...] = ()
    spectra: tuple[OrderSpectrum, ...] = ()
    errors: tuple[ErrorFigure, ...] = ()
    traces: tuple[TraceFigure, ...] = ()
    trials: tuple[Trial, ...] = ()
    screened: tuple[Member, ...] = ()
    untried: tuple[str, ...] = ()
