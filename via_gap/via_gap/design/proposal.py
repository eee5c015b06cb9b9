"""The short motion that would separate the causes which a log cannot: predicted, not guessed.

Each of the tied causes is taken for the truth in turn and simulated on every motion of a small family; the others are
fitted to what the sensors would show then, their own numbers and the device's together, each as free as the log left
it. What they cannot imitate is the disagreement. The motion chosen is the one in which the pair that is hardest to tell
apart differs most, by the same score that a diagnosis of the new log will use.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from math import ceil, inf

import numpy as np
from via_core.devices import Device, TorqueMotor
from via_core.errors import ParameterError
from via_core.signals import Array, Signals
from via_sim.catalogue import EFFECTS
from via_sim.effects import Effect
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import Simulator, simulate

from via_gap.candidates.fit import make
from via_gap.candidates.location import Location
from via_gap.design.motions import DURATION, MOTIONS, REST, Motion
from via_gap.logs.log import JointLog
from via_gap.report.report import Cause, GapReport, Proposal
from via_gap.report.report import Place as Named
from via_gap.residual.nuisance import BOUND, descend, nuisances
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import cut_log

RATE = 1000.0  # [Hz] at least, of the commands
RANGE = 0.6  # [rad] largest motor angle from the place of rest
SWING = 1.4  # times RANGE: how far the link may follow
SMALLER = (1.0, 0.5, 0.25)  # of RANGE, tried until no limit is passed
DEFLECTED = 0.8  # of the largest deflection
BANDWIDTH = 12.0  # [rad/s] of the loop that makes torques from references
MOST = 4  # causes that are compared
LIKELY = 0.02  # probability from which a cause counts where the verdict is cannot_tell
FREE = 5.0  # times a fitted number's standard deviation: how freely the other cause may imitate
WIDE = 0.2  # of a number's value, at least
STEP = 0.05
ROUNDS = 3
ENOUGH = 0.03  # difference of scores from which a diagnosis tells causes apart


@dataclass(frozen=True, eq=False)
class Proposed:
    """A motion, its commands, and what it is expected to show.

    commands      held: motor (N, m) [N m]; of servos equilibrium, preset [rad], damping [-]; rigid: external_torque
    disagreement  [-] root mean square of what the hardest pair's predictions differ by, in units of the noise
    score         difference of held-out scores of the hardest pair; below ENOUGH nothing is gained
    pair          the causes that are hardest to tell apart
    """

    motion: Motion
    size: float  # [rad] largest motor angle
    commands: Signals
    separates: tuple[Location, ...]
    pair: tuple[Location, Location]
    disagreement: float
    score: float

    @property
    def text(self) -> str:
        """One sentence for people."""
        first, second = (str(location).replace("_", " ") for location in self.pair)
        needs = "the log must hold the link angle, every motor angle and the commands, from rest to rest"
        if self.score < ENOUGH:
            return (
                f"no motion within the device's limits tells {first} from {second}: the best, {self.motion.name}, "
                f"shows {self.disagreement:.2g} standard deviations of the sensors; a hold with the torque measured at "
                f"the joint, or a known load, could"
            )
        return (
            f"run '{self.motion.name}' ({self.motion.shows}) for {DURATION:g} s, up to {self.size:.2g} rad: there "
            f"{first} and {second} differ by {self.disagreement:.2g} standard deviations of the sensors, whatever the "
            f"one does to look like the other; {needs}"
        )

    def summary(self, joint: str, file: str = "") -> Proposal:
        """For the report."""
        return Proposal(
            separates=tuple(
                Named(effect=p.name, site=p.site, joint=joint, motor=p.motor)  # type: ignore[arg-type]
                for p in self.separates
            ),
            expected_disagreement=self.disagreement, duration=DURATION, file=file,
            motion=self.motion.name, text=self.text, separable=self.score >= ENOUGH,
        )  # fmt: skip


def tied(report: GapReport) -> tuple[Cause, ...]:
    """The causes that a log left undecided, likeliest first; fewer than two where there is nothing to decide.

    Several effects together are no question for one motion: only single causes are compared.
    """
    if report.verdict in ("effect", "main_effect") and len(report.effects) == 1:
        names = {(p.effect, p.site, p.motor) for p in report.equivalence_set}
        return tuple(c for c in report.causes if (c.effect, c.site, c.motor) in names)[:MOST]
    if report.verdict == "cannot_tell":
        return tuple(c for c in report.causes if c.probability >= LIKELY)[:MOST]
    return ()


def with_proposal(report: GapReport, device: Device) -> GapReport:
    """The report with a proposal where it leaves something to decide and a motion keeps within the limits."""
    try:
        found = propose(report, device)
    except ParameterError:
        return report
    return report if found is None else report.model_copy(update={"proposal": found.summary(device.name)})


def propose(report: GapReport, device: Device, reach: float = RANGE) -> Proposed | None:
    """The motion that tells the causes of `report` apart best; None where the report leaves nothing to decide.

    reach  [rad] largest motor angle from the place of rest

    Raises ParameterError where the report is of another device or no motion keeps within its limits.
    """
    plant = JointPlant.from_device(device)
    told = {value.name: value.deviations for value in report.nuisance}
    if told.keys() != {nuisance.name for nuisance in nuisances(plant)}:
        raise ParameterError(f"the report's numbers are not those of '{device.name}'")
    causes = [_Known.of(cause) for cause in tied(report)]
    if len(causes) < 2:
        return None
    deviations = np.array([told[nuisance.name] for nuisance in nuisances(plant)])
    best: Proposed | None = None
    for motion in MOTIONS:
        for share in SMALLER:
            made = _tried(device, plant, causes, deviations, motion, share * reach)
            if made is not None:
                if best is None or made.score > best.score:
                    best = made
                break
    if best is None:
        raise ParameterError(f"no motion of the family keeps '{device.name}' within its limits under every cause")
    return best


@dataclass(frozen=True, eq=False)
class _Known:
    """A cause with its values (p,) and how freely they may move (p,)."""

    location: Location
    values: Array
    free: Array

    @staticmethod
    def of(cause: Cause) -> _Known:
        names = [p.name for p in EFFECTS[cause.effect].parameters]
        values = np.array([cause.parameters[name].value for name in names])
        spread = np.array([cause.parameters[name].sd for name in names])
        free = np.maximum(FREE * spread, WIDE * np.abs(values))
        return _Known(Location(cause.effect, cause.site, cause.motor), values, np.maximum(free, 1e-9))

    def effect(self) -> Effect:
        made = make(self.location, list(self.values))
        if made is None:
            raise ParameterError(f"{self.location}: the report's values make no such effect")
        return made


def _tried(
    device: Device, plant: JointPlant, causes: Sequence[_Known], deviations: Array, motion: Motion, size: float
) -> Proposed | None:
    """The motion of this size, if it keeps within limits whichever cause is true."""
    blank = ResidualModel((), plant, nuisances(plant))
    plants = [JointPlant(device, blank.row([cause.effect()], deviations), (cause.effect(),)) for cause in causes]
    commands, start = commands_of(plants[0], motion, size)
    logs = [recorded(each, commands, start, seed) for seed, each in enumerate(plants)]
    if not all(log is not None and _allowed(log, size) for log in logs):
        return None
    hardest, pair, apart = inf, (causes[0].location, causes[1].location), 0.0
    scores: dict[int, tuple[ResidualModel, Array]] = {}
    for true, log in enumerate(logs):
        assert log is not None
        segments = cut_log(log)
        problem = ResidualModel.of([segments], [np.flatnonzero(segments.valid)])
        scores[true] = problem, problem.per_segment(problem.residual([plants[true].parameters])[0])
    for true, other in permutations(range(len(causes)), 2):
        if _includes(causes[other].location, causes[true].location):
            continue  # as the simpler one is preferred, what the richer one can do as well settles nothing
        problem, own = scores[true]
        wrong = problem.per_segment(_imitated(problem, causes[other], deviations))
        score = float(np.mean(np.log1p(wrong) - np.log1p(own)))
        if score < hardest:
            hardest, pair = score, (causes[true].location, causes[other].location)
            apart = float(np.sqrt(max(float(np.mean(wrong) - np.mean(own)), 0.0)))
    return Proposed(motion, size, commands, tuple(c.location for c in causes), pair, apart, hardest)


def _includes(richer: Location, simpler: Location) -> bool:
    """Whether a diagnosis would take the simpler of two effects at one place if the richer does nothing more."""
    same = (richer.site, richer.motor) == (simpler.site, simpler.motor)
    return same and len(EFFECTS[richer.name].parameters) > len(EFFECTS[simpler.name].parameters)


def _imitated(problem: ResidualModel, cause: _Known, deviations: Array) -> Array:
    """Residual (R,) of a cause that has moved its numbers and the device's to look like what was recorded."""
    count = len(deviations)
    kind = EFFECTS[cause.location.name].parameters
    low = np.concatenate([np.full(count, -BOUND), (np.array([p.low for p in kind]) - cause.values) / cause.free])
    high = np.concatenate([np.full(count, BOUND), (np.array([p.high for p in kind]) - cause.values) / cause.free])
    middle = np.append(deviations, np.zeros(len(kind)))

    def row(point: Array) -> Array | None:
        effect = make(cause.location, list(cause.values + point[count:] * cause.free))
        return problem.row_or_none([effect], point[:count])

    def loss(point: Array, residual: Array) -> float:
        return float(residual @ residual + (point - middle) @ (point - middle))

    at = middle.copy()
    first = row(at)
    assert first is not None
    residual = problem.residual([first])[0]
    for _ in range(ROUNDS):
        steps = np.where(at + STEP > high, -STEP, STEP)
        rows = [row(at + np.where(np.arange(len(at)) == j, steps, 0.0)) for j in range(len(at))]
        moved = problem.residual([each if each is not None else first for each in rows])
        slopes = (moved - residual).T / steps
        normal = slopes.T @ slopes + np.eye(len(at))
        wanted = descend(normal, slopes.T @ (slopes @ at - residual) + middle, at, low, high)
        tries = [at + share * (wanted - at) for share in (1.0, 0.3, 0.1)]
        found = [row(point) for point in tries]
        there = [(point, each) for point, each in zip(tries, found, strict=True) if each is not None]
        if not there:
            break
        residuals = problem.residual([each for _, each in there])
        losses = [loss(point, rest) for (point, _), rest in zip(there, residuals, strict=True)]
        least = int(np.argmin(losses))
        before = loss(at, residual)
        if not losses[least] < before:
            break
        at, residual, first = there[least][0], residuals[least], there[least][1]
        if losses[least] > 0.98 * before:
            break
    return residual


