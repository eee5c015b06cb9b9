"""Cases: the same from the same seed, of the declared size, sealed apart, and silent about their effect."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from multiprocessing import active_children
from pathlib import Path

import numpy as np
import pytest
from via_core.bags import joint_signals, read_bag
from via_core.devices import load_device
from via_gap.benchmark.case import BLOCK, RANGE, SHARES, draw_case, plan
from via_gap.benchmark.joints import FAMILIES, believed, device_of, draw_joint, scaled
from via_gap.benchmark.making import Made, make_cases
from via_gap.benchmark.menu import MENU
from via_gap.benchmark.recording import LEVELS, limited, neighbour_angle, write_log
from via_gap.benchmark.residual import left_by_numbers
from via_gap.benchmark.sealing import SealError, digest_of, names_in, opened, seal, write_seals
from via_gap.benchmark.strangers import STRANGERS
from via_gap.logs.log import read_log

DURATION = 5.0  # [s]
NEIGHBOUR_AND_NONE = (13, 3)  # development seeds of joints without a gap


def seeds_of(kind: str, count: int, level: str = "") -> list[int]:
    """The first development seeds whose case is of this kind."""
    return [s for s in range(1, 2000) if plan(s).kind == kind and level in ("", plan(s).level)][:count]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, list[Made]]:
    """One case of every kind, in two folders."""
    folder = tmp_path_factory.mktemp("blind")
    seeds = [seeds_of(kind, 1)[0] for kind in ("single", "no_gap", "unknown", "pair", "limited")]
    told: list[Made] = []
    done = make_cases(seeds, folder / "cases", folder / "keys", DURATION, 1, told.append)
    assert sorted(each.name for each in told) == [each.name for each in done]
    return folder / "cases", folder / "keys", done


def test_a_block_of_seeds_holds_every_effect_once_and_its_shares() -> None:
    plans = [plan(s) for s in range(100_020 // BLOCK * BLOCK, 100_020 // BLOCK * BLOCK + BLOCK)]
    assert sorted(each.effect for each in plans if each.kind == "single") == sorted(MENU)
    assert Counter(each.kind for each in plans) == {"single": len(MENU), **SHARES}
    assert {each.level for each in plans if each.kind == "limited"} == set(LEVELS[1:])
    assert all(each.level == "full" for each in plans if each.kind != "limited")
    assert [plan(s) for s in range(BLOCK)] != [plan(s) for s in range(BLOCK, 2 * BLOCK)]  # another order
    everyone = {plan(s).effect for s in range(100_020, 100_020 + 4 * BLOCK) if plan(s).kind == "unknown"}
    assert everyone == set(STRANGERS)


def test_the_same_seed_makes_the_same_bits(made: tuple[Path, Path, list[Made]], tmp_path: Path) -> None:
    cases, keys, done = made
    name = done[3].name
    seed = json.loads((keys / f"{name}.json").read_text())["seed"]
    (tmp_path / "k").mkdir()
    digest = seal(draw_case(seed, DURATION), name, tmp_path / "c", tmp_path / "k")
    assert digest == done[3].digest
    for file in sorted((cases / name).rglob("*")):
        if file.is_file():
            assert (tmp_path / "c" / name / file.relative_to(cases / name)).read_bytes() == file.read_bytes()
    withheld = json.loads((keys / f"{name}.json").read_text())["withheld"]
    assert digest_of(tmp_path / "k" / withheld) == digest_of(keys / withheld)


def test_keys_lie_apart_and_no_case_names_an_effect(made: tuple[Path, Path, list[Made]]) -> None:
    cases, keys, _ = made
    fields = {"coulomb_friction", "viscous_friction"}  # of every device file
    column = {b"external_torque"}  # of every rigid joint's table
    words = {word.encode() for word in (*MENU, *STRANGERS)} - {word.encode() for word in fields}
    for name in names_in(cases):
        there = {file.relative_to(cases / name).as_posix() for file in (cases / name).rglob("*") if file.is_file()}
        recording = {"log.csv"} if "log.csv" in there else {"bag/bag_0.mcap", "bag/metadata.yaml"}
        assert there == {*recording, "joint.yaml", "README.md", "seal.txt"}
        for file in (cases / name).rglob("*"):
            if file.is_file():
                content = file.read_bytes()
                assert not [word for word in words - (column if "log.csv" in there else set()) if word in content]
                assert str(keys).encode() not in content
        for word in fields:
            assert word.encode() not in (cases / name / "README.md").read_bytes()
    sealed = opened(names_in(cases)[3], cases, keys).key
    assert len(sealed["effects"]) == 2  # the key does name them


def test_what_is_sealed_is_what_sha256sum_checks(made: tuple[Path, Path, list[Made]]) -> None:
    cases, keys, done = made
    listed = dict(line.split()[::-1] for line in (cases / "seals.txt").read_text().splitlines())
    for each in done:
        assert hashlib.sha256((keys / f"{each.name}.json").read_bytes()).hexdigest() == each.digest
        assert listed[f"{each.name}.json"] == each.digest == (cases / each.name / "seal.txt").read_text().strip()


def test_tampering_is_found(made: tuple[Path, Path, list[Made]], tmp_path: Path) -> None:
    source, source_keys, done = made
    name = done[0].name

    def copy(folder: Path) -> tuple[Path, Path]:
        for origin, target in ((source, folder / "c"), (source_keys, folder / "k")):
            for file in origin.rglob("*"):
                if file.is_file():
                    to = target / file.relative_to(origin)
                    to.parent.mkdir(parents=True, exist_ok=True)
                    to.write_bytes(file.read_bytes())
        return folder / "c", folder / "k"

    cases, keys = copy(tmp_path / "whole")
    assert opened(name, cases, keys).key["case"] == name
    cases, keys = copy(tmp_path / "key")
    key = keys / f"{name}.json"
    key.write_text(key.read_text().replace('"ratio"', '"Ratio"', 1))
    with pytest.raises(SealError, match="not the one that was sealed"):
        opened(name, cases, keys)
    cases, keys = copy(tmp_path / "both")  # a new key with a new seal in the case, but not in the list
    key = keys / f"{name}.json"
    key.write_text(key.read_text() + " ")
    (cases / name / "seal.txt").write_text(hashlib.sha256(key.read_bytes()).hexdigest() + "\n")
    with pytest.raises(SealError, match="not the one that was sealed"):
        opened(name, cases, keys)
    cases, keys = copy(tmp_path / "log")
    recording = next((keys / f"{name}_withheld").glob("*.mcap"))
    recording.write_bytes(recording.read_bytes()[:-1] + b"x")
    with pytest.raises(SealError, match="withheld log"):
        opened(name, cases, keys)
    (keys / f"{name}.json").unlink()
    with pytest.raises(SealError, match="cannot be read"):
        opened(name, cases, keys)


def test_keys_within_cases_are_refused(tmp_path: Path) -> None:
    for cases, keys in ((tmp_path, tmp_path / "keys"), (tmp_path / "cases", tmp_path), (tmp_path, tmp_path)):
        with pytest.raises(SealError, match="neither folder may hold the other"):
            make_cases([60], cases, keys, DURATION, 1, lambda _: None)
    with pytest.raises(SealError, match="holds no case"):
        names_in(tmp_path)


def test_after_a_case_that_exists_no_other_is_made(tmp_path: Path) -> None:
    cases, keys = tmp_path / "cases", tmp_path / "keys"
    (cases / "case_000").mkdir(parents=True)
    seed = NEIGHBOUR_AND_NONE[1]
    with pytest.raises(SealError, match="exists already"):
        make_cases([seed] * 8, cases, keys, DURATION, 1, lambda _: None)
    assert not active_children()
    assert len(names_in(cases)) < 8


def test_an_existing_case_is_not_overwritten(made: tuple[Path, Path, list[Made]]) -> None:
    cases, keys, done = made
    seed = json.loads((keys / f"{done[1].name}.json").read_text())["seed"]
    with pytest.raises(SealError, match="exists already"):
        seal(draw_case(seed, DURATION), done[1].name, cases, keys)
    write_seals(cases, {each.name: each.digest for each in done})  # the same list again
    opened(done[1].name, cases, keys)


def test_the_effect_acts_with_the_declared_gap_over_noise(made: tuple[Path, Path, list[Made]]) -> None:
    cases, keys, _ = made
    for name in names_in(cases):
        key = opened(name, cases, keys).key
        for effect in key["effects"]:
            assert RANGE[0] <= effect["ratio"] <= RANGE[1]
        if key["kind"] == "no_gap":
            assert key["ratio"] == pytest.approx(1.0, abs=1e-9) and key["effects"] == []
        else:
            assert key["ratio"] >= RANGE[0]


def test_what_the_tolerance_explains_is_no_gap() -> None:
    """Noise and a step along the numbers: gone inside their bounds, what is beyond a bound stays, size by size."""
    rng = np.random.default_rng(4)
    noise, slopes = rng.standard_normal((2, 4000)), 10.0 * rng.standard_normal((3, 2, 4000))
    noise[0, :50] = slopes[0, 1, :9] = np.nan
    low, high = np.full(3, -0.5), np.full(3, 0.5)
    inside = noise - np.tensordot([0.4, -0.3, 0.1], slopes, 1)
    assert left_by_numbers(inside, noise, slopes, low, high) == pytest.approx(1.0, abs=0.01)
    beyond = noise - np.tensordot([0.9, 0.0, 0.0], slopes, 1)
    assert left_by_numbers(beyond, noise, slopes, low, high) == pytest.approx(np.sqrt(1.0 + 4.0**2), rel=0.03)


@pytest.mark.parametrize("family", FAMILIES)
def test_numbers_are_scaled_as_they_were_put_wrong(family: str) -> None:
    rng = np.random.default_rng(5)
    true = draw_joint(rng, family)
    nominal, errors = believed(rng, true)
    again = true
    for where, error in errors.items():
        again = scaled(again, where, 1.0 + error)
    assert json.dumps(again) != json.dumps(true)
    flat = [each for part in ("link", "motors", "springs") for each in np.atleast_1d(again.get(part, []))]
    asked = [each for part in ("link", "motors", "springs") for each in np.atleast_1d(nominal.get(part, []))]
    for one, other in zip(flat, asked, strict=True):
        for key, value in other.items():
            if key != "law":
                assert one[key] == pytest.approx(value, rel=1e-5), key


def test_a_bag_is_read_back_as_it_was_recorded(made: tuple[Path, Path, list[Made]]) -> None:
    cases, keys, _ = made
    for name in names_in(cases)[1::3]:  # without a gap, and limited
        key = opened(name, cases, keys).key
        case = draw_case(key["seed"], DURATION)
        device = load_device(cases / name / "joint.yaml")
        measured, commands, _ = joint_signals(read_bag(cases / name / "bag"), device)
        assert commands is not None
        np.testing.assert_array_equal(measured["q"], case.log.q)
        np.testing.assert_allclose(measured.time, case.log.time - case.log.time[0], atol=2e-9)
        assert ("theta" in measured) == (key["level"] in ("full", "no_torque"))
        assert ("tau" in measured) == (device.drive == "torque" and key["level"] in ("full", "link_only"))
        asked = (
            commands["motor"]
            if device.drive == "torque"
            else np.column_stack([commands["equilibrium"], commands["preset"]])
        )
        np.testing.assert_array_equal(asked, case.log.commands)
        if "tau" in measured and key["jitter"] == 0.0 and key["lost"] == 0.0 and not key["effects"]:
            noise = measured["tau"][1:] - asked  # over the tick that ended at the sample
            assert np.std(noise) == pytest.approx(device.sensors.torque_noise, rel=0.1)


def test_limited_logs_lack_what_their_level_says() -> None:
    (seed,) = seeds_of("limited", 1, "link_only")
    case = draw_case(seed, 5.0)
    assert case.level == "link_only"
    for log in (case.log, case.withheld):
        assert np.isfinite(log.q).all() and np.isfinite(log.tau).all() and np.isnan(log.theta).all()
    whole = replace(case.log, theta=np.zeros_like(case.log.theta))
    for level, theta, tau in (("full", 1, 1), ("no_torque", 1, 0), ("link_only", 0, 1), ("commands_only", 0, 0)):
        left = limited(whole, level)
        assert (np.isfinite(left.theta).all(), np.isfinite(left.tau).all()) == (bool(theta), bool(tau))
        np.testing.assert_array_equal(left.commands, whole.commands)


def test_a_neighbour_alone_gives_nothing_away() -> None:
    """Joints without coupling have a neighbour too, now and then."""
    found = {bool(np.isfinite(draw_case(seed, 5.0).log.neighbour).any()) for seed in NEIGHBOUR_AND_NONE}
    assert found == {True, False}
    assert np.ptp(neighbour_angle(2.0, np.linspace(0.0, 6.0, 100))) > 0.5


def test_nothing_of_the_simulator_under_test_is_loaded() -> None:
    """Every module of the blind check, in a Python of its own."""
    folder = Path(sys.modules["via_gap.benchmark.case"].__file__ or "").parent
    names = ", ".join(f"via_gap.benchmark.{file.stem}" for file in folder.glob("*.py") if file.stem != "__init__")
    strangers = "('via_sim', 'via_estimators', 'via_controllers')"
    script = f"import sys, {names}; print([name for name in sys.modules if name.split('.')[0] in {strangers}])"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_neighbour_in_a_bag_is_an_input_of_the_diagnosis(tmp_path: Path) -> None:
    for seed in NEIGHBOUR_AND_NONE:
        case = draw_case(seed, DURATION)
        device = device_of(case.true)
        write_log(tmp_path / f"{seed}", device, case.log)
        commands = read_log(tmp_path / f"{seed}", device).commands
        assert commands is not None
        if np.isfinite(case.log.neighbour).all():
            expected = np.interp(commands.time, case.log.time - case.log.time[0], case.log.neighbour)
            assert np.abs(commands["neighbour"] - expected).max() < 1e-9
        else:
            assert "neighbour" not in commands
