"""Processes can fill one cache of compiled kernels at the same time."""

from importlib.metadata import entry_points

import pytest
from numba.core.caching import IndexDataCacheFile
from via_core import kernel_cache


@pytest.fixture(name="processes")
def _processes(tmp_path, monkeypatch):
    """The cache file of one kernel as two processes see it."""
    monkeypatch.setattr(IndexDataCacheFile, "save", IndexDataCacheFile.save)
    kernel_cache.init()
    return [IndexDataCacheFile(str(tmp_path), "kernel", "stamp of the source") for _ in range(2)]


def test_signatures_saved_at_the_same_time_keep_their_own_code(processes, monkeypatch):
    one, other = processes
    with monkeypatch.context() as before_either_saved:
        before_either_saved.setattr(IndexDataCacheFile, "_load_index", lambda self: {})
        one.save("int64", "code for int64")
        other.save("float64", "code for float64")
    assert one.load("int64") in (None, "code for int64")
    assert one.load("float64") == "code for float64"


def test_signatures_saved_one_after_the_other_are_all_kept(processes):
    one, other = processes
    one.save("int64", "code for int64")
    other.save("float64", "code for float64")
    other.save("int64", "code for int64, compiled again")
    assert one.load("int64") == "code for int64, compiled again"
    assert one.load("float64") == "code for float64"


def test_numba_is_given_it_by_an_entry_point():
    assert kernel_cache.init in [each.load() for each in entry_points(group="numba_extensions", name="init")]