def rate_of(device: Device) -> float:
    """[Hz] of commands: RATE or more, a whole multiple of the sensors'."""
    return device.sensors.rate * ceil(RATE / device.sensors.rate - 1e-9)


def commands_of(plant: JointPlant, motion: Motion, size: float) -> tuple[Signals, Array]:
    """Commands that take a plant through a motion of `size` [rad], and the state (6,) at rest in which it begins."""
    device, rate = plant.device, rate_of(plant.device)
    time = np.arange(round(DURATION * rate)) / rate
    equilibrium, load = size * motion.reference(time), motion.load(time)
    start = np.zeros(6)
    if device.drive == "servo":
        preset = 0.6 + 0.4 * load
        start[1 : 1 + device.n_motors] = device.motor_angles(equilibrium[0], preset[0])
        channels = {"equilibrium": equilibrium, "preset": preset, "damping": np.zeros(len(time))}
        units = {"equilibrium": "rad", "preset": "rad", "damping": "-"}
        return Signals(time, channels, units, frozenset(channels)), start
    preset = np.zeros(len(time))
    if device.arrangement == "antagonistic":
        raised = np.clip(time / REST, 0.0, 1.0)
        preset = raised * (0.25 + 0.15 * load) * device.spring_laws[0].max_deflection
    wanted = device.motor_angles(equilibrium, preset) if device.n_motors else equilibrium[:, None]
    torque = following(plant, wanted, equilibrium, start, rate)
    if not device.n_motors:
        return Signals(
            time, {"external_torque": torque[:, 0]}, {"external_torque": "N m"}, frozenset({"external_torque"})
        ), start
    return Signals(time, {"motor": torque}, {"motor": "N m"}, frozenset({"motor"})), start


