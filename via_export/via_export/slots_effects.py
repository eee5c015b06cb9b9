"""The table of slots, first part: one line per effect, or per case of an effect. The first line that applies counts."""

from __future__ import annotations

from math import isfinite

from via_sim.effects import Effect
from via_sim.joint.parameters import P

from via_export.slots import FEEDFORWARD, INTEGRAL, by_levers, position_drive, row, servo
from via_export.target import Target

READING = "- apply it where you read the encoder"
FOLLOWS = "friction does not follow the load, and does not increase at standstill"
UNKNOWN_LOAD = "- friction does not follow a load, and without gravity no mean load is known: it is left out"
NO_LINK_SPRING = "- add its torque at run time"
RIGID_SPRING = "- joints are rigid: the effect vanishes with the spring"


def _lasting(_target: Target, effect: Effect | None) -> bool:
    return effect is not None and effect.parameters["start"] <= 0.0 and effect.parameters["stop"] >= 1e6


def _with_lag(target: Target, _effect: Effect | None) -> bool:
    slews = isfinite(target.row[P.drive_speed_limit])
    return position_drive(target, None) and (slews or float(target.row[P.integral_rate]) > 0.0)


def _sensed(_target: Target, effect: Effect | None) -> bool:
    return effect is not None and effect.site == "sensor"


def _levered_hardening(target: Target, effect: Effect | None) -> bool:
    return by_levers(target, None) and effect is not None and effect.parameters["hardening"] != 0.0


def _unloaded(target: Target, _effect: Effect | None) -> bool:
    return target.gravity_torque == 0.0


def _rigid(target: Target, _effect: Effect | None) -> bool:
    return target.device.n_transmissions == 0


def _on_unloaded_link(target: Target, effect: Effect | None) -> bool:
    return _unloaded(target, effect) and _on_rigid_link(target, effect)


def _on_rigid_link(target: Target, effect: Effect | None) -> bool:
    return effect is not None and effect.site == "link" and target.device.n_motors == 0


