"""Data model of the demo's results, used by summary.json, the terminal output and the page."""

from __future__ import annotations

from collections.abc import Callable

from pydantic import computed_field
from via_core.metrics import WIDTH_95
from via_core.records import Record

Progress = Callable[[float, float, str], None]  # of a part: done, total, step


class Quantity(Record):
    """An estimate and its reference."""

    value: float
    standard_deviation: float
    reference: float  # commanded damping, or stiffness of the spring law in the device file

    @property
    def covered(self) -> bool:
        """Whether the 95 % interval contains the reference."""
        return abs(self.value - self.reference) <= WIDTH_95 * self.standard_deviation


class Traffic(Record):
    """Numbers of sent and recorded messages of one run."""

    samples: int  # joint states sent
    samples_recorded: int
    estimates_recorded: int  # one estimate per sample
    numbers_missing: int  # gaps in the recorded sequence numbers

    @computed_field  # type: ignore[prop-decorator]
    @property
    def lost(self) -> int:
        """Number of messages that should have been recorded but were not."""
        return 2 * self.samples - self.samples_recorded - self.estimates_recorded + self.numbers_missing


class RobotRun(Record):
    """One run of the real robot."""

    strategy: str
    trajectory: int
    repeat: int
    status: str
    damping: Quantity  # [N m s/rad]
    stiffness: Quantity  # [N m/rad]
    nrmse: float  # [-] RMS error of the simulated angle / standard deviation of the real angle
    traffic: Traffic
    bag: str


class RefusedRecording(Record):
    """A recording that was not used, with the reasons."""

    file: str
    reasons: list[str]


class RobotPart(Record):
    """Parts 1 to 3: import, replay and gap."""

    source: str
    accepted: int
    refused: list[RefusedRecording]
    warnings: int
    runs: list[RobotRun]
    nrmse: float  # pooled: sqrt of the summed squared errors / summed squares about the means
    nrmse_by_strategy: dict[str, float]
    damping_coverage: float  # share of runs whose 95 % interval contains the commanded damping
    lost: int


class LivePart(Record):
    """Part 4: the simulated joint in closed loop."""

    device: str
    samples: int
    rate: float  # [Hz]
    duration: float  # [s] between first and last stamp
    late_ticks: int
    traffic: Traffic
    replay: Traffic
    bit_identical: bool
    ok: float  # share of estimates with status OK [-]; a busy computer delays commands, and then the joint hardly moves
    stiffness_error: float | None  # median |estimate - truth| / truth of these [-]; None if there are none
    stiffness_coverage: float | None  # share of these whose 95 % interval contains the truth; None if there are none
    bag: str


class DiagnosisPart(Record):
    """Part 5: why the published model differs from the robot's recordings."""

    verdict: str
    headline: str
    cautions: str  # reservations that belong to it
    next: str  # what to do now; '' if nothing
    named: list[str]
    runs: int
    before: float | None  # gap on held-out data [-]; None if not evaluated
    tuned: float | None  # with the numbers of the model fitted
    after: float | None  # with the named effects as well
    page: str


class Summary(Record):
    """Content of summary.json."""

    version: str
    commit: str
    python: str
    seconds: dict[str, float]
    robot: RobotPart
    live: LivePart
    diagnosis: DiagnosisPart
