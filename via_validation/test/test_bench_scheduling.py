"""Real-time scheduling is requested, reported as granted only where it is, and restored."""

from __future__ import annotations

import ctypes
import os
from errno import EPERM
from types import SimpleNamespace

import pytest
from via_validation.bench.scheduling import GRANTED, prepare, real_time


class Kernel:
    """Schedulers of one thread, as far as they are asked for here."""

    def __init__(self, grants: bool) -> None:
        self.grants, self.now = grants, (os.SCHED_OTHER, os.sched_param(0))

    def set(self, _, scheduler, parameters):
        if not self.grants:
            raise PermissionError
        self.now = scheduler, parameters


@pytest.mark.parametrize("grants", [True, False])
@pytest.mark.parametrize("fails", [True, False])
def test_real_time_scheduling_is_reported_and_restored(monkeypatch, grants, fails):
    kernel = Kernel(grants)
    usual = kernel.now
    monkeypatch.setattr(os, "sched_getscheduler", lambda _: kernel.now[0])
    monkeypatch.setattr(os, "sched_getparam", lambda _: kernel.now[1])
    monkeypatch.setattr(os, "sched_setscheduler", kernel.set)
    try:
        with real_time(7) as granted:
            assert granted is grants
            assert kernel.now == ((os.SCHED_FIFO, os.sched_param(7)) if grants else usual)
            if fails:
                raise ValueError
    except ValueError:
        assert fails
    assert kernel.now == usual


def test_without_schedulers_nothing_is_granted(monkeypatch):
    monkeypatch.delattr(os, "sched_getscheduler")
    with real_time() as granted:
        assert not granted


@pytest.mark.parametrize("grants", [True, False])
def test_what_a_process_is_not_granted_is_said_with_the_reason(monkeypatch, grants):
    def request(*_):
        if not grants:
            raise PermissionError(EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", request)
    monkeypatch.setattr(os, "sched_setaffinity", request)
    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: SimpleNamespace(mlockall=lambda _: 0 if grants else -1))
    monkeypatch.setattr(ctypes, "get_errno", lambda: EPERM)
    expected = GRANTED if grants else "not granted: Operation not permitted"
    assert prepare({0}) == {"SCHED_FIFO": expected, "affinity": expected, "memory locking": expected}