def following(plant: JointPlant, wanted: Array, equilibrium: Array, start: Array, rate: float) -> Array:
    """Torques (N, m) [N m] with which a position loop takes the motors (or a rigid link) along `wanted` (N, m)."""
    device = plant.device
    driven = max(device.n_motors, 1)
    forward = -device.torque_each(equilibrium, wanted) if device.n_transmissions == driven else np.zeros_like(wanted)
    rates = np.gradient(wanted, 1.0 / rate, axis=0)
    motors = [motor for motor in device.motors if isinstance(motor, TorqueMotor)]
    carried = np.array([m.inertia + device.link.inertia / driven for m in motors] or [device.link.inertia])
    viscous = np.array([m.viscous_friction for m in motors] or [device.link.viscous_friction])
    limit = np.array([m.torque_limit or inf for m in motors] or [inf])
    proportional = carried * BANDWIDTH**2
    derivative = np.maximum(1.2 * carried * BANDWIDTH - viscous, 0.2 * carried * BANDWIDTH)
    first = 1 if motors else 0
    simulator = Simulator(plant, rate)
    state, command = simulator.init(start), np.zeros(4)
    torque = np.empty_like(wanted)
    for k in range(len(wanted)):
        angle, speed = state[first : first + driven], state[3 + first : 3 + first + driven]
        asked = forward[k] + proportional * (wanted[k] - angle) + derivative * (rates[k] - speed)
        torque[k] = np.clip(asked, -limit, limit)
        if motors:
            command[:driven] = torque[k]
        else:
            command[3] = torque[k, 0]
        state, _, _ = simulator.step(state, command)
    return torque


