"""Hand-made keys and reports for tests of scoring."""

from __future__ import annotations

from typing import Any

COULOMB = {"effect": "coulomb_friction", "site": "motor", "motor": 1}
LAG = {"effect": "actuator_lag", "site": "command", "motor": 0}


def key(kind: str, *effects: dict[str, Any], level: str = "full", **more: Any) -> dict[str, Any]:
    whole = [{"parameters": {}, **each} for each in effects]
    return {"kind": kind, "level": level, "family": "stiff", "ratio": 7.0, "effects": whole, **more}


def report(verdict: str, *causes: tuple[dict[str, Any], float], **more: Any) -> dict[str, Any]:
    named = [{**cause, "joint": "joint", "probability": p, "parameters": {}} for cause, p in causes]
    return {"verdict": verdict, "causes": named, "where": [], "equivalence_set": [], "gap": None, **more}


def where(*places: tuple[str, int]) -> list[dict[str, Any]]:
    return [{"joint": "joint", "site": site, "motor": motor, "equation": "", "share": 0.5} for site, motor in places]
