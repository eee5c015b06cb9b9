"""Release files: one version everywhere, and files for GitHub, citation and bloom that their readers accept."""

from __future__ import annotations

import re
from datetime import date
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
PACKAGES = sorted(path.parent for path in ROOT.glob("via_*/package.xml"))
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yaml"))
FORMS = sorted(path for path in (ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml") if path.name != "config.yml")
# versions of Python that set-up accepts
PYTHONS = re.findall(r"3\.\d+", re.search(r"suits\(\).*\bin (.*?)\)", (ROOT / "ros2_ws/setup.sh").read_text())[1])


def stated(file: Path, pattern: str) -> str:
    """The only match of `pattern` in `file`."""
    (found,) = re.findall(pattern, file.read_text("utf-8"), flags=re.MULTILINE)
    return found


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.name)
def test_every_package_has_the_version_of_the_citation(package: Path) -> None:
    assert stated(package / "package.xml", r"<version>(.*)</version>") == CITATION["version"]
    if (package / "setup.py").exists():
        # A literal, since catkin_prepare_release replaces it.
        assert stated(package / "setup.py", r'^    version="(.*)",$') == CITATION["version"]


def test_the_changelog_begins_with_the_version_and_date_of_the_citation() -> None:
    (version, day), *_ = re.findall(r"^## \[(.*)\] - (.*)$", (ROOT / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE)
    assert (version, date.fromisoformat(day)) == (CITATION["version"], CITATION["date-released"])


def test_the_citation_has_what_its_format_requires() -> None:
    """Citation File Format 1.2.0: required members, and authors that are persons or entities."""
    assert CITATION["cff-version"] == "1.2.0" and CITATION["type"] == "software"
    assert CITATION["message"] and CITATION["title"]
    for entry in (CITATION, *CITATION["references"]):
        assert entry["title"] and all("name" in each or "family-names" in each for each in entry["authors"])
    assert all(entry["type"] for entry in CITATION["references"])
    assert CITATION["license"] == stated(ROOT / "via_core" / "package.xml", r"<license.*>(.*)</license>")


def steps(workflow: Path) -> list[dict[str, Any]]:
    jobs = yaml.safe_load(workflow.read_text("utf-8"))["jobs"].values()
    assert all(job["runs-on"] and job["timeout-minutes"] for job in jobs)
    return [step for job in jobs for step in job["steps"]]


@pytest.mark.parametrize("workflow", WORKFLOWS, ids=lambda path: path.stem)
def test_every_step_of_a_workflow_uses_a_pinned_action_or_runs_commands(workflow: Path) -> None:
    for step in steps(workflow):
        assert ("uses" in step) != ("run" in step), step
        assert re.fullmatch(r"[\w-]+/[\w-]+@v\d+", step.get("uses", "a/b@v1"))


@pytest.mark.parametrize("workflow", WORKFLOWS, ids=lambda path: path.stem)
def test_workflows_make_targets_and_name_files_that_exist(workflow: Path) -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE))
    runs = "\n".join(step.get("run", "") for step in steps(workflow))
    assert set(re.findall(r"\bmake ([a-z-]+)", runs)) <= targets
    named = re.findall(r"(?:^|[\s/])((?:ros2_ws|\.ci)/[\w./-]+)", runs)
    assert named and all((ROOT / each).exists() for each in named)


def test_the_wheels_workflow_tries_every_python_that_set_up_accepts() -> None:
    jobs = yaml.safe_load((ROOT / ".github/workflows/wheels.yaml").read_text("utf-8"))["jobs"]
    assert jobs["quick"]["strategy"]["matrix"]["python"] == PYTHONS and len(PYTHONS) >= 3
    assert ".ci/run" in [step.get("run") for step in jobs["everything"]["steps"]]


def test_the_environment_file_knows_every_python_that_set_up_accepts() -> None:
    minors = stated(ROOT / "ros2_ws" / "env.sh", r"python3\.1\[(\d+)\]")
    assert [f"3.1{minor}" for minor in minors] == PYTHONS


def test_the_jazzy_workflow_builds_and_tests_with_colcon() -> None:
    runs = "\n".join(step.get("run", "") for step in steps(ROOT / ".github" / "workflows" / "jazzy.yaml"))
    for command in ("rosdep install --from-paths", "colcon build", "colcon test", "colcon test-result"):
        assert command in runs


@pytest.mark.parametrize("form", FORMS, ids=lambda path: path.stem)
def test_issue_forms_have_what_github_requires(form: Path) -> None:
    content = yaml.safe_load(form.read_text("utf-8"))
    assert content["name"] and content["description"]
    fields = [each for each in content["body"] if each["type"] != "markdown"]
    assert fields and len({each["id"] for each in fields}) == len(fields)
    assert {each["type"] for each in fields} <= {"textarea", "input", "dropdown", "checkboxes"}
    assert all(each["attributes"]["label"] for each in fields)
    assert all(each["attributes"]["value"] for each in content["body"] if each["type"] == "markdown")


def test_links_of_the_top_level_pages_lead_to_files() -> None:
    for page in (ROOT / "CONTRIBUTING.md", ROOT / "SECURITY.md"):
        links = [each for each in re.findall(r"\]\((.*?)\)", page.read_text("utf-8")) if "://" not in each]
        assert links and all((ROOT / each).exists() for each in links)


def test_the_image_is_built_with_a_python_that_set_up_accepts() -> None:
    text = (ROOT / "Dockerfile").read_text("utf-8")
    assert re.search(r"^FROM python:(3\.\d+)", text, re.MULTILINE)[1] in PYTHONS
    assert re.search(r"PYTHON=\S*python(3\.\d+)$", text, re.MULTILINE)[1] in PYTHONS
