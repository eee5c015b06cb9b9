"""Cases: reproducible from the seed, with the declared gap, keys kept apart, and no mention of the effect."""

from __future__ import annotations

import hashlib
import json
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from multiprocessing import active_children
from pathlib import Path

import numpy as np
import pytest
import yaml
from via_core.bags.joints import joint_signals
from via_core.bags.reader import read_bag
from via_core.devices import Device, load_device
from via_gap.logs.log import read_log
from via_validation.commands.gap_blind import SEED
from via_validation.sealed.case import FAR_RANGE, RANGE, _rates, _windows, draw_case
from via_validation.sealed.catalogue import CATALOGUE
from via_validation.sealed.joints import CONTROLLED, FAMILIES, POSITIONED, believed, device_of, draw_joint, scaled
from via_validation.sealed.making import Made, make_cases
from via_validation.sealed.plan import BLOCK, KINDS, Plan, block_of, plan
from via_validation.sealed.planted import DIRT
from via_validation.sealed.recording import LEVELS, limited, neighbour_angle, write_log
from via_validation.sealed.residual import ratio_after_fit
from via_validation.sealed.running import run_cases
from via_validation.sealed.sealing import SealError, digest_of, logs_in, names_in, opened, seal, write_seals
from via_validation.sealed.selections import OF_BOTH, OF_POSITION
from via_validation.sealed.unmodelled import UNMODELLED

DURATION = 5.0  # [s]
pytestmark = pytest.mark.timeout(400)  # [s] the first test that asks for the cases also makes them


def seeds_where(wanted: Callable[[Plan], bool], count: int = 1) -> list[int]:
    """The first development seeds whose plan is as wanted."""
    return [s for s in range(1, 2000) if wanted(plan(s))][:count]


KINDS_OF_CASE: dict[str, Callable[[Plan], bool]] = {
    "single": lambda each: each.kind == "single" and each.level == "full" and not each.family and not each.both,
    "no_gap": lambda each: each.kind == "no_gap" and each.level == "full" and not each.family,
    "unknown": lambda each: each.kind == "unknown" and not each.family,
    "pair": lambda each: each.kind == "pair",
    "link_only": lambda each: each.kind == "single" and each.level == "link_only",
    "both": lambda each: each.both,
    "controlled": lambda each: each.family == CONTROLLED and each.kind == "single",
    "position": lambda each: each.family == POSITIONED and each.kind == "single",
}


@pytest.fixture(scope="module")
def with_and_without_neighbour() -> dict[bool, int]:
    """Development seeds of joints without a gap, as far as there are any."""
    found: dict[bool, int] = {}
    for seed in seeds_where(KINDS_OF_CASE["no_gap"], 100):
        found.setdefault(bool(np.isfinite(draw_case(seed, 5.0).logs[0].neighbour).any()), seed)
        if len(found) == 2:
            break
    return found


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, list[Made]]:
    """One case of every kind, in two folders."""
    folder = tmp_path_factory.mktemp("blind")
    seeds = [seeds_where(wanted, 2)[-1 if name == "controlled" else 0] for name, wanted in KINDS_OF_CASE.items()]
    progress: list[Made] = []
    done = make_cases(seeds, folder / "cases", folder / "keys", DURATION, 1, progress.append)
    assert sorted(each.name for each in progress) == [each.name for each in done]
    return folder / "cases", folder / "keys", done


