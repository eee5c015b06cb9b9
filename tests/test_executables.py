"""Every executable: `ros2 run` finds it, and it starts, publishes and ends cleanly on SIGINT and on SIGTERM.

The list of executables comes from the setup.py files. NEEDS lists the parameters and inputs that they need to publish.
"""

from __future__ import annotations

import os
import runpy
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from via_core.bags.writer import BagWriter
from via_core.devices import device_names, load_device
from via_estimators.methods import METHODS, methods_for
from via_ros import qos
from via_ros.conversions import JointStateWriter
from via_ros.interfaces import message_class

ROOT = Path(__file__).resolve().parent.parent
DEVICE = load_device("cubic_aa_vsa")
DEVICES = [load_device(name) for name in device_names()]
SAMPLES = "/joint_states"
COMMON = {"/rosout", "/parameter_events"}


@dataclass(frozen=True)
class Needs:
    """What an executable needs before it publishes."""

    parameters: tuple[str, ...] = ()
    samples: bool = False  # needs messages on /joint_states


NEEDS = {
    "recorder": Needs(("bag:={folder}/new", "topics:=[/joint_states]")),
    "player": Needs(("bag:={folder}/bag", "rate:=0.1")),
    "estimator": Needs((f"device:={DEVICE.name}",), samples=True),
    **dict.fromkeys(("excitation", "commanded_torque"), Needs((f"device:={DEVICE.name}",), samples=True)),
    # Any device that the method supports, with the name and so the joint names of DEVICE.
    **{
        method: Needs(
            (f"device:={DEVICE.name}={next(each for each in DEVICES if method in methods_for(each)).name}",), True
        )
        for method in METHODS
    },
    "estimator_bank": Needs((f"device:={DEVICE.name}",), samples=True),
    "gap_monitor": Needs((f"device:={DEVICE.name}",)),
    "simulator": Needs((f"device:={DEVICE.name}",)),
    "payload": Needs(("arm:=reference_2dof",)),
    "arm_simulator": Needs(("arm:=reference_2dof",)),
    "modal_limit_cycle": Needs(("arm:=reference_2dof", "equilibrium:=[0.3, 0.9]")),
    **dict.fromkeys(("bang_bang_joint", "equilibrium_preset"), Needs((f"device:={DEVICE.name}",), samples=True)),
    "max_velocity": Needs((f"device:={DEVICE.name}=visco_elastic_demo",), samples=True),
    "bang_bang": Needs(("arm:=reference_2dof", "motors:=[0.3, 0.9]", "direction:=[1.0, 1.0]")),
}


def declared() -> Iterator[tuple[str, str]]:
    """(package, executable) of every console script in the setup.py files."""
    for file in sorted(ROOT.glob("via_*/setup.py")):
        setup: dict[str, Any] = {}
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("setuptools.setup", lambda **given: setup.update(given))  # noqa: B023
            patch.chdir(file.parent)
            runpy.run_path(str(file))
        for script in setup.get("entry_points", {}).get("console_scripts", ()):
            yield file.parent.name, script.partition("=")[0].strip()


EXECUTABLES = list(declared())
# Without control_msgs, which has no wheel, `dynamic_joint_states` does not start: see test_ros2_control.
NODES = [each for each in EXECUTABLES if each[1] not in ("via", "dynamic_joint_states")]


def where_ros2_run_looks(package: str, executable: str) -> list[Path]:
    prefixes = [Path(prefix) for prefix in os.environ["AMENT_PREFIX_PATH"].split(os.pathsep)]
    marked = [each for each in prefixes if (each / "share/ament_index/resource_index/packages" / package).is_file()]
    return [each / "lib" / package / executable for each in marked]


def installed(package: str, executable: str) -> Path:
    return next(path for path in where_ros2_run_looks(package, executable) if os.access(path, os.X_OK))


def test_the_list_is_not_empty():
    assert ("via_ros", "player") in EXECUTABLES
    assert len(EXECUTABLES) >= 6


