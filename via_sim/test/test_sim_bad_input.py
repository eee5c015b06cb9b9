"""Invalid numbers in effects files give one-line errors."""

import pytest
from via_core.errors import ParameterError
from via_sim.effects.files import parse_effects

HUGE = "1" + "0" * 400  # a whole number beyond all floats


@pytest.mark.parametrize(
    ("entry", "complaint"),
    [
        ("motor: 1.0, parameters: {torque: 0.1}", "motor: must be 1, 2 or 0 (both), got 1.0"),
        ("motor: true, parameters: {torque: 0.1}", "motor: must be 1, 2 or 0 (both), got True"),
        (f"motor: 1, parameters: {{torque: {HUGE}}}", "torque: must be -1e+06 to 1e+06 N m"),
        (f"motor: 1, parameters: {{torque: -{HUGE}}}", "torque: must be -1e+06 to 1e+06 N m"),
        ("motor: 1, parameters: {torque: .nan}", "torque: must be a finite number"),
        ("motor: 1, parameters: {torque: -.inf}", "torque: must be a finite number"),
        ("motor: 1, parameters: {torque: true}", "torque: must be a finite number"),
        ("motor: 1, parameters: {torque: 2020-01-01}", "torque: must be a finite number"),
    ],
)
def test_invalid_parameter_values_are_refused(entry, complaint):
    with pytest.raises(ParameterError, match=r"f: entry 1: coulomb_friction\.") as error:
        parse_effects(f"- {{effect: coulomb_friction, site: motor, {entry}}}", "f")
    assert complaint in str(error.value)
    assert "\n" not in str(error.value)