def test_a_block_of_seeds_holds_every_effect_once_and_its_shares() -> None:
    begin = SEED
    assert begin % BLOCK == 0
    plans = [plan(s) for s in range(begin, begin + BLOCK)]
    free = [each for each in plans if not each.family and not each.both]
    assert sorted(each.effect for each in free if each.kind == "single" and each.level == "full") == sorted(CATALOGUE)
    assert Counter(map(str, plans)) == Counter(map(str, block_of(begin // BLOCK)))
    assert {each.kind for each in plans} == set(KINDS)
    for kind in ("single", "no_gap", "unknown", "pair"):
        assert {each.level for each in plans if each.kind == kind} >= set(LEVELS[:1])
    assert {each.level for each in plans if each.kind == "no_gap"} == set(LEVELS)
    assert sorted(each.effect for each in plans if each.family == POSITIONED and each.kind == "single") == sorted(
        OF_POSITION
    )
    assert all(each.level == LEVELS[-1] for each in plans if each.family == POSITIONED)
    assert [plan(s) for s in range(BLOCK)] != [plan(s) for s in range(BLOCK, 2 * BLOCK)]  # another order
    four = [plan(s) for s in range(begin, begin + 4 * BLOCK)]
    assert {each.effect for each in four if each.kind == "unknown"} == set(UNMODELLED)
    assert {each.effect for each in four if each.both} == set(OF_BOTH)
    limited_levels = Counter(each.level for each in four if each.kind == "single" and not each.family)
    assert all(limited_levels[level] >= 20 for level in LEVELS[1:])


@pytest.mark.parametrize("count", [len(CATALOGUE), len(CATALOGUE) - 1])
def test_effects_take_turns_in_the_smaller_signal_sets_of_all_blocks(
    monkeypatch: pytest.MonkeyPatch, count: int
) -> None:
    """An even and an odd number of them."""
    names = list(CATALOGUE)[:count]
    monkeypatch.setattr("via_validation.sealed.plan.CATALOGUE", {name: CATALOGUE[name] for name in names})
    blocks = [block_of(block) for block in range(3 * count)]
    assert len({len(each) for each in blocks}) == 1 and (len(blocks[0]) == BLOCK) == (count == len(CATALOGUE))
    singles = [each for block in blocks for each in block if each.kind == "single" and not each.family]
    fewer = {(each.effect, each.level) for each in singles if each.level != "full"}
    assert fewer == {(name, level) for name in names for level in LEVELS[1:]}


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
    fields = {"coulomb_friction", "viscous_friction", "link_inertia"}  # of device files
    column = {b"external_torque"}  # of every rigid joint's table
    words = {word.encode() for word in (*CATALOGUE, *UNMODELLED)} - {word.encode() for word in fields}
    for name in names_in(cases):
        there = {file.relative_to(cases / name).as_posix() for file in (cases / name).rglob("*") if file.is_file()}
        rest = there - {"joint.yaml", "README.md", "seal.txt"}
        table = any(each.endswith(".csv") for each in rest)
        one = r"log(_\d\d)?\.csv" if table else r"bag(_\d\d)?/(bag(_\d\d)?_0\.mcap|metadata\.yaml)"
        assert rest and all(re.fullmatch(one, each) for each in rest) and len(rest) < len(there) - 2
        for file in (cases / name).rglob("*"):
            if file.is_file():
                content = file.read_bytes()
                assert not [word for word in words - (column if table else set()) if word in content]
                assert str(keys).encode() not in content
        for word in fields:
            assert word.encode() not in (cases / name / "README.md").read_bytes()
    sealed = opened(names_in(cases)[3], cases, keys).key
    assert len(sealed["effects"]) == 2  # the key does name them


def test_seals_are_the_sha256_of_the_keys(made: tuple[Path, Path, list[Made]]) -> None:
    cases, keys, done = made
    listed = dict(line.split()[::-1] for line in (cases / "seals.txt").read_text().splitlines())
    for each in done:
        assert hashlib.sha256((keys / f"{each.name}.json").read_bytes()).hexdigest() == each.digest
        assert listed[f"{each.name}.json"] == each.digest == (cases / each.name / "seal.txt").read_text().strip()


def test_tampering_is_detected(made: tuple[Path, Path, list[Made]], tmp_path: Path) -> None:
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
    with pytest.raises(SealError, match="differs from the sealed one"):
        opened(name, cases, keys)
    cases, keys = copy(tmp_path / "both")  # a new key with a new seal in the case, but not in the list
    key = keys / f"{name}.json"
    key.write_text(key.read_text() + " ")
    (cases / name / "seal.txt").write_text(hashlib.sha256(key.read_bytes()).hexdigest() + "\n")
    with pytest.raises(SealError, match="differs from the sealed one"):
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


def test_an_existing_case_ends_the_command_without_further_cases(tmp_path: Path) -> None:
    cases, keys = tmp_path / "cases", tmp_path / "keys"
    (cases / "case_000").mkdir(parents=True)
    (seed,) = seeds_where(KINDS_OF_CASE["no_gap"])
    with pytest.raises(SealError, match="exists already"):
        make_cases([seed] * 8, cases, keys, DURATION, 1, lambda _: None)
    assert not active_children()
    assert len(names_in(cases)) < 8
    for name in names_in(cases):
        opened(name, cases, keys)  # what was finished can be used


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
        most = FAR_RANGE[1] if key["family"] == CONTROLLED else RANGE[1]
        for effect in key["effects"]:
            assert RANGE[0] <= effect["ratio"] <= most and effect["beyond"] >= RANGE[0]
        if key["kind"] == "no_gap":
            assert key["ratio"] == pytest.approx(1.0, abs=1e-9) and key["effects"] == []
        else:
            assert key["ratio"] >= RANGE[0]


def test_a_gap_within_the_tolerance_of_the_parameters_is_no_gap() -> None:
    """Noise plus a step of the parameters: the fit removes the part within the bounds and leaves the rest."""
    rng = np.random.default_rng(4)
    noise, slopes = rng.standard_normal((2, 4000)), 10.0 * rng.standard_normal((3, 2, 4000))
    noise[0, :50] = slopes[0, 1, :9] = np.nan
    low, high = np.full(3, -0.5), np.full(3, 0.5)
    inside = noise - np.tensordot([0.4, -0.3, 0.1], slopes, 1)
    assert ratio_after_fit(inside, noise, slopes, low, high) == pytest.approx(1.0, abs=0.01)
    beyond = noise - np.tensordot([0.9, 0.0, 0.0], slopes, 1)
    assert ratio_after_fit(beyond, noise, slopes, low, high) == pytest.approx(np.sqrt(1.0 + 4.0**2), rel=0.03)


@pytest.mark.parametrize("family", FAMILIES)
def test_scaling_by_the_errors_gives_the_nominal_device(family: str) -> None:
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


def test_a_recording_is_read_back_as_it_was_made(made: tuple[Path, Path, list[Made]]) -> None:
    cases, keys, _ = made
    for name in names_in(cases)[1::2]:
        key = opened(name, cases, keys).key
        case, files = draw_case(key["seed"], DURATION), logs_in(cases / name)
        assert len(files) == len(case.logs) == key["recordings"]
        assert (key["dirt"] is None) == (case.dirt is None) and key["quality"] == case.recorder.quality
        for file, log in zip(files, case.logs, strict=True):
            if file.suffix == ".csv":
                asked = "equilibrium" if key["family"] == POSITIONED else "external_torque"
                table = np.genfromtxt(file, delimiter=",", names=True)
                assert {"time", "q", asked} <= set(table.dtype.names or ())
                np.testing.assert_allclose(table["q"], log.q, rtol=1e-11)
                np.testing.assert_allclose(table[asked], log.commands[:, 0], rtol=1e-11)
                continue
            device = load_device(cases / name / "joint.yaml")
            measured, commands, _ = joint_signals(read_bag(file), device)
            assert commands is not None
            np.testing.assert_array_equal(measured["q"], log.q)
            np.testing.assert_allclose(measured.time - measured.time[0], log.time - log.time[0], atol=2e-9)
            assert ("theta" in measured) == (key["level"] in ("full", "no_torque"))
            assert ("tau" in measured) == (device.drive == "torque" and key["level"] in ("full", "link_only"))
            names = ["motor"] if device.drive == "torque" else ["equilibrium", "preset"]
            np.testing.assert_array_equal(np.column_stack([commands[each] for each in names]), log.commands)


def test_the_device_file_states_the_logging_rate_and_not_the_noise(made: tuple[Path, Path, list[Made]]) -> None:
    cases, keys, _ = made
    for name in names_in(cases):
        key, content = opened(name, cases, keys).key, yaml.safe_load((cases / name / "joint.yaml").read_text())
        assert content["sensors"]["rate"] in (100.0, 250.0, 500.0, 1000.0)
        assert content["sensors"]["rate"] * key["recorder"]["every"] == key["control_rate"]
        assert not [each for each in content["sensors"] if "encoder" in each or each == "noise"]
        assert (content.get("tolerances", {}).get("link_inertia", 0.05)) == key["tolerance"]
        assert max(map(abs, key["nominal_errors"].values())) <= key["tolerance"]
        assert (content.get("drive") == "position") == (key["family"] == POSITIONED) == ("servo" in content)
        if "servo" in content:
            assert {"kp", "kd", "torque_limit", "delay"} <= set(content["servo"])


def test_a_separate_process_can_read_every_kind_of_case(made: tuple[Path, Path, list[Made]]) -> None:
    """All recordings of a case are arguments of one command, and each is a log that can be simulated."""
    cases, keys, _ = made
    results = cases.parent / "read"
    script = cases.parent / "reads.py"
    script.write_text(
        "import json, sys\n"
        "from via_core.devices import Device, load_device\n"
        "from via_gap.logs.log import read_logs\n"
        "*files, device, out = sys.argv[1:]\n"
        "logs = read_logs(files, load_device(device))\n"
        "json.dump([[log.level, log.drivable, log.duration] for log in logs], open(out, 'w'))\n"
    )
    ran = run_cases(cases, results, f"{sys.executable} {script} {{bag}} {{device}} {{json}}", 60.0, 1, lambda _: None)
    for each in ran:
        key = opened(each.name, cases, keys).key
        if key["family"] == POSITIONED and "servo" not in Device.model_fields:
            assert "drive" in each.said  # this checkout has no position drives yet
            continue
        assert each.code == 0, each.said
        read = json.loads((results / f"{each.name}.json").read_text())
        assert len(read) == key["recordings"] and all(drivable for _, drivable, _ in read)
        if key["family"] not in ("rigid", CONTROLLED, POSITIONED):
            wanted = {"encoder_and_command": "commands only" if "servo" in key["true_device"].get("drive", "") else ""}
            level = wanted.get(key["level"]) or key["level"].replace("_", " ")
            assert {each for each, _, _ in read} <= {level, "link only"}


def test_limited_logs_lack_the_signals_that_their_level_leaves_out() -> None:
    (seed,) = seeds_where(KINDS_OF_CASE["link_only"])
    case = draw_case(seed, 5.0)
    assert case.level == "link_only"
    for log in (*case.logs, case.withheld):
        assert np.isfinite(log.q).all() and np.isfinite(log.tau).all() and np.isnan(log.theta).all()
    whole = replace(case.withheld, theta=np.zeros_like(case.withheld.theta))
    for level, theta, tau in (("full", 1, 1), ("no_torque", 1, 0), ("link_only", 0, 1), (LEVELS[-1], 0, 0)):
        left = limited(whole, level)
        assert (np.isfinite(left.theta).all(), np.isfinite(left.tau).all()) == (bool(theta), bool(tau))
        np.testing.assert_array_equal(left.commands, whole.commands)


def test_only_single_and_pair_cases_are_dirty(made: tuple[Path, Path, list[Made]]) -> None:
    cases, keys, _ = made
    sealed = [opened(name, cases, keys).key for name in names_in(cases)]
    assert {bool(key["dirt"]) for key in sealed if key["kind"] in ("single", "pair")} == {True, False}
    for key in sealed:
        assert key["dirt"] is None or key["kind"] in ("single", "pair")
        if key["dirt"]:
            assert key["dirt"]["effect"] in UNMODELLED and DIRT[0] <= key["dirt"]["share"] <= DIRT[1]


def test_rates_and_short_recordings_are_drawn_with_their_probabilities() -> None:
    rng = np.random.default_rng(1)
    windows = [_windows(rng, 40.0, {"coulomb_friction"}) for _ in range(2000)]
    short = [each for each in windows if each]
    assert 0.12 < len(short) / len(windows) < 0.18
    assert {len(each) for each in short} == set(range(10, 21))
    for each in short:
        lengths = [end - begin for begin, end in each]
        assert np.ptp(lengths) < 1e-9 and 1.0 <= lengths[0] <= 2.0
        assert all(after[0] >= before[1] for before, after in pairwise(each))
    assert not any(_windows(rng, 40.0, {"stiffness_drift"}) for _ in range(200))  # time counts from the first sample
    for family in (*FAMILIES, CONTROLLED, POSITIONED):
        drawn = [_rates(rng, family) for _ in range(400)]
        shares = Counter(rate for rate, _ in drawn)
        assert set(shares) == {100.0, 250.0, 500.0, 1000.0} and min(shares.values()) > 60
        assert all(loop % rate == 0.0 and loop >= rate for rate, loop in drawn)
        loops = {"controlled_motor": {1000.0}, "position_drive": set(shares)}
        assert {loop for _, loop in drawn} == loops.get(family, {loop for _, loop in drawn})


def test_a_neighbour_does_not_reveal_the_coupling(with_and_without_neighbour: dict[bool, int]) -> None:
    """Some joints without coupling have a neighbour too."""
    assert set(with_and_without_neighbour) == {True, False}
    assert np.ptp(neighbour_angle(2.0, np.linspace(0.0, 6.0, 100))) > 0.5


def test_the_second_simulator_imports_nothing_of_the_first() -> None:
    """Import every module of the sealed benchmark in a new Python process."""
    folder = Path(sys.modules["via_validation.sealed.case"].__file__ or "").parent
    names = ", ".join(f"via_validation.sealed.{file.stem}" for file in folder.glob("*.py") if file.stem != "__init__")
    forbidden = "('via_sim', 'via_estimators', 'via_controllers')"
    script = f"import sys, {names}; print([name for name in sys.modules if name.split('.')[0] in {forbidden}])"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_neighbour_in_a_log_is_an_input_of_the_diagnosis(
    tmp_path: Path, with_and_without_neighbour: dict[bool, int]
) -> None:
    for seed in with_and_without_neighbour.values():
        case = draw_case(seed, DURATION)
        device, (log, *_) = device_of(case.true), case.logs
        file = tmp_path / (f"{seed}" if device.motors else f"{seed}.csv")
        write_log(file, device, log)
        commands = read_log(file, device).commands
        assert commands is not None
        if np.isfinite(log.neighbour).all():
            expected = np.interp(commands.time, log.time - log.time[0], log.neighbour)
            assert np.abs(commands["neighbour"] - expected).max() < 1e-9
        else:
            assert "neighbour" not in commands