@pytest.mark.parametrize(("package", "executable"), EXECUTABLES)
def test_ros2_run_finds_it(package, executable):
    paths = where_ros2_run_looks(package, executable)
    assert any(path.is_file() and os.access(path, os.X_OK) for path in paths), paths


def test_processes_import_the_packages_from_the_same_folders_as_tests():
    """numba caches kernels by path: otherwise every kernel would be compiled twice."""
    script = "import importlib.util, sys; print(*(importlib.util.find_spec(name).origin for name in sys.argv[1:]))"
    names = [file.parent.name for file in sorted(ROOT.glob("via_*/setup.py"))]
    done = subprocess.run([sys.executable, "-c", script, *names], capture_output=True, text=True, check=True)
    assert done.stdout.split() == [find_spec(name).origin for name in names]


METHODS_LOADED = """
import numpy as np
from via_core.devices import device_names, load_device
from via_estimators.contract import Live
from via_estimators.methods import METHODS, estimator_for, methods_for
devices = [load_device(name) for name in device_names()]
for method in METHODS:
    estimator = estimator_for(next(each for each in devices if method in methods_for(each)), method)
    Live(estimator).take(np.full((1, 1 + len(estimator.inputs)), np.nan))
"""
MONITOR_LOADED = f"""
from via_core.devices import load_device
from via_gap.run.comparison import warm_up
warm_up(load_device("{DEVICE.name}"))
"""

ARM_LOADED = """
from via_bringup.demo.reference import ARM
from via_validation.control.arm_run import Phase, run_arm
from via_validation.control.limit_cycle import limit_cycle_controller, start
run_arm(ARM, limit_cycle_controller(0), start(limit_cycle_controller(0)), (Phase(0.002),))
"""
ARMS = ("arm_simulator", "hopper_simulator", "modal_limit_cycle", "bang_bang", "hopping")
LOADED = {"gap_monitor": MONITOR_LOADED, **dict.fromkeys(ARMS, ARM_LOADED)}


@cache
def compiled(script):
    """Run `script` so that the kernels it calls are in the cache before a node with a timeout needs them."""
    subprocess.run([sys.executable, "-c", script], check=True)


@pytest.fixture(scope="module", autouse=True)
def _compiled():
    compiled(METHODS_LOADED)


@pytest.fixture
def folder(tmp_path):
    """A folder with one bag of ten samples."""
    writer = JointStateWriter(DEVICE)
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic(SAMPLES, "sensor_msgs/msg/JointState")
        for k in range(10):
            bag.write(SAMPLES, serialize_message(writer.stamped(k * 10**9)), log_time=k * 10**9)
    return tmp_path


