"""SROS2 policy and governance of VIA for given devices and arms, and the key store that `ros2 security` makes of them.

The shipped policy (security/policy.xml) has one enclave per node, with placeholders in names: {device}, {method} of a
device, {arm}, and {joint} of an arm. tests/test_security.py generates it from the running nodes.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from copy import deepcopy
from pathlib import Path
from xml.etree import ElementTree

from ament_index_python.packages import get_package_share_directory
from via_core.devices import load_device
from via_core.errors import ViaError
from via_core.text_files import write_text
from via_core.vsa_arms import load_vsa_arm
from via_estimators.methods import methods_for

ENABLED = "ROS_SECURITY_ENABLE"
REMEDY = "on a stock Jazzy: sudo apt install ros-jazzy-sros2, then run this command again"
Names = list[dict[str, str]]  # values of the placeholders


def policy(devices: Sequence[str], arms: Sequence[str]) -> str:
    """The shipped policy for these devices and arms (names or paths). Raises DeviceError or ParameterError."""
    root = ElementTree.fromstring(_shipped("policy.xml"))
    _expand(root, _names(devices, arms))
    for profile in root.iter("profile"):
        for group in [each for each in profile if not len(each)]:
            profile.remove(group)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def governance(domain: str) -> str:
    """The shipped governance for a ROS domain."""
    return _shipped("governance.xml").replace("{domain}", domain)


def make_key_store(folder: Path, devices: Sequence[str], arms: Sequence[str]) -> None:
    """Write policy and governance into a folder and let `ros2 security` make keys and signed permissions.

    Repeated for other devices, keys remain and permissions are replaced. Raises ViaError if `ros2 security` is missing
    or fails; policy and governance are written before.
    """
    text = policy(devices, arms)
    (folder / "enclaves").mkdir(parents=True, exist_ok=True)
    write_text(folder / "policy.xml", text)
    if not (folder / "enclaves" / "governance.p7s").exists():  # a signed one belongs to its text
        write_text(folder / "enclaves" / "governance.xml", governance(os.environ.get("ROS_DOMAIN_ID", "0")))
    tool = shutil.which("ros2")
    if tool is None:
        raise ViaError(f"no command `ros2 security`: {folder} has policy and governance, but no keys; {REMEDY}")
    words = [tool, "security", "generate_artifacts", "-k", str(folder), "-p", str(folder / "policy.xml")]
    own = {name: value for name, value in os.environ.items() if name != ENABLED}
    done = subprocess.run(words, env=own, capture_output=True, text=True, check=False)
    if done.returncode:
        lines = (done.stderr or done.stdout).strip().splitlines() or ["no message"]
        raise ViaError(f"`ros2 security generate_artifacts` failed: {lines[-1]}; if it is missing, {REMEDY}")


def _shipped(name: str) -> str:
    return (Path(get_package_share_directory("via_bringup")) / "security" / name).read_text(encoding="utf-8")


def _names(devices: Sequence[str], arms: Sequence[str]) -> dict[str, Names]:
    """Per placeholder the values that occur together."""
    described = [load_device(each) for each in devices]
    loaded = [load_vsa_arm(each) for each in arms]
    return {
        "device": [{"device": each.name} for each in described],
        "method": [{"device": each.name, "method": method} for each in described for method in methods_for(each)],
        "arm": [{"arm": each.name} for each in loaded],
        "joint": [{"joint": joint} for each in loaded for joint in each.joints],
    }


def _expand(parent: ElementTree.Element, names: dict[str, Names]) -> None:
    """Replace each element below `parent` by its copies."""
    parent[:] = [_filled(child, values) for child in parent for values in _needed(child, names)]
    for child in parent:
        _expand(child, names)


def _needed(element: ElementTree.Element, names: dict[str, Names]) -> Iterator[dict[str, str]]:
    """One set of values per copy of the element that its own text and attributes ask for."""
    found = set(re.findall(r"\{(\w+)\}", " ".join([element.text or "", *element.attrib.values()])))
    key = next((each for each in ("method", "device", "arm", "joint") if each in found), None)
    yield from names[key] if key else [{}]


def _filled(element: ElementTree.Element, values: dict[str, str]) -> ElementTree.Element:
    made = deepcopy(element)
    for name, value in values.items():
        made.text = (made.text or "").replace(f"{{{name}}}", value)
        made.attrib = {key: each.replace(f"{{{name}}}", value) for key, each in made.attrib.items()}
    return made
