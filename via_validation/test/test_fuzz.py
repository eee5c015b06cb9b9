"""A few damaged files of each kind; `via fuzz` reads thousands."""

import numpy as np
import pytest
from via_validation.fuzz import run
from via_validation.fuzz.inputs import Kind, damaged, kinds


@pytest.mark.parametrize("kind", ["device", "mapping", "effects", "commands", "bag", "report"])
def test_damaged_files_are_read_or_refused(kind):
    assert set(kinds()) == {"device", "mapping", "effects", "commands", "bag", "report"}
    (result,) = run.batches(kind, 100, seed=1)
    assert result.faults == [] and result.read + result.refused == 100
    assert result.refused > 0 or kind == "bag"  # what is sound in a damaged bag is read, with remarks


def test_a_loader_that_raises_something_else_is_a_fault(monkeypatch):
    def read(path):
        if path.read_bytes() != b"abcdef":
            raise ZeroDivisionError

    monkeypatch.setattr(run, "kinds", lambda: {"x": Kind(".x", (b"abcdef",), read)})
    result = run._read("x", range(5), 0)
    assert len(result.faults) + result.read == 5 and "ZeroDivisionError" in result.faults[0]


def test_damage_is_the_same_for_a_seed():
    first, again = (damaged(np.random.default_rng(3), b"some text") for _ in range(2))
    assert first == again != b"some text"
