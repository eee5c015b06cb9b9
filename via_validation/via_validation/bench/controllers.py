"""What one evaluation of a control law costs, beside plain numpy where the law is more than a few lines.

Samples are those of the law's own motion in simulation, fed again one by one from Python, as a node does it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from via_bringup.demo.reference import DIRECTIONS, damped_arm
from via_controllers.contract import ArmController, ArmSample, JointSample, State
from via_controllers.equilibrium_preset import EquilibriumPreset
from via_controllers.max_velocity import MaxVelocity
from via_core.devices import load_device
from via_core.errors import ViaError

from via_validation.bench import controllers_reference
from via_validation.bench.timing import Contender, take_turns
from via_validation.control.arm_run import ArmRun, Phase, run_arm
from via_validation.control.bang_bang import pushed, reference_law
from via_validation.control.limit_cycle import cycling, law_of
from via_validation.tables.rows import Row

LIMIT = 250.0  # [us] of the full law of 4 joints on one core, control.md
SAMPLES = 200
ALIKE = 1e-6  # of the largest torque: the same law


def controller_rows(turns: int) -> list[Row]:
    """Everything `via bench controllers` measures; `turns` alternating repeats each."""
    cycle, bang = law_of(0), reference_law(damped_arm(), np.array(DIRECTIONS[1]))
    run = cycling(cycle, 0.5)
    other = run_arm(damped_arm(), bang, pushed(bang), (Phase(0.5),))
    joint, fast = EquilibriumPreset.from_device(load_device("qbmove_a")), load_device("visco_elastic_demo")
    throw = MaxVelocity.from_device(fast, 0.8)
    samples = _samples(run)
    _same_answers(samples)
    contenders = {
        "limit_cycle": _of_arm(cycle, samples),
        "limit_cycle.numpy": Contender(SAMPLES, lambda: _numpy(samples)),
        "limit_cycle.rigid": _rigid(samples),
        "bang_bang": _of_arm(bang, _samples(other)),
        "equilibrium_preset": Contender(SAMPLES, _joint(joint)),
        "equilibrium_preset.aim": Contender(SAMPLES, _aim(EquilibriumPreset.from_device(load_device("vsa2")))),
        "max_velocity": Contender(SAMPLES, _throw(throw)),
    }
    times = take_turns(contenders, turns)
    words = {
        "limit_cycle": "modal limit cycle on 4 flexible joints, the whole law (82)-(107)",
        "limit_cycle.numpy": "the same in plain numpy",
        "limit_cycle.rigid": "its rigid law alone, once (the whole evaluates it three times)",
        "bang_bang": "modal adaptive bang-bang on 4 flexible joints, adaptation included",
        "equilibrium_preset": "base control of a joint of two motors",
        "equilibrium_preset.aim": "its motor angles for a new angle and stiffness, VSA-II under gravity",
        "max_velocity": "fastest motion of a joint",
    }
    settings = (
        f"called from Python, {SAMPLES} samples of its own motion, median of {turns} alternating turns, one thread"
    )
    rows = [
        Row(f"law.{name}", what, "time of a step [us]", None, 1e-3 * times[name].nanoseconds,
            LIMIT if name == "limit_cycle" else None, settings)
        for name, what in words.items()
    ]  # fmt: skip
    ratio = times["limit_cycle"].over(times["limit_cycle.numpy"])
    what = "modal limit cycle over plain numpy"
    return [*rows, Row("law.limit_cycle.over_numpy", what, "ratio [-]", None, ratio, None, settings)]


def limit_cycle_time(turns: int) -> float:
    """Time of the processor for one evaluation of the modal limit cycle on 4 flexible joints [us], median."""
    law = law_of(0)
    times = take_turns({"law": _of_arm(law, _samples(cycling(law, 0.5)))}, turns)
    return 1e-3 * times["law"].nanoseconds


def _samples(run: ArmRun[State]) -> list[ArmSample]:
    """The last of a run."""
    nothing = np.full(run.q.shape[1], np.nan)
    parts = zip(run.time, run.q, run.velocity, run.theta, run.motor_velocity, strict=True)
    found = [ArmSample(float(time), q, v, theta, w, nothing) for time, q, v, theta, w in parts]
    return found[-SAMPLES:]


def _of_arm(law: ArmController[State], samples: list[ArmSample]) -> Contender:
    first = law.init(samples[0])

    def run() -> None:
        state = first
        for sample in samples:
            state, _ = law.step(state, sample)

    return Contender(len(samples), run)


def _rigid(samples: list[ArmSample]) -> Contender:
    cycle = law_of(0).cycle
    first = cycle.init(samples[0].q)

    def run() -> None:
        basis = first
        for sample in samples:
            basis = cycle.at(basis, sample.q, sample.q_velocity).basis

    return Contender(len(samples), run)


def _numpy(samples: list[ArmSample]) -> None:
    law = law_of(0)
    W = law.cycle.init(samples[0].q).W
    for sample in samples:
        _, W = controllers_reference.step(law, W, sample)


def _same_answers(samples: list[ArmSample]) -> None:
    """Raises ViaError where the contenders do not compute the same."""
    law = law_of(0)
    W, state = law.cycle.init(samples[0].q).W, law.init(samples[0])
    for sample in samples[:20]:
        plain, W = controllers_reference.step(law, W, sample)
        state, out = law.step(state, sample)
        if not np.abs(plain - out.torque).max() < ALIKE * np.abs(plain).max():
            raise ViaError(f"numpy's limit cycle disagrees: {plain} N m, compiled {out.torque} N m")


def _joint(law: EquilibriumPreset) -> Callable[[], None]:
    wish = law.towards(law.init(), 0.1, 5.0)

    def run() -> None:
        state = wish
        for tick in range(SAMPLES):
            time = 1e-3 * tick
            state, _ = law.step(state, JointSample(time, 0.1 * np.sin(6.0 * time), np.array([0.5, -0.4])))

    return run


def _aim(law: EquilibriumPreset) -> Callable[[], None]:
    angles = 0.2 * np.sin(np.linspace(0.0, 9.0, SAMPLES))
    low, high = law.references.stiffness_range(0.0)
    wishes = [(float(q), low + (0.5 + 0.4 * float(q) / 0.2) * (high - low)) for q in angles]

    def run() -> None:
        state = law.init()
        for q, stiffness in wishes:
            state = law.towards(state, q, stiffness)

    return run


def _throw(law: MaxVelocity) -> Callable[[], None]:
    def run() -> None:
        state = law.init()
        for tick in range(SAMPLES):
            time = 1e-3 * tick
            state, _ = law.step(state, JointSample(time, 0.1 * time, np.array([time])))

    return run
