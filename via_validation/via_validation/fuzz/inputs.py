"""Files to damage: the shipped ones and generated ones, with the public functions that read them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from via_core.bags.mapping import load_mapping
from via_core.command_files import read_motion
from via_core.devices import device_names, load_device
from via_core.recordings.tables import read_tables
from via_core.robots.models import read_robot
from via_core.vsa_arms import load_vsa_arm
from via_gap.run.arm_model import load_arm
from via_sim.effects import Effect
from via_sim.effects.files import effects_text, load_effects
from via_sim.plants import JointPlant
from via_sim.simulate import simulate

from via_validation.fuzz.bags import read_bag, sample_bag
from via_validation.fuzz.reports import read_whole_report, sample_report

TICKS = 5  # of a simulation with a damaged device
TOKENS = (
    b"0", b"-1", b"1e308", b"1e-308", b".nan", b".inf", b"9" * 30, b"[", b"]", b"{", b"}", b"&a ", b"*a", b"<<: ",
    b"null", b"!!bool x", b"!!timestamp x", b"!!binary x", b"\x1b[2J", b"\0", b"\xff\xff\xff\xff", b"../",
    b"string[1000000]",
)  # fmt: skip


MJCF = """<mujoco model="arm">
  <default><joint damping="0.1" frictionloss="0.02" armature="0.001"/></default>
  <worldbody>
    <body name="upper">
      <joint name="shoulder" type="hinge" axis="0 1 0" range="-90 90"/>
      <inertial pos="0 0 -0.1" mass="0.5" diaginertia="0.002 0.002 0.0004"/>
      <body name="lower" pos="0 0 -0.2">
        <joint name="elbow" type="hinge" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.3"/>
      </body>
    </body>
  </worldbody>
  <actuator><position joint="shoulder" kp="20" forcerange="-2 2"/><motor joint="elbow" gear="6"/></actuator>
</mujoco>
"""


class Kind(NamedTuple):
    """One kind of file: ending, originals, and the function that reads a file."""

    ending: str
    originals: tuple[bytes, ...]
    read: Callable[[Path], Any]
    beside: Mapping[str, bytes] = {}  # sound files in the same folder, by name


def kinds() -> dict[str, Kind]:
    """Kinds of files by name."""
    core = files("via_core")
    devices = tuple(core.joinpath("devices", f"{name}.yaml").read_bytes() for name in device_names())
    mappings = tuple(each.read_bytes() for each in core.joinpath("mappings").iterdir() if each.name.endswith(".yaml"))
    effects = [Effect("coulomb_friction", "link", {"torque": 0.02}), Effect("torque_gain", "motor", {"gain": 0.9}, 1)]
    commands = "time,motor_1,motor_2\n" + "".join(f"{1e-3 * k:g},{0.1 * k:g},0\n" for k in range(20))
    return {
        "device": Kind(".yaml", devices, _device),
        "mapping": Kind(".yaml", mappings, load_mapping),
        "effects": Kind(".yaml", (effects_text(effects).encode(),), load_effects),
        "commands": Kind(".csv", (commands.encode(),), lambda path: read_motion(path, load_device("cubic_demo"))),
        "recording": Kind(".csv", (_recording().encode(),), read_tables),
        "bag": Kind(".mcap", (sample_bag(),), read_bag),
        "arm": Kind(".yaml", _contents("vsa_arms", ".yaml"), load_vsa_arm, _beside("vsa_arms")),
        "rigid arm": Kind(".yaml", _contents("arms", ".yaml"), load_arm, _beside("arms")),
        "URDF": Kind(".urdf", _contents("arms", ".urdf") + _contents("vsa_arms", ".urdf"), read_robot),
        "MJCF": Kind(".xml", (MJCF.encode(),), read_robot),
        "report": Kind(".json", (sample_report(),), read_whole_report),
    }


def damaged(rng: np.random.Generator, original: bytes) -> bytes:
    """The file with one to four random changes."""
    data = bytearray(original)
    for _ in range(rng.integers(1, 5)):
        begin, end = np.sort(rng.integers(0, len(data) + 1, 2)).tolist()
        end = min(end, begin + int(rng.integers(1, 40)))
        change = int(rng.integers(5))
        if change == 0 and begin < len(data):
            data[begin] ^= 1 << int(rng.integers(8))
        elif change == 1:
            del data[begin:end]
        elif change == 2:
            data[begin:begin] = data[begin:end] * int(rng.integers(1, 50))
        elif change == 3:
            data[begin:end] = TOKENS[rng.integers(len(TOKENS))]
        else:
            data[begin:end] = rng.bytes(end - begin)
    return bytes(data)


def _contents(folder: str, ending: str) -> tuple[bytes, ...]:
    """Shipped files of a folder with this ending."""
    there = sorted(files("via_core").joinpath(folder).iterdir(), key=lambda each: each.name)
    return tuple(each.read_bytes() for each in there if each.name.endswith(ending))


def _beside(folder: str) -> dict[str, bytes]:
    there = files("via_core").joinpath(folder).iterdir()
    return {each.name: each.read_bytes() for each in there if each.name.endswith(".urdf")}


def _recording() -> str:
    rows = "".join(f"{0.01 * k:.2f};{np.sin(0.1 * k):.4f};{10 * k};[{k}, 2];on\n" for k in range(30))
    return f"# a robot\ntime [s];elbow position [rad];count;list;state\n{rows}"


def _device(path: Path) -> None:
    device = load_device(path)
    simulate(JointPlant.from_device(device), None, TICKS / 1000.0, 1000.0)