def started(package, executable, folder, environment=None):
    parameters = [each.format(folder=folder) for each in NEEDS.get(executable, Needs()).parameters]
    options = [word for each in parameters for word in ("-p", each)]
    return subprocess.Popen(
        [installed(package, executable), "--ros-args", *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        stdin=subprocess.DEVNULL,
        text=True,
        cwd=folder,
        env=environment,
    )


def until_it_publishes(graph, process, samples):
    """Spin until the process has published on one of its own topics. Fails if the process ends before."""
    node = graph.node("tester")
    received, subscribed = [], set()
    writer, stimulus, time = JointStateWriter(DEVICE), None, 0
    writer.position[:] = 0.1
    writer.effort[1:] = 0.0
    if samples:
        stimulus = node.create_publisher(JointState, SAMPLES, qos.SAMPLES)

    def published():
        nonlocal time
        if process.poll() is not None:
            pytest.fail(f"ended with {process.returncode}: {process.stderr.read()}")
        for name, types in node.get_topic_names_and_types():
            own = [info for info in node.get_publishers_info_by_topic(name) if info.node_name != "tester"]
            hidden = "/_" in name  # topics of actions
            if own and not hidden and name not in COMMON | subscribed and not (samples and name == SAMPLES):
                subscribed.add(name)
                node.create_subscription(message_class(types[0]), name, received.append, qos.matching([]), raw=True)
        if stimulus is not None:
            time += 1_000_000
            stimulus.publish(writer.stamped(time))
        return bool(received)

    graph.until(published)


# The executables of the methods are the same node: each is started once, alternately with either signal.
BOTH = (signal.SIGINT, signal.SIGTERM)
CASES = [
    pytest.param(package, executable, number, id=f"{package}-{executable}-{number.name}")
    for at, (package, executable) in enumerate(NODES)
    for number in (BOTH if executable not in METHODS else BOTH[at % 2 : at % 2 + 1])
]


@pytest.mark.parametrize(("package", "executable", "number"), CASES)
def test_starts_publishes_and_ends_cleanly(graph, folder, package, executable, number):
    if executable in LOADED:
        compiled(LOADED[executable])
    process = started(package, executable, folder)
    try:
        until_it_publishes(graph, process, NEEDS.get(executable, Needs()).samples)
        process.send_signal(number)
        _, errors = process.communicate(timeout=600)
    finally:
        if process.poll() is None:
            process.kill()
            process.communicate()
    assert process.returncode == 0, errors
    assert "Traceback" not in errors
    if executable == "recorder":
        assert (folder / "new" / "metadata.yaml").is_file()
        assert (folder / "new" / "new_0.mcap").is_file()


@pytest.mark.skipif("_ROS_WHEELS_BOOTSTRAP_COMPLETE" not in os.environ, reason="ROS does not come from wheels here")
def test_starts_without_the_library_path_of_env_sh(graph, folder):
    """Without the two variables of env.sh the wheels restart Python, with the same process id."""
    environment = {key: value for key, value in os.environ.items() if key != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}
    venv = str(ROOT / ".venv")
    parts = environment["LD_LIBRARY_PATH"].split(os.pathsep)
    environment["LD_LIBRARY_PATH"] = os.pathsep.join(each for each in parts if not each.startswith(venv))
    process = started("via_ros", "recorder", folder, environment)
    try:
        until_it_publishes(graph, process, samples=False)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=600)
    finally:
        if process.poll() is None:
            process.kill()
            process.communicate()
    assert process.returncode == 0, errors


@pytest.mark.parametrize(
    ("executable", "parameter", "complaint"),
    [("player", "bag:=nowhere", "nowhere"), ("recorder", "bag:=''", "bag"), ("player", "rate:=-1.0", "rate")],
)
def test_bad_parameters_are_one_line_and_an_exit_code(domain, tmp_path, executable, parameter, complaint):
    done = subprocess.run(
        [installed("via_ros", executable), "--ros-args", "-p", parameter],
        capture_output=True,
        text=True,
        timeout=600,
        cwd=tmp_path,
        check=False,
    )
    assert done.returncode == 2
    assert complaint in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1, done.stderr


def test_via_is_on_the_path_and_prints_its_help():
    done = subprocess.run(["via", "--help"], capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    assert "demo" in done.stdout


def ran(executable: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a node of via_ros that ends on its own."""
    return subprocess.run(
        [installed("via_ros", executable), *arguments], capture_output=True, text=True, timeout=600, check=False
    )


def test_arguments_that_are_not_parameters_are_refused(domain):
    done = ran("player", "--bag", "somewhere")
    assert done.returncode == 2
    assert done.stderr.splitlines() == [
        "error: unknown arguments: --bag somewhere; parameters are set by --ros-args -p name:=value"
    ]


def test_an_unknown_parameter_is_reported(domain, tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/joint_states", "sensor_msgs/msg/JointState")
        writer.write("/joint_states", serialize_message(JointState()), 1)
    parameters = (f"bag:={tmp_path / 'bag'}", "subscribers:=0", "rat:=3.0")
    done = ran("player", "--ros-args", *(word for text in parameters for word in ("-p", text)))
    assert done.returncode == 0
    assert "no parameter rat; there are: answers, bag," in done.stderr
