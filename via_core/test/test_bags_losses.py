"""Lost samples counted by their stamps, for any pattern of loss."""

import numpy as np
import pytest
from via_core.bags.losses import losses

SENT = 4000
RNG = np.random.default_rng(3)
PATTERNS = {
    "a tenth at random": RNG.random(SENT) > 0.1,
    "half at random": RNG.random(SENT) > 0.5,
    "nine tenths at random": RNG.random(SENT) > 0.9,
    "one in a hundred": np.arange(SENT) % 100 != 50,
    "rows of seven": np.arange(SENT) % 200 > 6,
    "every second one in one half": (np.arange(SENT) % 2 == 0) | (np.arange(SENT) < SENT // 2),
    "one long gap": (np.arange(SENT) < 1000) | (np.arange(SENT) > 1900),
}


@pytest.mark.parametrize("jitter", [0.0, 0.05])
@pytest.mark.parametrize("name", PATTERNS)
def test_the_number_of_lost_samples_is_found(name, jitter):
    kept = PATTERNS[name]
    time = 2e-3 * (np.arange(SENT) + jitter * np.random.default_rng(7).normal(size=SENT))
    first, last = np.flatnonzero(kept)[[0, -1]]
    truth = int(np.count_nonzero(~kept[first : last + 1]))
    found = losses(time[kept])
    assert found is not None
    assert found.lost == pytest.approx(truth, rel=0.02)
    assert found.period == pytest.approx(2e-3, rel=0.01 if jitter else 1e-9)


def test_complete_streams_have_no_losses():
    steady = 1e-3 * np.arange(1000)
    assert losses(steady) is None
    assert losses(np.sort(np.random.default_rng(1).random(1000))) is None  # no period at all
    assert losses(steady[:20:2]) is None  # too short
