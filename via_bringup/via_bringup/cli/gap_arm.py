"""Options and logs of `via gap diagnose --arm` and `via gap simulate --arm`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from via_core.devices import Device
from via_core.errors import ViaError
from via_core.recordings.entries import Constants
from via_gap.logs.log import JointLog

from via_bringup.cli.console import errors

if TYPE_CHECKING:
    from via_gap.run.arms import ArmCause, ArmDiagnosis

Arm = Annotated[
    str | None,
    typer.Option(
        help="Arm with rigid joints: name, path to its YAML, or URDF or MJCF file; each log has all its joints."
    ),
]
CountsPerTurn = Annotated[
    float | None, typer.Option(min=1.0, help="Of an --arm from a model: counts of one turn, for positions in counts.")
]
TorqueConstant = Annotated[
    float | None,
    typer.Option(help="Of an --arm from a model: torque per current at the joints \\[N m/A], for currents."),
]


def diagnosed_arm(
    arm: str,
    logs: Sequence[Path],
    holdout: Sequence[Path],
    constants: Constants,
    progress: Callable[[str, float], None],
) -> ArmDiagnosis:
    """The diagnosis of all joints."""
    from via_gap.run.arms import diagnose_arm, find_arm, read_arm_log  # importing pinocchio takes a second

    whole = find_arm(arm, logs[0], constants)
    for remark in whole.remarks:
        errors.print(f"note: {remark}", soft_wrap=True)
    read, held = ([read_arm_log(path, whole) for path in paths] for paths in (logs, holdout))
    return diagnose_arm(whole, read, held, progress)


def named_causes(found: ArmDiagnosis | None) -> list[tuple[str, ArmCause]]:
    """What all joints feel, each with a name for its file: its sort, with its link if there are several of a sort."""
    causes = () if found is None else found.causes
    sorts = [each.name for each in causes]
    names = [each.name if sorts.count(each.name) == 1 else f"{each.name}_{each.link}" for each in causes]
    return list(zip(names, causes, strict=True))


def joint_of_arm(
    arm: str,
    joint: str,
    logs: Sequence[Path],
    causes: Sequence[Path],
    constants: Constants,
) -> tuple[Device, list[JointLog]]:
    """A joint and its logs, with the causes of an arm's reports. Raises ViaError where the arm has no such joint."""
    from via_gap.run.arms import find_arm, read_arm_log, read_cause, with_causes

    whole = find_arm(arm, logs[0], constants)
    whole = with_causes(whole, [read_cause(path) for path in causes])
    names = [each.name for each in whole.devices]
    if joint not in names:
        raise ViaError(f"'{joint}' is not a joint of '{whole.name}', which has: {', '.join(names)}")
    number = names.index(joint)
    return whole.devices[number], [read_arm_log(path, whole)[number] for path in logs]
