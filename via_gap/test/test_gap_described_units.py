"""Descriptions of a joint: what its model adds to the guesses of columns without a joint's name."""

from pathlib import Path

import numpy as np
import pandas
import pytest
from via_core.errors import SignalError
from via_core.recordings.entries import Constants
from via_gap.run.describe import describe

ROBOT = """<robot name="r"><link name="base"/><joint name="wheel" type="{kind}"><parent link="base"/><child link="rim"/>
<axis xyz="0 1 0"/>{limit}</joint><link name="rim"><inertial><mass value="1"/>
<inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""
TIME = 2e-3 * np.arange(4000)


@pytest.mark.parametrize(
    ("kind", "limit", "unit", "remarked"),
    [
        ("revolute", '<limit lower="-2" upper="2" effort="9" velocity="9"/>', "deg", False),
        ("revolute", '<limit lower="-99" upper="99" effort="9" velocity="9"/>', "rad", False),
        ("continuous", "", "rad", True),
    ],
)
def test_the_range_of_the_joint_decides_the_unit_of_a_column_without_a_name(
    tmp_path: Path, kind: str, limit: str, unit: str, remarked: bool
) -> None:
    (tmp_path / "r.urdf").write_text(ROBOT.format(kind=kind, limit=limit))
    frame = pandas.DataFrame({"t": TIME, "q": 71.0 * np.sin(TIME), "tau": np.cos(TIME)})
    frame.to_csv(tmp_path / "run.csv", index=False)
    made = describe("via device new", tmp_path / "r.urdf", "", tmp_path / "run.csv", {}, Constants())
    assert made.columns["q"][0].get("unit", "rad") == unit
    assert any("states no unit" in remark for remark in made.remarks) == remarked
    numbered = {f"{name}[{k}]": frame[name] for name in ("q", "tau") for k in (0, 1)}
    pandas.DataFrame({"t": TIME, **numbered}).to_csv(tmp_path / "run.csv", index=False)
    made = describe("via device new", tmp_path / "r.urdf", "", tmp_path / "run.csv", {}, Constants(joint="1"))
    assert made.columns["q"][0] == {"column": "q[1]"} | ({"unit": "deg"} if unit == "deg" else {})


def test_a_table_without_names_is_refused_with_the_remedy(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "run.csv", np.stack([TIME, np.sin(TIME), np.cos(TIME)], axis=1), delimiter=",")
    with pytest.raises(SignalError, match=r"3 columns have no names such .*; write a line of names above"):
        describe("via device new", None, "", tmp_path / "run.csv", {}, Constants())
