"""Serial arms of flexible joints: rigid bodies of a URDF, a motor and a nonlinear spring per joint, eqs. (9)-(11).

    link    M(q) qdd + C(q, qd) qd + Dq qd + g(q) + tau_e(phi) = tau_ext,   phi = q - theta
    motor   B thdd + D thd - tau_e(phi)                        = tau

One motor per joint: the principal motor of a serial device, whose preset motor stands still at the angle `preset`. The
rotors contribute the kinetic energy of their own spin only. Rigid bodies by pinocchio, with C such that Mdot = C + C'.

    arm = load_vsa_arm("reference_4dof")         # a shipped file, see vsa_arm_names()
    arm = load_vsa_arm("my_robot/arm.yaml")      # or your own
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pinocchio
from numba import njit
from pydantic import Field

from via_core.arm_files import ArmFile, read_arm
from via_core.device_parts import TorqueMotor
from via_core.errors import DeviceError, ParameterError
from via_core.records import Described, NotNegative, Number, Record, Text, read_record, shipped_names
from via_core.signals import Array, locked
from via_core.spring_equations import spring_stiffness, spring_stiffness_slope, spring_torque
from via_core.springs import Spring, SpringLaw

BALANCE = 1e-9  # [N m] largest torque error of an arm at rest
LINE = 1e-4  # [rad] step of central differences: second derivatives of M are then accurate to 1e-9


class VsaJoint(Record):
    """Motor and spring of one joint of the URDF."""

    name: Text  # of the joint in the URDF
    motor: TorqueMotor
    spring: Spring
    preset: Number = 0.0  # [rad] of the preset motor
    link_friction: NotNegative = 0.0  # [N m s/rad] viscous


class VsaArmFile(Described, ArmFile):
    """The YAML file of an arm: its URDF, and its joints, base first."""

    tip: Text  # link of the URDF whose origin is the end effector
    joints: Annotated[tuple[VsaJoint, ...], Field(min_length=1)]


@njit(cache=True, error_model="numpy")
def _springs(kinds: Array, c: Array, scale: Array, phi: Array, presets: Array, out: Array) -> None:
    """Torque, stiffness and stiffness slope of every joint into out (3, n)."""
    for i in range(phi.size):
        out[0, i] = scale[i] * spring_torque(kinds[i], c[i], phi[i], presets[i])
        out[1, i] = scale[i] * spring_stiffness(kinds[i], c[i], phi[i], presets[i])
        out[2, i] = scale[i] * spring_stiffness_slope(kinds[i], c[i], phi[i], presets[i])


@njit(cache=True, error_model="numpy")
def _rates(
    kinds: Array, c: Array, scale: Array, presets: Array, inertia: Array, friction: Array, link_friction: Array,
    x: Array, tau: Array, load: Array, out: Array,
) -> Array:  # fmt: skip
    """Rates of a state x (4, n) into out (4, n), except qdd; the torques (n,) [N m] on the links."""
    links = np.empty(tau.size)
    for i in range(tau.size):
        tau_e = scale[i] * spring_torque(kinds[i], c[i], x[0, i] - x[2, i], presets[i])
        out[0, i], out[2, i] = x[1, i], x[3, i]
        out[3, i] = (tau[i] + tau_e - friction[i] * x[3, i]) / inertia[i]
        links[i] = load[i] - tau_e - link_friction[i] * x[1, i]
    return links


@njit(cache=True, error_model="numpy")
def _mirrored(upper: Array) -> Array:
    """The symmetric matrix with this upper triangle, the only part that pinocchio fills reliably."""
    out = upper.copy()
    for i in range(len(out)):
        for j in range(i):
            out[i, j] = out[j, i]
    return out


@njit(cache=True, error_model="numpy")
def inertia_of(terms: Array, h: float) -> tuple[Array, Array, Array]:
    """M (n, n), dM/dq_k (n, n, n), k first, and Mdd (n, n) of `VsaArm.inertia_terms`."""
    n = terms.shape[1]
    slopes, second = np.empty((n, n, n)), np.zeros((n, n))
    for i in range(n):
        for j in range(n):
            for k in range(n):
                slopes[k, i, j] = terms[1 + k, i, j] + terms[1 + k, j, i]
            if h > 0.0:
                ahead, behind = terms[n + 1], terms[n + 2]
                second[i, j] = ((ahead[i, j] - behind[i, j]) + (ahead[j, i] - behind[j, i])) / (2.0 * h)
    return _mirrored(terms[0]), slopes, second


@dataclass(frozen=True, eq=False)
class VsaArm:
    """An arm of n flexible joints, base first; every vector (n,) in that order, SI units.

    model           pinocchio's rigid bodies, joints of one angle each
    tip             name of the frame of `model` that is the end effector
    springs         spring law of each joint
    presets         [rad] angles of the preset motors
    motor_inertia   B [kg m^2], reflected to the joints
    motor_friction  D [N m s/rad]
    link_friction   Dq [N m s/rad]
    torque_limit    [N m], infinite where unknown
    speed_limit     [rad/s], infinite where unknown
    spring_scale    spring torques over those of `springs` [-]; empty: 1

    Not thread-safe: the arm owns the workspace of pinocchio.
    """

    name: str
    model: pinocchio.Model
    tip: str
    springs: tuple[SpringLaw, ...]
    presets: Array
    motor_inertia: Array
    motor_friction: Array
    link_friction: Array
    torque_limit: Array
    speed_limit: Array
    spring_scale: Array = field(default_factory=lambda: np.ones(0))
    _data: pinocchio.Data = field(init=False, repr=False)
    _kinds: Array = field(init=False, repr=False)
    _rows: Array = field(init=False, repr=False)
    _along: tuple[Array, ...] = field(init=False, repr=False)
    _tip: int = field(init=False, repr=False)
    _stops: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        n = len(self.springs)
        if self.model.nq != n or self.model.nv != n:
            raise ParameterError(f"model has {self.model.nv} velocities and {self.model.nq} angles for {n} springs")
        if not self.model.existFrame(self.tip):
            raise ParameterError(f"tip: no frame '{self.tip}'")
        if not len(self.spring_scale):
            object.__setattr__(self, "spring_scale", np.ones(n))
        vectors = ("motor_inertia", "motor_friction", "link_friction", "torque_limit", "speed_limit", "spring_scale")
        for name in ("presets", *vectors):
            values = locked(getattr(self, name), name)
            if values.shape != (n,) or np.isnan(values).any():
                raise ParameterError(f"{name} must hold {n} numbers, got {values}")
            friction = name.endswith("friction")
            if name != "presets" and (values.min() < 0.0 or (not friction and values.min() == 0.0)):
                raise ParameterError(f"{name} must be positive, got {values}")
            object.__setattr__(self, name, values)
        object.__setattr__(self, "_data", self.model.createData())
        object.__setattr__(self, "_kinds", np.array([spring.kind for spring in self.springs]))
        object.__setattr__(self, "_tip", self.model.getFrameId(self.tip))
        object.__setattr__(self, "_stops", locked([spring.max_deflection for spring in self.springs], "stops"))
        object.__setattr__(self, "_along", tuple(np.eye(n)))
        object.__setattr__(self, "_rows", np.array([spring.coefficients() for spring in self.springs]))

    def corrected(self, payload: float, spring_scale: Array, link_friction: Array | float = 0.0) -> VsaArm:
        """This arm with a point mass `payload` [kg] at the tip, its spring torques times `spring_scale` (n,) [-].

        `link_friction` (n,) [N m s/rad] is added to the viscous friction of the links. For controllers that correct
        their model while they run: arguments are not checked, and the arm shares the workspace of this one.
        """
        arm, model, frame = copy(self), self.model.copy(), self.model.frames[self._tip]
        point = pinocchio.Inertia(payload, frame.placement.translation, np.zeros((3, 3)))
        model.inertias[frame.parentJoint] = model.inertias[frame.parentJoint] + point
        object.__setattr__(arm, "model", model)
        object.__setattr__(arm, "spring_scale", locked(self.spring_scale * spring_scale, "spring_scale"))
        object.__setattr__(arm, "link_friction", locked(self.link_friction + link_friction, "link_friction"))
        return arm

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.springs)

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, base first."""
        return tuple(self.model.names)[1:]

    @property
    def deflection_limit(self) -> Array:
        """Deflections (n,) [rad] at the mechanical stops of the springs."""
        return self._stops

    def inertia(self, q: Array) -> Array:
        """M(q) (n, n) [kg m^2], exactly symmetric."""
        return _mirrored(np.ascontiguousarray(pinocchio.crba(self.model, self._data, q)))

    def coriolis(self, q: Array, velocity: Array) -> Array:
        """C(q, qd) (n, n) [N m s/rad], such that Mdot - 2 C is skew-symmetric."""
        return np.array(pinocchio.computeCoriolisMatrix(self.model, self._data, q, velocity))

    def inertia_rate(self, q: Array, velocity: Array) -> Array:
        """Mdot (n, n) = C + C' [kg m^2/s]; with a unit vector as `velocity` the derivative of M by that angle."""
        C = self.coriolis(q, velocity)
        return C + C.T

    def inertia_slopes(self, q: Array) -> Array:
        """dM/dq_k (n, n, n) [kg m^2/rad], k first."""
        return inertia_of(*self.inertia_terms(q, np.zeros(self.n)))[1]

    def inertia_second(self, q: Array, velocity: Array) -> Array:
        """Mdd (n, n) [kg m^2/s^2] of a motion at constant velocity: central difference of the exact Mdot."""
        return inertia_of(*self.inertia_terms(q, velocity))[2]

    def inertia_terms(self, q: Array, velocity: Array) -> tuple[Array, float]:
        """Arguments of `inertia_of`, which compiled controllers call: terms (n + 3, n, n) and a time step [s].

        The terms are M (upper triangle), C at unit speed of each joint, then C one step ahead and behind. At zero
        velocity the step is 0 and the last two terms are not set.
        """
        model, data, n = self.model, self._data, len(self.springs)
        out = np.empty((n + 3, n, n))
        out[0] = pinocchio.crba(model, data, q)
        for k, along in enumerate(self._along, start=1):
            out[k] = pinocchio.computeCoriolisMatrix(model, data, q, along)
        fastest = max(map(abs, velocity.tolist()))
        if fastest == 0.0:
            return out, 0.0
        h = LINE / fastest
        there = h * velocity
        out[n + 1] = pinocchio.computeCoriolisMatrix(model, data, q + there, velocity)
        out[n + 2] = pinocchio.computeCoriolisMatrix(model, data, q - there, velocity)
        return out, h

    def gravity(self, q: Array) -> Array:
        """g(q) (n,) [N m]."""
        return np.array(pinocchio.computeGeneralizedGravity(self.model, self._data, q))

    def link_torque(self, q: Array, velocity: Array, acceleration: Array) -> Array:
        """M qdd + C qd + Dq qd + g (n,) [N m]: torque on the links for this motion."""
        rigid = pinocchio.rnea(self.model, self._data, q, velocity, acceleration)
        return np.asarray(rigid + self.link_friction * velocity)

    def link_acceleration(self, q: Array, velocity: Array, torque: Array) -> Array:
        """qdd (n,) [rad/s^2] under `torque` (n,) [N m] on the links: -tau_e + tau_ext, or motors of a rigid arm."""
        return np.array(pinocchio.aba(self.model, self._data, q, velocity, torque - self.link_friction * velocity))

    def tip_position(self, q: Array) -> Array:
        """Position (3,) [m] of the end effector in the base frame."""
        pinocchio.framesForwardKinematics(self.model, self._data, q)
        return np.array(self._data.oMf[self._tip].translation)

    def tip_jacobian(self, q: Array) -> Array:
        """J (3, n) [m/rad]: J qd is the tip velocity in the base frame; a tip force F loads the links by J' F."""
        aligned = pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
        return np.array(pinocchio.computeFrameJacobian(self.model, self._data, q, self._tip, aligned)[:3])

    def spring_state(self, deflection: Array) -> tuple[Array, Array, Array]:
        """tau_e [N m], sigma [N m/rad] and d sigma/d phi [N m/rad^2] at `deflection` (n,) [rad], each (n,)."""
        out = np.empty((3, self.n))
        _springs(self._kinds, self._rows, self.spring_scale, deflection, self.presets, out)
        return out[0], out[1], out[2]

    def spring_strength(self, share: float) -> Array:
        """Torques (n,) [N m] that springs hold to either side at a `share` of their stops, at most at a radian."""
        reach = np.minimum(share * self.deflection_limit, 1.0)
        return np.minimum(*(np.abs(self.spring_state(side * reach)[0]) for side in (-1.0, 1.0)))

    def loads(self, q: Array, velocity: Array, theta: Array, motor_velocity: Array) -> tuple[Array, Array]:
        """Spring torques tau_e [N m] and the link accelerations qdd [rad/s^2] under them, (n,) each."""
        tau_e, _, _ = self.spring_state(q - theta)
        return tau_e, self.link_acceleration(q, velocity, -tau_e)

    def deflection(self, spring_torque: Array) -> Array:
        """phi (n,) [rad] with spring torques tau_e (n,) [N m]. Raises ParameterError where there is none."""
        each = zip(self.springs, spring_torque / self.spring_scale, self.presets, strict=True)
        return np.array([spring.inverse(float(torque), float(preset)) for spring, torque, preset in each])

    def accelerations(
        self, q: Array, velocity: Array, theta: Array, motor_velocity: Array, torque: Array, external: Array
    ) -> tuple[Array, Array]:
        """qdd and thdd (n,) [rad/s^2] under motor torques `torque` and `external` (n,) [N m] on the links."""
        rates = self.rates(np.stack([q, velocity, theta, motor_velocity]), torque, external)
        return rates[1], rates[3]

    def rates(self, state: Array, torque: Array, external: Array) -> Array:
        """Time derivative (4, n) of `state`, rows q, qd, theta, thd [rad, rad/s]; torques as in `accelerations`."""
        out = np.empty_like(state)
        links = _rates(
            self._kinds, self._rows, self.spring_scale, self.presets, self.motor_inertia, self.motor_friction,
            self.link_friction, state, torque, external, out,
        )  # fmt: skip
        out[1] = pinocchio.aba(self.model, self._data, state[0], state[1], links)
        return out

    def gravity_slope(self, q: Array) -> Array:
        """dg/dq (n, n) [N m/rad], symmetric."""
        slope = np.array(pinocchio.computeGeneralizedGravityDerivatives(self.model, self._data, q))
        return 0.5 * (slope + slope.T)

    def hanging(self, theta: Array) -> Array:
        """Link angles (n,) [rad] at rest with the motors at `theta` (n,) [rad]: the solution found from q = theta.

        Raises ParameterError without solution, e.g. for springs too soft for the weight of the arm.
        """

        def forces(q: Array) -> tuple[Array, Array]:
            tau_e, stiffness, _ = self.spring_state(q - theta)
            return self.gravity(q) + tau_e, self.gravity_slope(q) + np.diag(stiffness)

        from scipy.optimize import root  # takes 0.2 s to import

        found = root(forces, theta, jac=True, options={"xtol": 1e-14})
        q = np.asarray(found.x)
        if np.abs(forces(q)[0]).max() > BALANCE or not (np.abs(q - theta) <= self._stops).all():
            raise ParameterError(f"no equilibrium with the motors at {theta} rad")
        return q

    def rest(self, q: Array) -> Array:
        """Motor angles (n,) [rad] that hold the links at `q` (n,) [rad] against gravity."""
        return q - self.deflection(-self.gravity(q))


