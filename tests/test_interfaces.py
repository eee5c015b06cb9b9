"""Messages agree with the code, and every numeric field states its unit."""

from __future__ import annotations

import re

import pytest
from via_core.status import Status
from via_interfaces import action, msg, srv

WITH_STATUS = ["StiffnessEstimate", "DampingEstimate", "MotorEstimate", "PayloadEstimate", "GapStatus"]
EXPECTED = {*WITH_STATUS, "ControlState", "JointReference", "VsaCommand", "Effect", "EffectHypothesis", "SiteShare"}


@pytest.mark.parametrize("name", WITH_STATUS)
def test_status_constants_are_those_of_the_core(name):
    kind = getattr(msg, name)
    constants = {key: getattr(kind, key) for key in vars(type(kind)) if key.isupper() and not key.startswith("_")}
    assert constants == {each.name: each.value for each in Status}


@pytest.mark.parametrize("name", WITH_STATUS)
def test_estimates_carry_stamp_number_and_method(name):
    fields = getattr(msg, name).get_fields_and_field_types()
    assert fields["header"] == "std_msgs/Header"
    assert (fields["sequence"], fields["status"], fields["method"]) == ("uint64", "uint8", "string")


def test_all_interface_files_are_built():
    assert {name for name in vars(msg) if name[0].isupper()} >= EXPECTED
    assert {name for name in vars(srv) if name[0].isupper()} >= {
        "SetEffects",
        "ClearEffects",
        "ResetEstimator",
        "Push",
        "Hold",
    }
    assert "DiagnoseGap" in vars(action)


def test_every_field_is_documented_and_every_number_has_a_unit(root):
    files = sorted((root / "via_interfaces").glob("*/*.*"))
    assert len(files) == 17
    for path in files:
        for line in path.read_text(encoding="utf-8").splitlines():
            field = re.match(r"([\w/\[\]]+)\s+(\w+)\s*(#.*)?$", line)
            if field is None:
                continue
            kind, name, comment = field.groups()
            assert comment, f"{path.name}: {name} has no comment"
            if kind.startswith(("float", "uint")) and name != "parameter_values":
                assert re.search(r"\[[^\]]+\]|in its unit|of \w+$", comment), f"{path.name}: {name} has no unit"
