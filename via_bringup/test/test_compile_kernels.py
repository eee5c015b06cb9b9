"""`compile_kernels` runs once per cache folder, and again after an interruption."""

from pathlib import Path

import pytest
from via_bringup import compile_kernels


@pytest.fixture
def compiled(monkeypatch):
    """Calls of a stub that replaces the compilation."""
    calls = []
    monkeypatch.setattr(compile_kernels, "compile_kernels", lambda progress: calls.append("all"))
    return calls


def test_kernels_are_compiled_once_per_cache_folder(tmp_path, monkeypatch, compiled):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "state"))
    compile_kernels.main()
    compile_kernels.main()
    assert compiled == ["all"]
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "other"))
    compile_kernels.main()
    assert compiled == ["all", "all"]


def test_nothing_is_compiled_without_a_cache_folder(monkeypatch, compiled):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    compile_kernels.main()
    assert not compiled


def test_an_interrupted_compilation_is_repeated(tmp_path, monkeypatch):
    def interrupted(progress):
        raise KeyboardInterrupt

    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(compile_kernels, "compile_kernels", interrupted)
    with pytest.raises(KeyboardInterrupt):
        compile_kernels.main()
    assert not (tmp_path / compile_kernels.STAMP).exists()


def test_files_outside_the_key_of_the_cache_define_no_kernels():
    """ros2_ws/env.sh leaves them out."""
    root = Path(__file__).resolve().parents[2]
    files = [file for name in ("via_bringup", "via_export", "via_ros") for file in (root / name / name).rglob("*.py")]
    files += root.glob("via_*/via_*/nodes/**/*.py")
    assert len(files) > 50
    assert not [file for file in files if "njit" in file.read_text("utf-8")]