def vsa_arm_names() -> tuple[str, ...]:
    """Names of the shipped arms, sorted."""
    return shipped_names("vsa_arms")


def arm_file(name_or_path: str | Path) -> VsaArmFile:
    """Contents of the file of a shipped arm, or of the arm of a YAML file. Raises DeviceError."""
    return read_record(VsaArmFile, name_or_path, "vsa_arms", DeviceError)[1]


def load_vsa_arm(name_or_path: str | Path) -> VsaArm:
    """The shipped arm of that name, or the arm of a YAML file. Raises DeviceError."""
    path, file, model = read_arm(VsaArmFile, "vsa_arms", name_or_path)
    return _built(path.name, file, model)


def _built(shown: str, file: VsaArmFile, model: pinocchio.Model) -> VsaArm:
    found, wanted = list(model.names)[1:], [joint.name for joint in file.joints]
    if found != wanted:
        raise DeviceError(f"{shown}: joints: {file.urdf} has {found}, this file has {wanted}")
    if model.nq != model.nv:
        raise DeviceError(f"{shown}: {file.urdf} has continuous joints, which springs cannot drive")
    motors = [joint.motor for joint in file.joints]
    if not model.existFrame(file.tip):
        raise DeviceError(f"{shown}: tip: {file.urdf} has no link '{file.tip}'")
    if any(motor.coulomb_friction for motor in motors):
        raise DeviceError(f"{shown}: joints: Coulomb friction of motors is not modelled here")

    def limit(name: str) -> Any:
        return [inf if getattr(motor, name) is None else getattr(motor, name) for motor in motors]

    return VsaArm(
        name=file.name,
        model=model,
        tip=file.tip,
        springs=tuple(joint.spring for joint in file.joints),
        presets=np.array([joint.preset for joint in file.joints]),
        motor_inertia=np.array([motor.inertia for motor in motors]),
        motor_friction=np.array([motor.viscous_friction for motor in motors]),
        link_friction=np.array([joint.link_friction for joint in file.joints]),
        torque_limit=np.array(limit("torque_limit")),
        speed_limit=np.array(limit("speed_limit")),
    )
