"""The contenders of `via bench gap`: all find the planted parameters in the same log."""

import numpy as np
import pytest
from via_validation.bench.gap_contenders import CONTENDERS, START, TRUE, beginning, log_of, totals


@pytest.fixture(scope="module")
def log():
    return log_of(8.0)


@pytest.mark.parametrize("name", CONTENDERS)
def test_every_contender_finds_the_planted_parameters(log, name):
    found = CONTENDERS[name](log)
    assert found == pytest.approx(totals(TRUE), rel=0.02)
    assert np.all(found != totals(START))


def test_the_short_log_is_the_beginning_of_the_long_one(log):
    short = beginning(log, 2.0)
    assert short.duration == pytest.approx(2.0)
    assert np.array_equal(short.measured["q"], log.measured["q"][: len(short.measured)])
    assert np.array_equal(short.commands["motor"], log.commands["motor"][: len(short.commands)])
