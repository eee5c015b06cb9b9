"""Time of one controller evaluation, compared with plain numpy for the modal limit cycle.

The samples come from a simulation with the same controller; they are passed one by one from Python, as in a node.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from via_bringup.demo.reference import DIRECTIONS, damped_arm
from via_controllers.contract import ArmController, ArmSample, JointSample, State
from via_controllers.joints.equilibrium_preset import EquilibriumPreset
from via_controllers.joints.max_velocity import MaxVelocity
from via_core.devices import load_device
from via_core.errors import ViaError

from via_validation.bench import controllers_reference
from via_validation.bench.timing import Contender, take_turns
from via_validation.control.arm_run import ArmRun, Phase, run_arm
from via_validation.control.bang_bang import pushed, reference_controller
from via_validation.control.limit_cycle import cycling, limit_cycle_controller
from via_validation.tables.rows import Row

LIMIT = 250.0  # [us] for the full controller of 4 joints on one core, control.md
SAMPLES = 200
SAME = 1e-6  # [-] largest difference of equal implementations, relative to the largest torque


def controller_rows(turns: int) -> list[Row]:
    """All rows of `via bench controllers`, from `turns` alternating repeats."""
    cycle, bang = limit_cycle_controller(0), reference_controller(damped_arm(), np.array(DIRECTIONS[1]))
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
        "limit_cycle": "modal limit cycle on 4 flexible joints, whole controller (82)-(107)",
        "limit_cycle.numpy": "modal limit cycle in plain numpy",
        "limit_cycle.rigid": "its rigid part alone, once (the whole evaluates it three times)",
        "bang_bang": "modal adaptive bang-bang on 4 flexible joints, adaptation included",
        "equilibrium_preset": "base controller of a joint with two motors",
        "equilibrium_preset.aim": "its motor angles for a new equilibrium and stiffness, VSA-II with gravity",
        "max_velocity": "maximum velocity of a joint",
    }
    settings = (
        f"called from Python, {SAMPLES} samples of its own motion, median of {turns} alternating turns, one thread"
    )
    rows = [
        Row(f"controller.{name}", what, "time of a step [us]", None, 1e-3 * times[name].nanoseconds,
            LIMIT if name == "limit_cycle" else None, settings)
        for name, what in words.items()
    ]  # fmt: skip
    ratio = times["limit_cycle"].over(times["limit_cycle.numpy"])
    what = "modal limit cycle over plain numpy"
    return [*rows, Row("controller.limit_cycle.over_numpy", what, "ratio [-]", None, ratio, None, settings)]


def limit_cycle_time(turns: int) -> float:
    """Median processor time [us] of one evaluation of the modal limit cycle on 4 flexible joints."""
    controller = limit_cycle_controller(0)
    times = take_turns({"one": _of_arm(controller, _samples(cycling(controller, 0.5)))}, turns)
    return 1e-3 * times["one"].nanoseconds


def _samples(run: ArmRun[State]) -> list[ArmSample]:
    """The last SAMPLES samples of a run."""
    nothing = np.full(run.q.shape[1], np.nan)
    parts = zip(run.time, run.q, run.velocity, run.theta, run.motor_velocity, strict=True)
    found = [ArmSample(float(time), q, v, theta, w, nothing) for time, q, v, theta, w in parts]
    return found[-SAMPLES:]


def _of_arm(controller: ArmController[State], samples: list[ArmSample]) -> Contender:
    first = controller.init(samples[0])

    def run() -> None:
        state = first
        for sample in samples:
            state, _ = controller.step(state, sample)

    return Contender(len(samples), run)


def _rigid(samples: list[ArmSample]) -> Contender:
    cycle = limit_cycle_controller(0).cycle
    first = cycle.init(samples[0].q)

    def run() -> None:
        basis = first
        for sample in samples:
            basis = cycle.at(basis, sample.q, sample.q_velocity).basis

    return Contender(len(samples), run)


def _numpy(samples: list[ArmSample]) -> None:
    controller = limit_cycle_controller(0)
    W = controller.cycle.init(samples[0].q).W
    for sample in samples:
        _, W = controllers_reference.step(controller, W, sample)


def _same_answers(samples: list[ArmSample]) -> None:
    """Raise ViaError if the compiled controller and the numpy one differ."""
    controller = limit_cycle_controller(0)
    W, state = controller.cycle.init(samples[0].q).W, controller.init(samples[0])
    for sample in samples[:20]:
        plain, W = controllers_reference.step(controller, W, sample)
        state, out = controller.step(state, sample)
        if not np.abs(plain - out.torque).max() < SAME * np.abs(plain).max():
            raise ViaError(f"the limit cycle in numpy disagrees: {plain} N m, compiled {out.torque} N m")


def _joint(controller: EquilibriumPreset) -> Callable[[], None]:
    first = controller.with_reference(controller.init(), 0.1, 5.0)

    def run() -> None:
        state = first
        for tick in range(SAMPLES):
            time = 1e-3 * tick
            state, _ = controller.step(state, JointSample(time, 0.1 * np.sin(6.0 * time), np.array([0.5, -0.4])))

    return run


def _aim(controller: EquilibriumPreset) -> Callable[[], None]:
    angles = 0.2 * np.sin(np.linspace(0.0, 9.0, SAMPLES))
    low, high = controller.references.stiffness_range(0.0)
    targets = [(float(q), low + (0.5 + 0.4 * float(q) / 0.2) * (high - low)) for q in angles]

    def run() -> None:
        state = controller.init()
        for q, stiffness in targets:
            state = controller.with_reference(state, q, stiffness)

    return run


def _throw(controller: MaxVelocity) -> Callable[[], None]:
    def run() -> None:
        state = controller.init()
        for tick in range(SAMPLES):
            time = 1e-3 * tick
            state, _ = controller.step(state, JointSample(time, 0.1 * time, np.array([time])))

    return run
