"""Mutations: what is mutated and what is not, where they are in the source, and that tests kill them."""

from pathlib import Path

import pytest
from via_core.errors import ViaError
from via_validation.mutants import choice, page, running
from via_validation.mutants.imports import covering, dependents, imports_of
from via_validation.mutants.operators import mutations_of
from via_validation.provenance import provenance

ROOT = Path(__file__).resolve().parents[2]

SOURCE = '''"""é: one + two."""
from numba import njit
LIMIT: float = 2.5  # [s]
TINY = 1e-12
@njit(cache=True)
def f(a: int = 3, b=4):
    """a + b"""
    if a < b and not b:
        raise ValueError(f"{a + b}")
    a += 2
    return -max(a, b) * (  # of a + b
        a - b)
'''


def test_operators_numbers_comparisons_and_signs_are_mutated_and_nothing_else():
    found = {(each.before, each.after, each.line) for each in mutations_of("m.py", SOURCE)}
    assert found == {
        ("2.5", "5.0", 3), ("<", ">=", 8), ("and", "or", 8), ("not ", "", 8), ("+=", "-=", 10), ("2", "3", 10),
        ("-", "", 11), ("max", "min", 11), ("*", "/", 11), ("-", "+", 12),
    }  # fmt: skip


def test_every_mutation_of_the_heart_changes_one_place_and_compiles():
    found = choice.candidates(ROOT)
    assert len(found) > 80 and "via_estimators/via_estimators/modulated_torque.py" in found
    for name, mutations in found.items():
        source = (ROOT / name).read_text("utf-8")
        for each in mutations[:: max(len(mutations) // 5, 1)]:
            changed = each.applied(source)
            assert changed != source and len(changed) == len(source) + len(each.after) - len(each.before)
            compile(changed, name, "exec")


def test_a_sample_depends_on_its_seed_alone_and_prefers_no_long_module():
    found = choice.candidates(ROOT)
    sample = choice.sampled(found, 200, 1)
    assert sample == choice.sampled(found, 200, 1) != choice.sampled(found, 200, 2)
    assert len(set(sample)) == 200
    longest = max(found, key=lambda name: len(found[name]))
    assert sum(each.path == longest for each in sample) < 12


def test_listed_mutations_are_in_the_sources_once():
    for kind in ("named", "equivalent"):
        for mutation, why in choice.listed(ROOT, kind):
            source = (ROOT / mutation.path).read_text("utf-8")
            compile(mutation.applied(source), mutation.path, "exec")
            assert why


def test_tests_are_found_by_imports_and_the_nearest_comes_first():
    imports = imports_of(ROOT)
    tests = covering(imports, "via_estimators/via_estimators/interacting_models.py")
    assert "via_estimators/test/test_estimators_interacting_models.py" in tests[:2]
    assert "via_estimators/test/test_estimators_modulated_torque.py" in tests
    reached = dependents(imports, "via_core/via_core/weak_form.py")
    assert reached["via_estimators/via_estimators/window.py"] == 1 and not any(
        "nodes" in k for k in reached if reached[k] < 2
    )


KERNEL = "from numba import njit\n\n@njit(cache=True)\n"
TWICE = "def twice(x):\n    return double(double(x))\n"


@pytest.fixture
def repository(tmp_path):
    """A small package with a test that notices an error of `double`, by a kernel of another file, none of `triple`."""
    import subprocess

    root = tmp_path / "repository"
    for name, text in {
        "via_a/via_a/__init__.py": "",
        "via_a/via_a/sums.py": KERNEL + "def double(x):\n    return 2.0 * x\n\n\ndef triple(x):\n    return 3.0 * x\n",
        "via_a/via_a/twice.py": KERNEL.replace("\n\n", "\nfrom via_a.sums import double\n\n") + TWICE,
        "via_a/test/test_sums.py": "from via_a.twice import twice\ndef test_double():\n    assert twice(2.0) == 8.0\n",
        "pyproject.toml": '[tool.pytest.ini_options]\npythonpath = ["via_a"]\n',
    }.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, "utf-8")
    subprocess.run(["git", "init", "--quiet", str(root)], check=True)
    return root


def test_a_noticed_error_is_killed_and_an_unnoticed_one_survives_on_the_page(repository, tmp_path):
    path = "via_a/via_a/sums.py"
    source = (repository / path).read_text("utf-8")
    mutations = [each for each in mutations_of(path, source) if each.before == "*"]
    limits, seen = running.Limits(600.0, 600.0), []
    done = running.tried(mutations, repository, tmp_path / "out", 1, limits, seen.append)
    assert [each.killed_by for each in done] == ["via_a/test/test_sums.py::test_double", ""]
    assert seen == done and (tmp_path / "out/0/tree" / path).read_text("utf-8") == source
    page.write(page.Results(done, [], set(), 4, 1, 0, limits), provenance("via mutants"), tmp_path / "mutants.md")
    text = (tmp_path / "mutants.md").read_text("utf-8")
    assert "| sample | 2 | 1 | 0 | 1 | 50.0 % |" in text and "**Missed**: 50.0 %" in text
    assert "`via_a/via_a/sums.py:9`: `*` -> `/` in `return 3.0 * x`" in text
    page.write(
        page.Results(done, [], {mutations[1]}, 4, 1, 0, limits), provenance("via mutants"), tmp_path / "mutants.md"
    )
    assert "| sample | 2 | 1 | 1 | 0 | 100.0 % |" in (tmp_path / "mutants.md").read_text("utf-8")
    with pytest.raises(ViaError, match="is not empty"):
        running.tried(mutations, repository, tmp_path / "out", 1, limits, seen.append)