def recorded(plant: JointPlant, commands: Signals, start: Array, seed: int) -> JointLog | None:
    """What the device's sensors would record of a plant under these commands; None where it runs away."""
    device = plant.device
    sensors = Sensors.of_device(device)
    try:
        run = simulate(plant, commands, DURATION, rate_of(device), sensors=sensors, initial=start, seed=seed)
    except ParameterError:
        return None
    seen = {name: values for name, values in run.measured.channels.items() if np.isfinite(values).any()}
    return JointLog("proposed", device, Signals(run.measured.time, seen, run.measured.units), commands)


def _allowed(log: JointLog, size: float) -> bool:
    """Whether a recorded motion keeps within the device's limits and does not run away."""
    device, measured = log.device, log.measured
    most = SWING * max(size, 0.5 * RANGE)
    if np.max(np.abs(measured["q"] - np.median(measured["q"]))) > most + abs(device.link.gravity_angle):
        return False
    if device.n_motors == 0:
        return True
    theta = measured["theta"]
    apart = max(1, round(0.01 * len(theta) / DURATION))  # samples: quanta would make a speed of one
    speed = np.abs(theta[apart:] - theta[:-apart]).max(axis=0) / (apart * np.median(np.diff(measured.time)))
    for i, motor in enumerate(device.motors):
        fastest = motor.speed_limit if isinstance(motor, TorqueMotor) else device.observed.servo_speed_limit
        if fastest is not None and speed[i] > fastest:
            return False
    if device.arrangement == "serial":
        return bool(np.max(np.abs(measured["q"] - theta[:, 0])) <= DEFLECTED * device.spring_laws[0].max_deflection)
    return all(
        bool(np.max(np.abs(measured["q"] - theta[:, i])) <= DEFLECTED * law.max_deflection)
        for i, law in enumerate(device.spring_laws)
    )
