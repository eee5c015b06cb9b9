"""What the demo measured: the one definition behind summary.json, the terminal's tables and the page."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, computed_field
from via_core.metrics import WIDTH_95


class Record(BaseModel):
    """Frozen, and refusing fields it does not know."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Quantity(Record):
    """An estimate beside what it is held against."""

    value: float
    standard_deviation: float
    reference: float  # the commanded damping, or the stiffness of the device file's spring law

    @property
    def covered(self) -> bool:
        """Whether the 95 % interval holds the reference."""
        return abs(self.value - self.reference) <= WIDTH_95 * self.standard_deviation


class Traffic(Record):
    """Messages of one run: what was sent, and what arrived at its end."""

    samples: int  # joint states sent
    samples_recorded: int
    estimates_recorded: int  # the estimator answers every sample once
    numbers_missing: int  # gaps in the sequence numbers of what was recorded

    @computed_field  # type: ignore[prop-decorator]
    @property
    def lost(self) -> int:
        """Messages that should have been recorded and were not."""
        return 2 * self.samples - self.samples_recorded - self.estimates_recorded + self.numbers_missing


class RobotRun(Record):
    """One run of the real robot."""

    strategy: str
    trajectory: int
    repeat: int
    status: str
    damping: Quantity  # [N m s/rad]
    stiffness: Quantity  # [N m/rad]
    nrmse: float  # [-] simulated against real joint angle, of the angle's standard deviation
    traffic: Traffic
    bag: str


class RefusedRecording(Record):
    """A recording that was not used, and why."""

    file: str
    reasons: list[str]


class RobotPart(Record):
    """Parts 1 to 3: import, replay, gap."""

    source: str
    accepted: int
    refused: list[RefusedRecording]
    warnings: int
    runs: list[RobotRun]
    nrmse: float  # pooled over runs: all squared errors over all squared deviations
    nrmse_by_strategy: dict[str, float]
    damping_coverage: float  # share of runs whose 95 % interval holds the commanded damping
    lost: int


class LivePart(Record):
    """Part 4: the simulated joint in closed loop."""

    device: str
    samples: int
    rate: float  # [Hz]
    duration: float  # [s] of stamps
    late_ticks: int
    traffic: Traffic
    replay: Traffic
    bit_identical: bool
    stiffness_error: float  # median |estimate - truth| / truth after warm-up [-]
    stiffness_coverage: float  # share of samples whose 95 % interval holds the truth
    bag: str


class DiagnosisPart(Record):
    """Part 5: why the published model differs from the robot's recordings."""

    verdict: str
    headline: str
    named: list[str]
    runs: int
    before: float | None  # gap on stretches held out [-]; None where it was not measured
    after: float | None
    page: str


class Summary(Record):
    """summary.json."""

    version: str
    commit: str
    python: str
    seconds: dict[str, float]
    robot: RobotPart
    live: LivePart
    diagnosis: DiagnosisPart
