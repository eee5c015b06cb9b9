"""Errors of eq. (52): values by hand, refused input."""

import pytest
from via_core.errors import SignalError
from via_validation.tables.errors import mse, msrep


def test_equation_52_divides_by_the_number_of_terms():
    truth, estimate = [2.0, 4.0, 5.0], [1.0, 4.0, 7.0]
    assert mse(truth, estimate) == pytest.approx(5.0 / 3.0)  # printed: 5/2
    assert msrep(truth, estimate) == pytest.approx(100.0 * (0.25 + 0.0 + 0.16) / 3.0)


def test_a_zero_reference_is_refused():
    with pytest.raises(SignalError, match="'truth' is 0 at sample 1"):
        msrep([1.0, 0.0], [1.0, 1.0])
