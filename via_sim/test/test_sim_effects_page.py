"""docs/effects.md equals the page made from the catalogue."""

from pathlib import Path

from via_sim.effects.page import page

PAGE = Path(__file__).resolve().parents[2] / "docs" / "effects.md"


def test_page_equals_the_catalogue():
    assert PAGE.read_text(encoding="utf-8") == page()
