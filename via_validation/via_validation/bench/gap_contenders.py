"""The fit that `via bench gap` repeats: a flexible joint, its log, and three programs that find its parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from io import StringIO

import mujoco
import numpy as np
from mujoco import sysid
from scipy.optimize import least_squares
from via_core.devices import Device, parse_device
from via_core.signals import Array, Signals
from via_gap.candidates.fit import fit_device_parameters
from via_gap.candidates.refinement import refine
from via_gap.candidates.scales import scales_of
from via_gap.design.commands import following
from via_gap.logs.log import JointLog
from via_gap.residual.inverse_dynamics import missing_torque
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import Segments, cut_log
from via_sim.effects import Effect
from via_sim.joint.parameters import P
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import InitialConditions, simulate

RATE = 1000.0  # [Hz]
NAMES = ("dry friction [N m]", "viscous friction [N m s/rad]", "inertia [kg m^2]")
TRUE = np.array([0.03, 0.02, 0.03])
LOW, HIGH = np.array([1e-5, -0.09, -0.06]), np.array([0.5, 0.5, 0.06])
START = np.array([0.005, 0.0, 0.0])
INERTIA, VISCOUS = 0.015, 0.1  # of the motor in the device file
GRAVITY, LEVER = 0.4, 0.02  # [N m], [m]
DEVICE = parse_device(
    f"""
