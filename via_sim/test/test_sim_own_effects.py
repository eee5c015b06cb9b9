"""Effects of another package: loaded by module or by file, refused in one line."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from via_core.errors import ParameterError
from via_sim.catalogue import EFFECTS
from via_sim.effects import Effect, own
from via_sim.effects.own import load_all, load_own, loaded

KIND = """from via_sim.catalogue import EFFECTS
from via_sim.catalogue.kinds import EffectKind, EffectParameter, Slot

def write(spot, value):
    spot["kinetic_friction"] += value["torque"]

KIND = EffectKind(
    name="seal", text="t", term="-torque s", confused_with="coulomb_friction: slow speeds", sites=("link",),
    parameters=(EffectParameter("torque", "N m", 0.0, 1.0, 0.0, "friction"),), write=write,
)
"""


@pytest.fixture(autouse=True)
def catalogue(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    before = dict(EFFECTS)
    monkeypatch.setattr(own, "_LOADED", [])
    yield
    EFFECTS.clear()
    EFFECTS.update(before)


def test_a_file_adds_an_effect(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(KIND + "EFFECTS[KIND.name] = KIND\n")
    assert load_own(str(tmp_path / "own.py")) == ("seal",)
    assert Effect("seal", "link", {"torque": 0.2}).parameters == {"torque": 0.2}
    assert str(tmp_path / "own.py") in loaded()
    load_all(loaded())  # what is there is not loaded again, which would be refused


def test_a_module_of_the_current_folder_adds_an_effect(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "seals_of_the_lab.py").write_text(KIND + "EFFECTS[KIND.name] = KIND\n")
    monkeypatch.chdir(tmp_path)
    assert load_own("seals_of_the_lab") == ("seal",)


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("x = 1\ny = 1 / 0\n", r"own\.py: cannot be imported: line 2: ZeroDivisionError"),
        ("x = (\n", r"cannot be imported: line 1: SyntaxError"),
        ("import no_such_module\n", "No module named 'no_such_module'"),
        (KIND, r"adds no effect; write EFFECTS\[kind.name\] = kind"),
        (KIND + "EFFECTS['payload'] = KIND\n", "replaces the effect 'payload'"),
        (KIND + "EFFECTS['other'] = KIND\n", "has the name 'seal'"),
        (KIND + "EFFECTS['seal'] = 3\n", "is int, not EffectKind"),
        (
            KIND + "import dataclasses\nEFFECTS['seal'] = dataclasses.replace(KIND, slots=(Slot('s', '', ''),))\n",
            "slots",
        ),
    ],
)
def test_what_cannot_be_an_effect_is_refused_and_leaves_no_trace(tmp_path: Path, code: str, words: str) -> None:
    before = dict(EFFECTS)
    (tmp_path / "own.py").write_text(code)
    with pytest.raises(ParameterError, match=words) as caught:
        load_own(str(tmp_path / "own.py"))
    assert "\n" not in str(caught.value) and before == EFFECTS


def test_names_that_do_not_exist_are_refused() -> None:
    for name, words in (("no/such.py", "no such file"), ("no_such_module", "No module named")):
        with pytest.raises(ParameterError, match=words):
            load_own(name)
