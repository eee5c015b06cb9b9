"""One case from its seed: joint, effect, size, sensors, motion, and what is recorded of it.

Seeds come in blocks of BLOCK. Every block holds each named effect once at full signal level, and its shares of joints
without a gap, of physics outside the catalogue, of pairs and of logs that lack signals, in an order drawn from the
number of the block. A draw that diverges, that has no place for its effect, that misses the declared range of gap
over noise or whose effect is made up for by the joint's own numbers inside the tolerance of its file (then there is no
gap) is drawn again from the seed and the number of the attempt; attempts are counted in the key.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, log, sqrt
from typing import Any

import numpy as np
from numpy.random import Generator
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array

from via_gap.benchmark.excitation import excite, start_of
from via_gap.benchmark.joints import FAMILIES, TOLERANCE, Content, believed, device_of, draw_joint, scaled
from via_gap.benchmark.menu import MENU, Entry, Numbers, Place, Shape
from via_gap.benchmark.model import STEP
from via_gap.benchmark.physics import Physics
from via_gap.benchmark.recording import LEVELS, Log, Wobble, limited, neighbour_angle, sense
from via_gap.benchmark.residual import left_by_numbers, ratio, residuals
from via_gap.benchmark.scene import Scene, scene_of
from via_gap.benchmark.stepping import Drive, Run, simulate
from via_gap.benchmark.strangers import STRANGERS

RANGE = (3.0, 30.0)  # of gap over noise
AIM = (4.0, 25.0)  # what is drawn, so that the final run stays inside
NEAR = 0.12  # how close the search comes, as a logarithm
COARSE = 4.0 * STEP  # [s] of the search
SLOPE = 0.01  # relative step of a number of the joint
ATTEMPTS = 200
MAX_NOISE = 12.0  # times the drawn sensors' noise
KINDS = ("single", "no_gap", "unknown", "pair", "limited")
SHARES = {"no_gap": 8, "unknown": 6, "pair": 6, "limited": 10}
BLOCK = len(MENU) + sum(SHARES.values())


@dataclass(frozen=True)
class Truth:
    """One effect of a case, as the key tells it."""

    effect: str
    site: str
    motor: int
    parameters: Numbers
    ratio: float  # gap over noise, of it alone
    beyond: float  # the same, once the joint's own numbers have made up for what they can inside their tolerance


@dataclass(frozen=True)
class Case:
    """Everything of a case; the first three go into its folder, the rest is the key's."""

    nominal: Content
    log: Log
    level: str
    seed: int
    kind: str
    family: str
    true: Content
    errors: dict[str, float]  # relative, of the nominal numbers
    truths: tuple[Truth, ...]
    ratio: float  # gap over noise, of all effects together
    noise: float  # factor on the drawn sensors' noise
    wobble: Wobble
    withheld: Log
    attempts: int

    def key(self) -> dict[str, Any]:
        """What is sealed, but for the withheld log."""
        return {
            "seed": self.seed,
            "kind": self.kind,
            "level": self.level,
            "family": self.family,
            "effects": [vars(truth) for truth in self.truths],
            "ratio": self.ratio,
            "true_device": self.true,
            "nominal_errors": self.errors,
            "noise_factor": self.noise,
            "jitter": self.wobble.jitter,
            "lost": self.wobble.lost,
            "attempts": self.attempts,
        }


@dataclass(frozen=True)
class Plan:
    kind: str
    level: str
    effect: str  # '': to be drawn


class _AgainError(Exception):
    """This draw makes no case."""


def plan(seed: int) -> Plan:
    """What the case of a seed is to be."""
    block, place = divmod(seed, BLOCK)
    slot = int(np.random.default_rng([block, BLOCK]).permutation(BLOCK)[place])
    names = tuple(MENU)
    if slot < len(names):
        return Plan("single", "full", names[slot])
    slot -= len(names)
    for kind, share in SHARES.items():
        if slot < share:
            unknown = tuple(STRANGERS)[(block * share + slot) % len(STRANGERS)] if kind == "unknown" else ""
            return Plan(kind, LEVELS[1 + slot % 3] if kind == "limited" else "full", unknown)
        slot -= share
    raise AssertionError(seed)


def draw_case(seed: int, duration: float = 40.0) -> Case:
    """The case of a seed. Raises ParameterError where no attempt makes one."""
    wanted = plan(seed)
    for attempt in range(ATTEMPTS):
        try:
            return _attempt(np.random.default_rng([seed, attempt]), seed, attempt, wanted, duration)
        except _AgainError:
            continue
    raise ParameterError(f"seed {seed}: none of {ATTEMPTS} attempts made a case")