EFFECT_ROWS = (
    row(
        "coulomb_friction",
        mjcf="= joint frictionloss", urdf="= joint dynamics/friction", sdf="= axis dynamics/friction",
        isaaclab="= friction and dynamic_friction [N m] (Isaac Sim 5)", bam="= friction_base",
    ),
    row(
        "asymmetric_coulomb",
        mjcf="= frictionloss of the mean, and half the difference as a constant torque (passive dcmotor, 0 poles)",
        isaaclab="~ friction of the mean | half the difference as a constant torque is missing",
        bam="~ friction_base of the mean | half the difference as a constant torque is missing",
        others="~ dynamics/friction of the mean | half the difference as a constant torque is missing",
    ),
    row(
        "stribeck_friction",
        mjcf="= passive dcmotor lugre; the joint yields a microradian before it slides, or what a time step resolves",
        isaaclab="~ friction (breakaway), dynamic_friction (kinetic) | a step at rest in place of the decay with speed",
        bam="= friction_base, friction_stribeck, dtheta_stribeck, alpha 2",
        others="~ dynamics/friction, kinetic | no higher friction at rest: no stick-slip",
    ),
    row(
        "viscous_friction",
        mjcf="= joint damping", urdf="= joint dynamics/damping", sdf="= axis dynamics/damping",
        isaaclab="= viscous_friction [N m s/rad] (Isaac Sim 5)", bam="= friction_viscous",
    ),
    row(
        "asymmetric_viscous",
        mjcf="~ joint damping of the mean | damping polynomials are odd: half the difference times |v| is missing",
        isaaclab="~ viscous_friction of the mean | half the difference times |v| is missing",
        bam="~ friction_viscous of the mean | half the difference times |v| is missing",
        others="~ dynamics/damping of the mean | half the difference times |v| is missing",
    ),
    row(
        "quadratic_drag",
        mjcf="= joint damping, second coefficient",
        others="- coefficient v^2 is missing: too little damping at high speed",
    ),
    row(
        "presliding_friction",
        mjcf="= passive dcmotor lugre with equal friction at rest and in motion, which is Dahl's equation",
        isaaclab="~ friction and dynamic_friction | sticks without a bristle: no hysteresis in small motion",
        bam="~ friction_base | sticks without a bristle: no hysteresis in small motion",
        others="~ dynamics/friction | sticks without a bristle: no hysteresis in small motion",
    ),
    row(
        "load_dependent_friction", "on the link of a rigid joint, without gravity", _on_unloaded_link,
        bam="= load_friction_motor, load_friction_external and their stribeck and quad (models m5, m6)",
        others=UNKNOWN_LOAD,
    ),
    row(
        "load_dependent_friction", "on the link of a rigid joint", _on_rigid_link,
        mjcf=f"~ frictionloss at the mean gravity load | {FOLLOWS}",
        isaaclab=f"~ friction at the mean gravity load | {FOLLOWS}",
        bam="= load_friction_motor, load_friction_external and their stribeck and quad (models m5, m6)",
        others=f"~ dynamics/friction at the mean gravity load | {FOLLOWS}",
    ),
    row(
        "load_dependent_friction", "elsewhere, without gravity", _unloaded,
        bam="~ load_friction_motor of the joint | the load of the joint in place of that of the motor",
        others=UNKNOWN_LOAD,
    ),
    row(
        "load_dependent_friction", "elsewhere",
        mjcf=f"~ frictionloss at the mean gravity load | {FOLLOWS}",
        isaaclab=f"~ friction at the mean gravity load | {FOLLOWS}",
        bam="~ load_friction_motor of the joint | the load of the joint in place of that of the motor",
        others=f"~ dynamics/friction at the mean gravity load | {FOLLOWS}",
    ),
    row(
        "backlash", "spring between levers", by_levers,
        mjcf="- spatial tendons have no dead band of an angle: the joint has no play",
        sdf="- springs have no dead band: the joint has no play", others=RIGID_SPRING,
    ),
    row(
        "backlash",
        mjcf="= dead band of the tendon's springlength; exact, without the additional body of a second limited hinge",
        sdf="- springs have no dead band: the joint has no play", others=RIGID_SPRING,
    ),
    row(
        "hysteresis",
        mjcf="= fixed tendon with stiffness and springyield",
        sdf="- no plastic spring: loading and unloading have the same torque", others=RIGID_SPRING,
    ),
    row(
        "spring_damping",
        mjcf="= tendon damping", sdf="= dynamics/damping of the spring's joint", others=RIGID_SPRING,
    ),
    row(
        "spring_law", "hardening of a spring between levers", _levered_hardening,
        mjcf="~ scale alone, as stiffness of the spatial tendon | the hardening is missing",
        sdf="~ stiffness at rest | the hardening is missing", others=RIGID_SPRING,
    ),
    row(
        "spring_law",
        mjcf="= stiffness of the tendons", sdf="~ spring_stiffness times scale | the hardening is missing",
        others=RIGID_SPRING,
    ),
    row(
        "stiffness_drift",
        mjcf="- models do not change with time: write a new model per temperature or hour",
        sdf="- models do not change with time", others=RIGID_SPRING,
    ),
    row(
        "preset_error",
        mjcf="= springlength of the tendon", sdf="= spring_reference", others=RIGID_SPRING,
    ),
    row(
        "gear_error",
        mjcf="- the gear turns evenly: no torque that is periodic in the motor angle and grows with the load",
        sdf="- the gear turns evenly", others=RIGID_SPRING,
    ),
    row(
        "joint_coupling",
        mjcf="- needs the neighbour: add its torque with qfrc_applied, or an actuator per joint",
        isaaclab="- add the neighbour's torque to the effort", bam="- one joint only",
        others="- no torque between joints",
    ),
    row(
        "torque_gain", "of a sensor", _sensed,
        others=READING, ros2_control="- scale the effort in the hardware component",
    ),
    row(
        "torque_gain",
        mjcf="= actuator gainprm; of a position drive its gains and forcerange",
        urdf="~ limit/effort times gain | commands themselves are not scaled",
        sdf="~ limit/effort times gain; of a position drive p_gain and d_gain | torque commands are not scaled",
        isaaclab="~ effort_limit times gain; of a position drive stiffness, damping | torque commands are not scaled",
        bam="= kt/R, with --supply",
        ros2_control="~ limits of the command times gain | commands themselves are not scaled",
    ),
    row(
        "torque_bias", "of a sensor", _sensed,
        others=READING, ros2_control="- add it to the effort in the hardware component",
    ),
    row(
        "torque_bias",
        mjcf="= actuator biasprm", urdf="- add it to the commanded torque",
        sdf="- add it to the commanded torque; of a position drive cmd_offset",
        isaaclab="- add it to the effort target", bam="- a constant torque is missing",
        ros2_control="- add it to the command",
    ),
    row(
        "torque_ripple",
        mjcf="= one passive dcmotor cogging per harmonic",
        isaaclab="- the joint turns evenly; a custom actuator class can add it", others="- the joint turns evenly",
    ),
    row(
        "torque_saturation", "of a servo: its speed", servo,
        mjcf="= forcerange of the servo, most of whose damping is compensated below the limit",
        isaaclab="= velocity_limit", bam="- speed is limited by the supply alone", others="= limit/velocity",
        ros2_control="= joint_limits max_velocity",
    ),
    row(
        "torque_saturation",
        mjcf="= actuator ctrlrange; of a position drive forcerange", urdf="= limit/effort",
        sdf="= limit/effort; of a position drive cmd_max", isaaclab="= effort_limit", bam="= kt/R, with --supply",
        ros2_control="= command_interface min, max; joint_limits max_effort",
    ),
    row(
        "torque_deadband",
        isaaclab="- small commands act; a custom actuator class can add it",
        others="- small commands act; apply it to the command",
    ),
    row(
        "dead_zone",
        isaaclab="- torques act in full; a custom actuator class can subtract it",
        others="- torques act in full; subtract it from them",
    ),
    row(
        "position_gain",
        mjcf="= kp of the actuator", urdf="- gains belong to the controller", sdf="= JointPositionController p_gain",
        isaaclab="= stiffness", bam="- the gain of the firmware belongs to the actuator class",
        ros2_control="= pid_controller gain p",
    ),
    row(
        "velocity_feedforward", "", None, **FEEDFORWARD,
    ),
    row(
        "integral_action", "", None, **INTEGRAL,
    ),
    row(
        "position_deadband",
        isaaclab="- small errors are corrected; a custom actuator class can add it",
        others="- small errors are corrected",
    ),
    row(
        "actuator_lag", "with a speed limit or integral action", _with_lag,
        mjcf="- an actuator has a filter or a slew rate and an integral, not both: the goal leads by the time constant",
        isaaclab="~ delay longer by the time constant | a delay in place of a filter",
        bam="~ command_delay longer by the time constant | a delay in place of a filter",
        others="- commands act at once",
    ),
    row(
        "actuator_lag",
        mjcf="= actuator dyntype filterexact; of a servo a lower bandwidth",
        isaaclab="~ delay longer by the time constant | a delay in place of a filter",
        bam="~ command_delay longer by the time constant | a delay in place of a filter",
        others="- commands act at once",
    ),
    row(
        "actuator_delay",
        mjcf="= actuator delay, in whole time steps",
        isaaclab="= DelayedPDActuatorCfg min_delay, max_delay, in whole physics steps", bam="= command_delay",
        others="- commands act at once",
    ),
    row(
        "speed_limit",
        mjcf="= dynprm of an actuator of gaintype pid", isaaclab="~ velocity_limit | limits the joint and not its goal",
        bam="- the goal is reached at once", others="~ limit/velocity | limits the joint and not its goal",
        ros2_control="= joint_limits max_velocity of a position command",
    ),
    row(
        "encoder_offset",
        mjcf="= joint ref; coordinates of the model are those of the encoder",
        urdf="~ joint origin | turns the link by the offset",
        sdf="~ pose of the link; in a given model by hand | turns the link by the offset",
        isaaclab=READING, bam="= q_offset", ros2_control="= transmission joint/offset",
    ),
    row(
        "encoder_eccentricity",
        others=READING, ros2_control=READING,
    ),
    row(
        "encoder_quantisation",
        others=READING, ros2_control=READING,
    ),
    row(
        "channel_skew",
        mjcf="= sensor delay, in whole time steps", others=READING, ros2_control=READING,
    ),
    row(
        "payload",
        mjcf="= inertial of the link; in a given model a body",
        isaaclab="~ armature | the weight is missing: change the mass in the USD file",
        bam="~ armature | the weight is missing: change the mass of the test bench",
        others="= inertial of the link; in a given model a link",
    ),
    row(
        "link_inertia",
        mjcf="= inertial of the link; in a given model armature", isaaclab="= armature", bam="= armature",
        sdf="= inertial of the link; in a given model by hand", others="= inertial of the link",
    ),
    row(
        "gravity_error",
        mjcf="= inertial of the link, its centre of mass; in a given model by hand",
        urdf="= inertial of the link, its origin; in a given model by hand",
        sdf="= inertial of the link, its pose; in a given model by hand",
        isaaclab="- change the centre of mass in the USD file",
        bam="- change the mass of the test bench",
    ),
    row(
        "link_spring", "of a rigid joint", _rigid,
        mjcf="= joint stiffness and springref", sdf="= axis dynamics/spring_stiffness and spring_reference",
        others=NO_LINK_SPRING,
    ),
    row(
        "link_spring", "of a joint with springs",
        mjcf="= joint stiffness and springref of the link", others=NO_LINK_SPRING,
    ),
    row(
        "contact",
        mjcf="= joint range with solreflimit and the smallest impedance", urdf="~ limit lower or upper | a rigid wall",
        sdf="= axis limit with stiffness and dissipation",
        isaaclab="- add a collision body or a joint limit in the USD file", bam="- no walls",
        ros2_control="~ joint_limits position | commands end there, the joint does not",
    ),
    row(
        "external_torque", "acting all the time", _lasting,
        mjcf="= passive dcmotor, 0 poles", bam="- a constant torque is missing", others="- apply it at run time",
    ),
    row(
        "external_torque", "from start to stop",
        mjcf="- apply it at run time: qfrc_applied", isaaclab="- apply it at run time: set_external_force_and_torque",
        bam="- a torque pulse is missing", others="- apply it at run time",
    ),
    row(
        "device_numbers",
        others="= the numbers themselves", ros2_control="= the numbers themselves",
    ),
)  # fmt: skip
