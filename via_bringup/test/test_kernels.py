"""Kernels compiled by set-up: nothing to do where they are, or where there is no place to keep them."""

import pytest
from via_bringup import kernels


@pytest.fixture
def compiled(monkeypatch):
    """Names of what was compiled, in place of compiling."""
    calls = []
    monkeypatch.setattr(kernels, "compile_kernels", lambda progress: calls.append("all"))
    return calls


def test_kernels_are_compiled_once_for_a_state_of_the_sources(tmp_path, monkeypatch, compiled):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "state"))
    kernels.main()
    kernels.main()
    assert compiled == ["all"]
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "other"))
    kernels.main()
    assert compiled == ["all", "all"]


def test_nothing_is_compiled_without_a_place_to_keep_it(monkeypatch, compiled):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    kernels.main()
    assert not compiled


def test_what_was_interrupted_is_compiled_again(tmp_path, monkeypatch):
    def interrupted(progress):
        raise KeyboardInterrupt

    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(kernels, "compile_kernels", interrupted)
    with pytest.raises(KeyboardInterrupt):
        kernels.main()
    assert not (tmp_path / kernels.STAMP).exists()
