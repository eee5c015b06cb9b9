"""The table of slots, second part: the entries of a device file."""

from __future__ import annotations

from math import prod

from via_core.springs import LinearSpring
from via_sim.effects import Effect

from via_export.slots import FEEDFORWARD, INTEGRAL, by_levers, position_drive, row, servo
from via_export.target import Target

CONSTANT = "stiffness does not change with the deflection or the preset"
RIGID = "no deflection and no resonance; motors and link are one inertia"


def _plain_springs(target: Target, _effect: Effect | None) -> bool:
    return target.device.n_transmissions > 0 and not by_levers(target, None)


def _linear(target: Target, _effect: Effect | None) -> bool:
    return _plain_springs(target, None) and all(isinstance(spring, LinearSpring) for spring in target.device.springs)


def _torque_motors(target: Target, _effect: Effect | None) -> bool:
    return target.device.n_motors > 0 and not servo(target, None)


def _with_damper(target: Target, _effect: Effect | None) -> bool:
    return target.device.damper is not None


def _speed_limited(target: Target, _effect: Effect | None) -> bool:
    return any(motor.speed_limit is not None for motor in target.device.torque_motors)


def _weighs(target: Target, _effect: Effect | None) -> bool:
    return target.device.link.gravity_torque != 0.0


def _scaled(target: Target, _effect: Effect | None) -> bool:
    """Whether the torque scale of the file, with the factor that a diagnosis fitted, is not 1."""
    factors = (effect.parameters.get("torque scale", 1.0) for effect in target.effects)
    return prod(factors, start=target.device.torque_scale) != 1.0


def _follows_speed(target: Target, _effect: Effect | None) -> bool:
    return target.device.servo is not None and target.device.servo.feedforward > 0.0


def _integrates(target: Target, _effect: Effect | None) -> bool:
    return target.integral_gain > 0.0


def _position_limited(target: Target, limited: str) -> bool:
    drive = target.device.servo
    return drive is not None and drive.torque_limit is not None and drive.limited == limited


