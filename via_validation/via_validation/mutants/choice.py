"""Which mutations are tried: a seeded sample over the numerical heart, and named ones from outside."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

import numpy as np
import yaml
from via_core.errors import ViaError

from via_validation.mutants.operators import Mutation, mutations_of

# Modules that compute; those that only declare, read or show are tested in other ways.
HEART = (
    *(
        f"via_core/via_core/{name}.py"
        for name in ("weak_form", "plausibility", "springs", "servos", "dampers", "metrics")
    ),
    "via_estimators/via_estimators/*.py",
    "via_controllers/via_controllers/correction.py",
    "via_controllers/via_controllers/arms/*.py",
    "via_controllers/via_controllers/joints/*.py",
    "via_controllers/via_controllers/supervision/*.py",
    "via_sim/via_sim/joint/*.py",
    "via_sim/via_sim/lockstep/*.py",
    "via_sim/via_sim/robots/*.py",
    "via_gap/via_gap/residual/*.py",
    "via_gap/via_gap/selection/*.py",
    "via_gap/via_gap/candidates/*.py",
)
MOST = 60  # mutations of a module that count for its share: long tables of equations do not displace short rules
LISTS = "mutants/lists.yaml"


def candidates(root: Path) -> dict[str, list[Mutation]]:
    """Module -> its mutations, for every module of the heart below `root`."""
    paths = sorted({path for pattern in HEART for path in root.glob(pattern)})
    found = {}
    for path in paths:
        name = path.relative_to(root).as_posix()
        if mutations := mutations_of(name, path.read_text(encoding="utf-8")):
            found[name] = mutations
    if not found:
        raise ViaError(f"{root} is not a checkout of this repository: run the command in one")
    return found


def sampled(found: dict[str, list[Mutation]], count: int, seed: int) -> list[Mutation]:
    """`count` different mutations; a module's share is its number of mutations, at most MOST."""
    random = np.random.default_rng(seed)
    weights = np.concatenate([np.full(len(each), min(len(each), MOST) / len(each)) for each in found.values()])
    every = [mutation for each in found.values() for mutation in each]
    picked = random.choice(len(every), size=min(count, len(every)), replace=False, p=weights / weights.sum())
    return [every[k] for k in sorted(picked)]


def listed(root: Path, kind: str) -> list[tuple[Mutation, str]]:
    """Mutations of the list `kind` (named, equivalent), each with the list's words about it.

    An entry has a path, the line of code (stripped) and in it the text before and after. Raises ViaError for an entry
    that does not fit the sources exactly once.
    """
    entries: Sequence[dict[str, str]] = yaml.safe_load(files("via_validation").joinpath(LISTS).read_text("utf-8"))[kind]
    return [(_located(root, entry), entry["why"]) for entry in entries]


def _located(root: Path, entry: dict[str, str]) -> Mutation:
    path, code, before = entry["path"], entry["code"], entry["before"]
    lines = (root / path).read_text(encoding="utf-8").splitlines(keepends=True)
    at = [k for k, line in enumerate(lines) if line.strip() == code]
    if len(at) != 1 or code.count(before) != 1:
        raise ViaError(f"{LISTS}: {before!r} in {code!r} is found {len(at)} times in {path}, and must be found once")
    start = sum(map(len, lines[: at[0]])) + lines[at[0]].index(before)
    return Mutation(path, at[0] + 1, start, start + len(before), before, entry["after"], code)