@dataclass(frozen=True)
class _Bench:
    """A true joint with one motion, and what its sensors leave of the equations without any effect."""

    device: Device
    drive: Drive
    initial: Array
    scene: Scene
    floor: Array
    noise: int  # seed of the sensors'

    def run(self, physics: Physics, step: float) -> Run | None:
        push = push_of(np.random.default_rng(self.noise), physics, self.drive)
        return simulate(self.device, physics, self.drive, push, self.initial, step)

    def ratio(self, physics: Physics, run: Run) -> float:
        return ratio(residuals(self.device, self._log(physics, run), run.speed), self.floor)

    def beyond(self, physics: Physics, run: Run, true: Content, errors: dict[str, float]) -> float:
        """Gap over noise beyond what the numbers of the nominal file explain inside their tolerance."""
        log = self._log(physics, run)
        found = residuals(self.device, log, run.speed)
        slopes = [
            (residuals(device_of(scaled(true, where, 1.0 + SLOPE)), log, run.speed) - found) / SLOPE for where in errors
        ]
        off = np.array(list(errors.values()))
        return left_by_numbers(found, self.floor, np.array(slopes), off - TOLERANCE, off + TOLERANCE)

    def _log(self, physics: Physics, run: Run) -> Log:
        return sense(np.random.default_rng(self.noise), self.device, physics, self.drive, run)


def push_of(rng: Generator, physics: Physics, drive: Drive) -> Array:
    """(N,) [N m] torque of the environment on the link."""
    time = np.arange(len(drive.references)) / drive.rate
    push = np.where((time >= physics.push_from) & (time < physics.push_until), physics.push, 0.0)
    if physics.coupling:
        push = push + physics.coupling * neighbour_angle(physics.neighbour_period, time)
    if physics.unrest:
        keep = np.exp(-1.0 / (drive.rate * physics.unrest_time))
        steps, now = rng.standard_normal(len(time)) * physics.unrest * sqrt(1.0 - keep * keep), 0.0
        for k, step in enumerate(steps):
            now = keep * now + step
            push[k] += now
    return push


def _bench(rng: Generator, device: Device, duration: float) -> _Bench:
    """A motion that the joint without effect survives inside its stops."""
    drive = excite(rng, device, duration, 1.0)
    initial, noise = start_of(device, drive), int(rng.integers(2**31))
    run = simulate(device, Physics(), drive, np.zeros(len(drive.references)), initial, STEP)
    if run is None or not _inside(device, run):
        raise _AgainError
    log = sense(np.random.default_rng(noise), device, Physics(), drive, run)
    return _Bench(device, drive, initial, scene_of(device, run), residuals(device, log, run.speed), noise)


def _inside(device: Device, run: Run) -> bool:
    deflection = np.abs(run.angle[:, :1] - run.angle[:, 1 : 1 + device.n_transmissions]).max(axis=0)
    return all(d < 0.95 * spring.max_deflection for d, spring in zip(deflection, device.springs))


@dataclass(frozen=True)
class _Drawn:
    """An effect at its place, before its size."""

    entry: Entry
    place: Place
    shape: Shape

    def of_size(self, scene: Scene, size: float) -> tuple[Physics, Numbers]:
        return self.entry.of_size(scene, self.place, size, self.shape)


def _attempt(rng: Generator, seed: int, attempt: int, wanted: Plan, duration: float) -> Case:
    without = {"full": (), "commands_only": ("rigid",)}.get(wanted.level, ("rigid", "variable_damping"))
    family = str(rng.choice([each for each in FAMILIES if each not in without]))
    true = draw_joint(rng, family)
    nominal, errors = believed(rng, true)
    entries = _entries(rng, wanted)
    places = [_place(rng, device_of(true), entry, wanted.level) for entry in entries]
    bench = _bench(rng, device_of(true), duration)
    drawn = [_Drawn(entry, place, entry.shape(rng, bench.scene)) for entry, place in zip(entries, places)]
    aims = np.exp(rng.uniform(log(AIM[0]), log(AIM[1]), len(drawn)))
    if wanted.kind == "limited":
        aims = np.maximum(aims, 2.0 * AIM[0])
    noise = 1.0
    sizes = [_search(bench, each, aim) for each, aim in zip(drawn, aims)]
    above = max((found / aim for (_, found), aim in zip(sizes, aims)), default=1.0)
    if above > np.exp(NEAR):  # the least of this effect is more than was asked for: noisier sensors
        noise = min(1.3 * above, MAX_NOISE)
        true, nominal = _noisier(true, noise), _noisier(nominal, noise)
        bench = _noisier_bench(bench, device_of(true))
        sizes = [_search(bench, each, aim) for each, aim in zip(drawn, aims)]
    physics, truths, final = Physics(), [], bench.run(Physics(), STEP)
    for each, (size, _) in zip(drawn, sizes):
        alone, numbers = each.of_size(bench.scene, size)
        final = bench.run(alone, STEP)
        there = bench.ratio(alone, final) if final is not None else inf
        if not RANGE[0] <= there <= RANGE[1] or max(map(abs, numbers.values())) > each.entry.most:
            raise _AgainError
        beyond = bench.beyond(alone, final, true, errors) if final is not None else inf
        if beyond < RANGE[0]:
            raise _AgainError
        truths.append(Truth(each.entry.name, *each.place, _rounded(numbers), round(there, 3), round(beyond, 3)))
        try:
            physics = physics.joined(alone)
        except ValueError:
            raise _AgainError from None
    if len(drawn) > 1:
        final = bench.run(physics, STEP)
    if final is None or not _inside(bench.device, final):
        raise _AgainError
    whole = bench.ratio(physics, final)
    if not physics.neighbour_period and rng.uniform() < 0.15:  # a neighbour that does nothing to this joint
        physics = physics.with_(neighbour_period=float(rng.uniform(1.5, 4.0)))
    wobble = _wobble(rng) if bench.device.motors else Wobble()  # one row of a table holds sample and command
    log_rng, other_rng = rng.spawn(2)
    recorded = sense(log_rng, bench.device, physics, bench.drive, final, wobble)
    other = excite(other_rng, bench.device, duration, 1.0)
    push = push_of(other_rng, physics, other)
    again = simulate(bench.device, physics, other, push, start_of(bench.device, other), STEP)
    if again is None:
        raise _AgainError
    withheld = limited(sense(other_rng, bench.device, physics, other, again), wanted.level)
    return Case(
        nominal, limited(recorded, wanted.level), wanted.level, seed, wanted.kind, family, true, errors, tuple(truths),
        round(whole, 3), noise, wobble, withheld, attempt + 1,
    )  # fmt: skip


