"""Processor time of `via gap diagnose --arm` for arms of 1 to 7 joints of one kind, from one recording each.

The arm is a planar chain of equal links with gravity, from a URDF file; all joints have more dry friction than it says.
Their motion is a sum of sines, and torques are those that the bodies and the friction require, so that the recording
costs no simulation. The stages are those of the command: the arm of the model and its recording, the mass that all
joints feel, and each joint by itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time

import numpy as np
import pandas
import pinocchio
from via_core.signals import Array
from via_gap.run.arms import diagnose_arm, find_arm, read_arm_log

from via_validation.provenance import Provenance
from via_validation.template import rendered

COUNTS = (1, 2, 4, 7)
RATE, SECONDS = 500.0, 60.0  # [Hz], [s]
FIRST = 6.0  # [s] of a recording that is diagnosed before, in which code is compiled and loaded
LENGTH, MASS, INERTIA = 0.25, 1.2, 0.008  # [m], [kg], [kg m^2] of a link about its centre
VISCOUS, DRY = 0.2, 0.15  # [N m s/rad], [N m] of each joint in the file
MISSING = 0.3  # dry friction that the file lacks, over the root mean square of the joint's torque
SLOW = 0.02  # [rad/s] below which dry friction changes its sign
NOISE = 2e-5  # [rad] of the encoders
PAGE = "arm-cost.md"


@dataclass(frozen=True)
class Cost:
    """Times [s] of an arm: processor time of the stages, and wall time of all.

    causes  first cause of each joint
    """

    joints: int
    reading: float
    bodies: float
    diagnoses: float
    wall: float
    causes: tuple[str, ...]

    @property
    def processor(self) -> float:
        return self.reading + self.bodies + self.diagnoses

    @property
    def each(self) -> float:
        """[s] of processor time per joint."""
        return self.processor / self.joints


def costs(counts: Sequence[int] = COUNTS, seconds: float = SECONDS) -> Iterator[Cost]:
    """The cost of arms with so many joints, from recordings of `seconds` [s]."""
    cost_of(2, FIRST)
    for count in counts:
        yield cost_of(count, seconds)


def cost_of(joints: int, seconds: float) -> Cost:
    """The cost of one arm."""
    with TemporaryDirectory() as place:
        model, recording = Path(place) / "arm.urdf", Path(place) / "arm.parquet"
        model.write_text(urdf(joints), encoding="utf-8")
        table(joints, seconds).to_parquet(recording)
        wall, begin = perf_counter(), process_time()
        arm = find_arm(str(model), recording)
        log = read_arm_log(recording, arm)
        read = process_time()
        stages: list[float] = []  # begin of the search for a mass, of the first joint, and of its stages

        def notice(_what: str, _share: float) -> None:
            stages.append(process_time())

        found = diagnose_arm(arm, [log], progress=notice)
        end = process_time()
        causes = tuple(each.causes[0].effect if each.causes else each.verdict for each in found.reports)
        return Cost(joints, read - begin, stages[1] - read, end - stages[1], perf_counter() - wall, causes)


def urdf(joints: int) -> str:
    """The planar chain; its links hang along -z."""
    lines = ['<robot name="chain">', '<link name="link_0"/>']
    for k in range(1, joints + 1):
        away = 0.0 if k == 1 else -LENGTH
        lines += [
            f'<joint name="joint_{k}" type="revolute"><parent link="link_{k - 1}"/><child link="link_{k}"/>',
            f'<origin xyz="0 0 {away}"/><axis xyz="0 -1 0"/><limit lower="-3" upper="3" effort="90" velocity="9"/>',
            f'<dynamics damping="{VISCOUS}" friction="{DRY}"/></joint>',
            f'<link name="link_{k}"><inertial><origin xyz="0 0 {-0.5 * LENGTH}"/><mass value="{MASS}"/>',
            f'<inertia ixx="{INERTIA}" iyy="{INERTIA}" izz="{INERTIA}" ixy="0" ixz="0" iyz="0"/></inertial></link>',
        ]
    return "\n".join([*lines, "</robot>"])


def table(joints: int, seconds: float, seed: int = 1) -> pandas.DataFrame:
    """The recording: time, and position, velocity and effort of each joint, named as in joint states."""
    time = np.arange(round(seconds * RATE)) / RATE
    q, v, a = _motion(time, joints)
    model = pinocchio.buildModelFromXML(urdf(joints))
    data = model.createData()
    bodies = np.array([pinocchio.rnea(model, data, *each) for each in zip(q, v, a, strict=True)])
    dry = DRY + MISSING * np.sqrt(np.mean(bodies**2, axis=0))
    torque = bodies + VISCOUS * v + dry * np.tanh(v / SLOW)
    read = q + np.random.default_rng(seed).normal(0.0, NOISE, q.shape)
    columns = {"time": time}
    for k in range(joints):
        columns |= {f"joint_{k + 1}_position": read[:, k], f"joint_{k + 1}_effort": torque[:, k]}
    return pandas.DataFrame(columns)


def _motion(time: Array, joints: int) -> tuple[Array, Array, Array]:
    """Angles, velocities and accelerations (N, n each) of sums of sines; joints differ by their phases."""
    q, v, a = (np.zeros((len(time), joints)) for _ in range(3))
    for amplitude, frequency in ((0.5, 0.21), (0.3, 0.53), (0.1, 1.1)):
        w = 2.0 * np.pi * frequency
        angle = w * time[:, None] + 1.3 * frequency * np.arange(joints) + np.arange(joints)
        q += amplitude * np.sin(angle)
        v += amplitude * w * np.cos(angle)
        a -= amplitude * w**2 * np.sin(angle)
    return q, v, a


def page(found: Sequence[Cost], source: Provenance, seconds: float = SECONDS) -> str:
    """The page as Markdown."""
    return rendered("bench/joints.md", {"costs": found, "rate": RATE, "seconds": seconds, "source": source})