name: bench
title: flexible joint that hangs
source: [made for this comparison]
confidence: assumed
arrangement: flexible
link: {{inertia: 0.02, viscous_friction: 0.02, gravity_torque: {GRAVITY}}}
motors: [{{inertia: {INERTIA}, viscous_friction: {VISCOUS}, torque_limit: 8.0}}]
springs: [{{law: odd_polynomial, odd_coefficients: [6.0, 10.0], max_deflection: 1.5}}]
sensors: {{rate: {RATE}, link_quantum: 9.587e-5, motor_quantum: 9.587e-5, torque_noise: 0.002}}
""",
    "bench",
)


def totals(x: Array) -> Array:
    """Parameters in the order of NAMES, from dry friction, added viscous friction and relative added inertia."""
    return np.array([x[0], VISCOUS + x[1], INERTIA * (1.0 + x[2])])


def log_of(duration: float, found: Array = TRUE, device: Device = DEVICE) -> JointLog:
    """A log of the joint with these parameters; a position controller moves the motor along a multisine."""
    plant = JointPlant.from_device(device).with_effects(_effects(found))
    row = plant.parameters.copy()
    row[P.inertia + 1] *= 1.0 + found[2]
    true = JointPlant(device, row, plant.effects)
    time = np.arange(round(duration * RATE)) / RATE
    frequency, amplitude = np.array([0.15, 0.37, 0.83, 1.7, 2.9]), np.array([0.5, 0.35, 0.25, 0.12, 0.06])
    phase = np.random.default_rng(3).uniform(0.0, 2.0 * np.pi, 5)
    fade = np.clip(time, 0.0, 1.0) ** 2 * (3.0 - 2.0 * np.clip(time, 0.0, 1.0))
    angle = fade * (np.sin(2.0 * np.pi * np.outer(time, frequency) + phase) @ amplitude)
    torque = following(true, angle[:, None], angle, np.zeros(6), RATE)
    commands = Signals(time, {"motor": torque}, {"motor": "N m"}, frozenset({"motor"}))
    seen = simulate(true, commands, duration, RATE, Sensors.of_device(device), InitialConditions(seed=1)).measured
    return JointLog(
        f"{duration:g} s", device, seen.select([n for n, v in seen.channels.items() if np.isfinite(v).any()]), commands
    )


def beginning(log: JointLog, duration: float) -> JointLog:
    """The first `duration` [s] of a log."""
    assert log.commands is not None
    end = duration + 0.5 / RATE
    return JointLog(f"{duration:g} s", log.device, log.measured.between(0.0, end), log.commands.between(0.0, end))


def _effects(found: Array) -> list[Effect]:
    return [
        Effect("coulomb_friction", "motor", {"torque": float(found[0])}, 1),
        Effect("viscous_friction", "motor", {"coefficient": float(found[1])}, 1),
    ]


def _problem(segments: Segments) -> ResidualModel:
    """Model of all valid segments; of the device's parameters only the motor's inertia is free."""
    whole = ResidualModel.of([segments], [np.flatnonzero(segments.valid)])
    return ResidualModel(whole.views, whole.plant, tuple(n for n in whole.nuisances if n.name == "motor 1 inertia"))


def by_via(log: JointLog) -> Array:
    """Fit by via_gap: (3,) in the order of NAMES."""
    segments = cut_log(log)
    problem = _problem(segments)
    base = fit_device_parameters(problem)
    scales = scales_of([segments], [missing_torque(segments, segments.log.device)])
    fit = refine(problem, base, replace(base, effects=tuple(_effects(np.array(START)))).members, scales)
    assert fit is not None
    dry, viscous = fit.effects
    share = problem.nuisances[0].tolerance * float(fit.offsets[0])
    return totals(np.array([dry.parameters["torque"], viscous.parameters["coefficient"], share]))


def by_scipy(log: JointLog) -> Array:
    """Fit by scipy with the same segments and simulator: (3,) in the order of NAMES."""
    problem = _problem(cut_log(log))
    tolerance = problem.nuisances[0].tolerance

    def residual(x: Array) -> Array:
        return problem.residual([problem.row(_effects(x), np.array([x[2] / tolerance]))])[0]

    solved = least_squares(residual, START, bounds=(LOW, HIGH), x_scale=np.array([0.01, 0.01, 0.01]))
    return totals(solved.x)


def by_sysid(log: JointLog) -> Array:
    """Fit by mujoco.sysid from the whole log: (3,) in the order of NAMES."""
    assert log.commands is not None
    spec = mujoco.MjSpec.from_string(_joint())
    model = spec.compile()
    modifiers: tuple[Callable[[mujoco.MjSpec, sysid.Parameter], None], ...] = (
        lambda spec, p: setattr(spec.joint("a"), "frictionloss", p.value[0]),
        lambda spec, p: setattr(spec.joint("a"), "damping", [p.value[0], 0.0, 0.0]),  # linear, quadratic, cubic
        lambda spec, p: setattr(spec.body("a"), "inertia", np.full(3, p.value[0])),
    )
    parameters = sysid.ParameterDict()
    for name, modifier, *numbers in zip(NAMES, modifiers, totals(START), totals(LOW), totals(HIGH), strict=True):
        parameters.add(sysid.Parameter(name, *numbers, modifier=modifier))
    angles = np.stack([log.measured["q"], log.measured["theta"][:, 0]], axis=1)
    start = sysid.create_initial_state(model, angles[0], np.zeros(2))  # the log begins at rest
    control = sysid.TimeSeries.from_control_names(log.commands.time, log.commands["motor"], model)
    # Positions of the state: sensors of the model are evaluated before the step, one tick late.
    seen = sysid.TimeSeries.from_names(log.measured.time, angles, model, ("q_qpos", "a_qpos"))
    sequences = sysid.ModelSequences("joint", spec, log.name, start, control, seen)
    residual = sysid.build_residual_fn(models_sequences=[sequences])
    found, _ = sysid.optimize(parameters, residual, verbose=False, output=StringIO())
    return np.asarray(found.as_vector())


def _joint() -> str:
    """The joint in MuJoCo's format with the start values of the fit."""
    mass = GRAVITY / 9.80665 / LEVER
    own = 0.02 - mass * LEVER**2
    dry, viscous, inertia = (float(value) for value in totals(START))
    return (
        f'<mujoco><option timestep="{1.0 / RATE}" gravity="0 0 -9.80665" integrator="implicitfast">'
        '<flag contact="disable"/></option><worldbody>'
        f'<body><joint name="q" axis="0 -1 0" damping="0.02"/><inertial pos="0 0 {-LEVER}" mass="{mass!r}" '
        f'diaginertia="{own!r} {own!r} {own!r}"/></body>'
        f'<body name="a"><joint name="a" axis="0 0 1" damping="{viscous!r}" frictionloss="{dry!r}"/>'
        f'<inertial pos="0 0 0" mass="1" diaginertia="{inertia!r} {inertia!r} {inertia!r}"/></body></worldbody>'
        '<tendon><fixed springlength="0" stiffness="6 0 10"><joint joint="q" coef="1"/><joint joint="a" coef="-1"/>'
        '</fixed></tendon><actuator><motor name="a" joint="a"/></actuator>'
        '<sensor><jointpos joint="q"/><jointpos joint="a"/></sensor></mujoco>'
    )


CONTENDERS: dict[str, Callable[[JointLog], Array]] = {"via_gap": by_via, "scipy least_squares": by_scipy}
if hasattr(sysid, "optimize"):  # the module is empty if one of its dependencies is not installed
    CONTENDERS["mujoco.sysid"] = by_sysid
