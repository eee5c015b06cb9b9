"""Whether rclcpp nodes could be compiled here."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

HEADER = "rclcpp/rclcpp.hpp"


def missing() -> str:
    """What a compilation of rclcpp nodes lacks; '' if nothing."""
    if not shutil.which("c++"):
        return "there is no C++ compiler"
    prefixes = [Path(each) for each in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if each]
    if not any((prefix / "include" / HEADER).exists() or (prefix / "include" / "rclcpp" / HEADER).exists()
               for prefix in prefixes):  # fmt: skip
        return f"no prefix of AMENT_PREFIX_PATH has the header {HEADER}"
    return ""
