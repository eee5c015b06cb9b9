"""`via security`: a key store of SROS2 for the nodes of VIA."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from via_bringup.cli.console import answers
from via_bringup.cli.outputs import check_folder
from via_bringup.security import make_key_store


def security(
    folder: Annotated[Path, typer.Argument(help="Folder of the key store; keys that it has remain.")],
    device: Annotated[list[str] | None, typer.Option(help="Device name or path to its YAML; repeatable.")] = None,
    arm: Annotated[list[str] | None, typer.Option(help="Arm name or path to its YAML; repeatable.")] = None,
) -> None:
    """Make an SROS2 key store for the nodes of VIA: keys, governance, and permissions for these devices and arms.

    Needs `ros2 security` of an installed Jazzy. ROS_DOMAIN_ID is the domain that the store is valid for.
    """
    check_folder(folder)
    make_key_store(folder, device or (), arm or ())
    answers.print(f"key store in {folder}; to use it:", soft_wrap=True)
    for name, value in (("KEYSTORE", folder.absolute()), ("ENABLE", "true"), ("STRATEGY", "Enforce")):
        answers.print(f"export ROS_SECURITY_{name}={value}", soft_wrap=True)