def _entries(rng: Generator, wanted: Plan) -> list[Entry]:
    if wanted.kind == "no_gap":
        return []
    if wanted.kind == "unknown":
        return [STRANGERS[wanted.effect]]
    if wanted.kind == "pair":
        names = rng.choice(list(MENU), size=2, replace=False)
        return [MENU[str(name)] for name in names]
    return [MENU[wanted.effect or str(rng.choice(list(MENU)))]]


def _place(rng: Generator, device: Device, entry: Entry, level: str) -> Place:
    """Where the effect sits, among the places at which a log of this level can show it."""
    places = entry.places(device)
    if level != "full":  # a wrong reading that was not recorded shows nowhere
        unseen = {"no_torque": entry.sensed is not None, "link_only": entry.sensed is None}.get(level, True)
        places = tuple(place for place in places if place[0] not in ("sensor", "timing") or not place[1] or not unseen)
    if not places:
        raise _AgainError
    return places[int(rng.integers(len(places)))]


def _search(bench: _Bench, drawn: _Drawn, aim: float) -> tuple[float, float]:
    """(size, gap over noise) near `aim`, or at the least size where that is already above it.

    Residual energy grows about as the square of the size, r^2 = 1 + (a s)^2: each trial gives the next one's size, kept
    between the largest size known to be too small and the smallest known to be too large.
    """
    low, high = drawn.entry.low, drawn.entry.high
    size, best = min(max(sqrt(low * high) * 0.5, low), high), (low, inf)
    for _ in range(7):
        physics, _numbers = drawn.of_size(bench.scene, size)
        run = bench.run(physics, COARSE)
        found = bench.ratio(physics, run) if run is not None else inf
        if abs(log(found / aim)) < abs(log(best[1] / aim)):
            best = (size, found)
        if abs(log(found / aim)) < NEAR or (found > aim and size <= drawn.entry.low * 1.001):
            break
        if found > aim:
            high = size
        else:
            low = size
        if low >= high * 0.999:
            break
        guess = size * sqrt((aim * aim - 1.0) / (found * found - 1.0)) if 1.05 < found < inf else 0.0
        if found > aim and guess <= drawn.entry.low:
            size = drawn.entry.low
        else:
            size = guess if low < guess < high else sqrt(low * high)
    return best


def _noisier(content: Content, factor: float) -> Content:
    """Coarser encoders and more torque noise."""
    sensors = {
        key: float(f"{value * factor:.6g}") if key != "rate" else value for key, value in content["sensors"].items()
    }
    return content | {"sensors": sensors}


def _noisier_bench(bench: _Bench, device: Device) -> _Bench:
    run = simulate(device, Physics(), bench.drive, np.zeros(len(bench.drive.references)), bench.initial, STEP)
    if run is None:
        raise _AgainError
    sensed = sense(np.random.default_rng(bench.noise), device, Physics(), bench.drive, run)
    floor = residuals(device, sensed, run.speed)
    return _Bench(device, bench.drive, bench.initial, scene_of(device, run), floor, bench.noise)


def _wobble(rng: Generator) -> Wobble:
    """Two logs of five are not perfectly sampled."""
    which = rng.uniform()
    if which < 0.2:
        return Wobble(jitter=float(rng.uniform(0.02, 0.1)))
    if which < 0.4:
        return Wobble(lost=float(rng.uniform(0.001, 0.01)))
    return Wobble()


def _rounded(numbers: Numbers) -> Numbers:
    return {name: float(f"{value:.9g}") for name, value in numbers.items()}
