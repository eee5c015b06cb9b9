"""docs/effects.md is the registry. `python via_sim/test/test_sim_effects_page.py` writes it anew."""

from pathlib import Path

from via_sim.catalogue import DEVICE_NUMBERS, EFFECTS

PAGE = Path(__file__).resolve().parents[2] / "docs" / "effects.md"
HEAD = """# Effects

One piece of unmodelled physics each. An effects file lists those a joint has; the simulator node, launch files and
`via sim` load it, and a diagnosis writes one:

```yaml
- effect: coulomb_friction
  site: motor
  motor: 1
  parameters: {torque: 0.02}
```

`motor` numbers motors and transmissions from 1; 0 there means both alike, which is one cause and not two. Sensors and
late channels count from 0, the link's. A rigid joint has no motor of its own; what its drive does wrong stands at
motor 1, and its drive's command is the external torque. Values outside the bounds are refused. At its neutral values
an effect is absent to the last bit. A parameter that may be left out is then neutral. `linear` marks numbers in which
the torques of the joint's equations are linear. In formulas v is the speed of the axis, s its sign, phi the
deflection of the transmission, u a command. An entry may have `intervals` beside its parameters, which nothing reads.
This page is written from the registry by `python via_sim/test/test_sim_effects_page.py`.

| Effect | Sites | What it adds | Most like, told apart by |
|---|---|---|---|
"""
NUMBERS = """Not an effect, but what a diagnosis fitted beside its effects: factors (0.1 to 10) on numbers of
the device file. They are written before the effects, wherever they stand in the file; with them a simulation has the
gap that the report claims, without them another.

```yaml
- effect: device_numbers
  site: device
  parameters: {link inertia: 1.03, spring 1 torque: 0.98}
```

Any of those that the joint has:

"""


def cell(text: str) -> str:
    return text.replace("|", "\\|")


def page() -> str:
    lines = [HEAD]
    for kind in EFFECTS.values():
        sites = ", ".join(kind.sites)
        lines.append(f"| [{kind.name}](#{kind.name}) | {sites} | `{cell(kind.term)}` | {cell(kind.confused_with)} |\n")
    for kind in EFFECTS.values():
        lines.append(f"\n## {kind.name}\n\n{kind.text[0].upper()}{kind.text[1:]}.\n\n")
        lines.append("| Parameter | Unit | From | To | Neutral | Linear | |\n|---|---|---|---|---|---|---|\n")
        for p in kind.all_parameters:
            linear = "yes" if p.linear else ""
            text = f"{p.text}; may be left out" if p in kind.optional else p.text
            lines.append(
                f"| {p.name} | {p.unit} | {p.low:.6g} | {p.high:.6g} | {p.neutral:.6g} | {linear} | {text} |\n"
            )
    lines.append(f"\n## {DEVICE_NUMBERS.name}\n\n{NUMBERS}")
    lines += [f"- `{p.name}`\n" for p in DEVICE_NUMBERS.optional]
    return "".join(lines)


def test_the_page_is_the_registry():
    assert PAGE.read_text(encoding="utf-8") == page()


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
