"""The page of all effects, docs/effects.md: `python -m via_sim.effects.page docs/effects.md` writes it."""

import sys
from pathlib import Path

from via_sim.catalogue import EFFECTS
from via_sim.effects.device_numbers import DEVICE_NUMBERS

HEAD = """# Effects

An effect is one piece of physics that the nominal model lacks. An effects file lists the effects of a joint. The
simulator node, launch files and `via sim` load it, and a diagnosis writes one:

```yaml
- effect: coulomb_friction
  site: motor
  motor: 1
  parameters: {torque: 0.02}
```

`motor` counts motors and transmissions from 1; 0 means both, with equal values. At the sites `sensor` and `timing`, 0
means the encoder of the link. A rigid joint has no motor of its own: its drive is motor 1, and the command of the drive
is the external torque.

Values outside the bounds are refused. At its neutral values an effect changes no bit of the simulation; optional
parameters default to neutral. `Linear` marks parameters in which the joint torques are linear. Entries may contain
`intervals`, which are ignored. In formulas, v is the speed of the axis, s its sign, phi the deflection of the
transmission, u a command.

`python -m via_sim.effects.page docs/effects.md` writes this page from the catalogue.

| Effect | Sites | Term | Similar to; distinguished by |
|---|---|---|---|
"""
NUMBERS = """Not an effect: factors (0.1 to 10) on numbers of the device file, which a diagnosis fitted together with
its effects. They apply before the effects, wherever they are in the file. The gap in the report refers to effects and
factors together.

```yaml
- effect: device_numbers
  site: device
  parameters: {link inertia: 1.03, spring 1 torque: 0.98}
```

Possible names, as far as the joint has these numbers:

"""


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def page() -> str:
    """The page as Markdown text."""
    lines = [HEAD]
    for kind in EFFECTS.values():
        sites = ", ".join(kind.sites)
        lines.append(
            f"| [{kind.name}](#{kind.name}) | {sites} | `{_cell(kind.term)}` | {_cell(kind.confused_with)} |\n"
        )
    for kind in EFFECTS.values():
        lines.append(f"\n## {kind.name}\n\n{kind.text[0].upper()}{kind.text[1:]}.\n\n")
        lines.append("| Parameter | Unit | From | To | Neutral | Linear | |\n|---|---|---|---|---|---|---|\n")
        for p in kind.all_parameters:
            linear = "yes" if p.linear else ""
            text = f"{p.text}; optional" if p in kind.optional else p.text
            lines.append(
                f"| {p.name} | {p.unit} | {p.low:.6g} | {p.high:.6g} | {p.neutral:.6g} | {linear} | {text} |\n"
            )
    lines.append(f"\n## {DEVICE_NUMBERS.name}\n\n{NUMBERS}")
    lines += [f"- `{p.name}`\n" for p in DEVICE_NUMBERS.optional]
    return "".join(lines)


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page(), encoding="utf-8")