_WHOLE = "the limit includes kd times the speed"
DEVICE_ROWS = (
    row(
        "link: inertia",
        mjcf="= inertial of the link; in a given model unchanged", isaaclab="- comes with the USD file",
        bam="= armature", others="= inertial",
    ),
    row(
        "link: gravity", "", _weighs,
        mjcf="= inertial of the link", isaaclab="- comes with the USD file",
        bam="- mass and length come with the test bench", others="= inertial",
    ),
    row(
        "link: friction",
        mjcf="= damping, frictionloss", urdf="= dynamics", sdf="= axis dynamics",
        isaaclab="= friction, dynamic_friction, viscous_friction", bam="= friction_base, friction_viscous",
    ),
    row(
        "motors", "torque drive behind springs", _torque_motors,
        mjcf="= a body with a hinge each", urdf=f"~ inertia and friction added to the link | {RIGID}",
        sdf="= a link each between base and link; of two motors their sum",
        others=f"~ armature and friction added to the joint | {RIGID}",
    ),
    row(
        "motors", "servo", servo,
        mjcf="= position actuator on a heavy body", urdf=f"- {RIGID}; the joint itself is commanded",
        sdf="~ a link with the link's inertia under a JointPositionController | the load moves the servo",
        isaaclab=f"~ stiffness and damping of the same bandwidth | {RIGID}; the load moves the servo", bam=f"- {RIGID}",
        ros2_control="= position command interface",
    ),
    row(
        "springs", "linear", _linear,
        mjcf="= tendon stiffness", sdf="= spring_stiffness, spring_reference of a second joint", others=f"- {RIGID}",
    ),
    row(
        "springs", "of other form", lambda t, e: _plain_springs(t, e) and not _linear(t, e),
        mjcf="= a sum of tendons with dead bands: a cubic spline, accurate to 0.1 %",
        sdf=f"~ stiffness at half of the stop | {CONSTANT}", others=f"- {RIGID}",
    ),
    row(
        "springs", "between levers", by_levers,
        mjcf="= spatial tendon between the levers",
        sdf=f"~ stiffness at half of the stop, of two levers at rest | {CONSTANT}", others=f"- {RIGID}",
    ),
    row(
        "second motor", "antagonistic or serial", lambda t, _e: t.device.n_motors == 2,
        mjcf="= a body of its own", others="- one motor per joint: the preset cannot be commanded",
        ros2_control="= a joint with its own command",
    ),
    row(
        "damper", "", _with_damper,
        mjcf="= actuator whose gain is the velocity; the control is the damping command",
        isaaclab="~ viscous_friction at command 0 | damping cannot be commanded",
        bam="~ friction_viscous at command 0 | damping cannot be commanded",
        others="~ dynamics/damping at command 0 | damping cannot be commanded",
        ros2_control="= command interface 'damping'",
    ),
    row(
        "motors: torque_limit", "", lambda t, _e: not servo(t, None) and not position_drive(t, None),
        mjcf="= ctrlrange", isaaclab="= effort_limit", bam="= kt/R, with --supply",
        others="= limit/effort", ros2_control="= command_interface min, max; max_effort",
    ),
    row(
        "motors: speed_limit", "", _speed_limited,
        mjcf="- speed is not limited: keep commands within the limit", isaaclab="= velocity_limit",
        bam="- speed is limited by the supply alone", others="= limit/velocity",
        ros2_control="= joint_limits max_velocity",
    ),
    row(
        "torque_scale", "", _scaled,
        mjcf="= actuator gainprm", urdf="~ limit/effort times scale | commands themselves are not scaled",
        sdf="~ limit/effort times scale | torque commands are not scaled",
        isaaclab="~ effort_limit times scale | torque commands are not scaled", bam="= kt/R, with --supply",
        ros2_control="~ limits of the command times scale | commands themselves are not scaled",
    ),
    row(
        "servo: kp, kd", "position drive", position_drive,
        mjcf="= actuator gain, bias and damping", urdf="- gains belong to the controller",
        sdf="~ JointPositionController p_gain, d_gain | d_gain also acts on the speed of the goal",
        isaaclab="= stiffness, damping",
        bam="= kt and R with --supply; the gain of the firmware belongs to the actuator class",
        ros2_control="= pid_controller gains p, d",
    ),
    row(
        "servo: feedforward", "position drive", _follows_speed, **FEEDFORWARD,
    ),
    row(
        "servo: ki", "position drive", _integrates, **INTEGRAL,
    ),
    row(
        "servo: torque_limit", "limited: proportional", lambda t, _e: _position_limited(t, "proportional"),
        mjcf="= forcerange; kd is the damping of the actuator", urdf="= limit/effort", bam="= kt/R, with --supply",
        sdf=f"~ cmd_max, cmd_min | {_WHOLE}", isaaclab=f"~ effort_limit | {_WHOLE}",
        ros2_control=f"~ command_interface min, max; max_effort | {_WHOLE}",
    ),
    row(
        "servo: torque_limit", "limited: sum", lambda t, _e: _position_limited(t, "sum"),
        mjcf="= forcerange", urdf="= limit/effort", bam="~ kt/R, with --supply | kd times the speed is not limited",
        sdf="= cmd_max, cmd_min", isaaclab="= effort_limit", ros2_control="= command_interface min, max; max_effort",
    ),
    row(
        "servo: switched off", "position drive", position_drive,
        mjcf="~ actuator group disabled at run time | the damping kd remains unless actuator_damping is set to 0",
        isaaclab="- set the gains to 0", bam="= torque_enable of the log", others="- belongs to the controller",
        ros2_control="= deactivate the controller",
    ),
    row(
        "sensors: steps and noise",
        mjcf="- sensors are exact; round and add noise where you read them", sdf="- no encoder sensor",
        isaaclab="- add noise to the observations", others="- no sensors", ros2_control="- state interfaces are exact",
    ),
)  # fmt: skip
