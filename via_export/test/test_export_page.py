"""docs/export.md equals the page of the table of slots; `python via_export/test/test_export_page.py` writes it."""

from __future__ import annotations

from pathlib import Path

from via_core.device_parts import Link, Sensors
from via_core.devices import Device
from via_export.slots import FORMATS, TITLES, Row
from via_export.slots_device import DEVICE_ROWS
from via_export.slots_effects import EFFECT_ROWS
from via_sim.catalogue import EFFECTS
from via_sim.effects.device_numbers import DEVICE_NUMBERS

PAGE = Path(__file__).resolve().parents[2] / "docs" / "export.md"
HEAD = """# Export to other simulators

`via export` writes a device with the effects of a report, or of an effects file, for another simulator:

```
via export report.json --device my_joint.yaml --out my_joint.xml                     # a model of the joint alone
via export repair.yaml --device my_joint.yaml --to urdf --into robot.urdf --joint elbow --out repaired.urdf
via export report.json --device my_joint.yaml --check my_bag --out my_joint.xml      # MuJoCo simulates the log
```

```python
from via_core.devices import load_device
from via_export import check, export
from via_sim.effects.files import load_effects

made = export(load_device("my_joint.yaml"), load_effects("repair.yaml"), "urdf")   # text, losses, notes
```

With `--into` the given file (MuJoCo, URDF, SDF or BAM) is edited and written to `--out`: the joint gets the friction,
drive and springs of the device; mass and inertia of the bodies are kept, and only their changes are added. Notes, which
are printed and written at the head of the file, state what was replaced, what the control of a new drive is, and what
must be done by hand. Numbers that the device does not know (armature, limits, a spring) are kept. In MJCF, new elements
have a class of their own, `via_export`, so that defaults of the file do not change them, and MuJoCo loads the model
before it is written. Other joints are not changed. What all joints of an arm feel (`report_payload.json`,
`report_body.json`, `report_offset.json`, `report_gravity.json`) is written into its URDF or MJCF file, one report after
the other, without a device.

A device file does not state whether its joint turns or slides. A model of the joint alone turns; with `--into`, the
joint stays what it is.

`--check` simulates a log with the exported model in MuJoCo and states the gap before and after the repair, beside the
same figures of `via_sim` and of the report. Both simulators start from the same states under the same commands.

A format has a slot for an effect, or there is a closest substitute at a cost, or nothing. The command prints a list of
what is lost, and writes it at the head of the file (JSON has no comments). Both come from the tables below, which
`python via_export/test/test_export_page.py` writes from `via_export/slots_effects.py` and `slots_device.py`.

## How close MuJoCo comes

In the tests of `via_export`, MuJoCo reproduces `via_sim` within 0.2 % of the standard deviation of the motion for every
effect with a slot. The step is 0.25 ms or less with RK4; where elements have memory (bristles, slipping springs), a
quarter of that with Euler, because MuJoCo updates them once per step. Series arrangements keep their motors: each has a
body, and springs are tendons. A nonlinear spring is a sum of tendons with dead bands, which is a cubic spline; a spring
between levers is a spatial tendon.

`via gap exports` exports the repairs of sealed cases and of real robots, simulates their recordings in MuJoCo and reads
every file with MuJoCo, pinocchio, urdfdom and libsdformat: [results](results/export.md). Where MJCF has a slot, MuJoCo
has the gap of the report; friction that grows with the load has none, and costs most on the XL330 servos.

URDF, Isaac Lab and BAM have one motor per joint and no spring: inertia and friction of the motors are added to the
joint, and the resonance is lost.

## Overview

**+** slot, **~** substitute, **-** none.

"""
MARKS = {"slot": "+", "substitute": "~", "none": "-"}


def cell(text: str) -> str:
    return text.replace("|", "\\|")


def title(line: Row) -> str:
    return f"{line.item}, {line.when}" if line.when else line.item


def overview(rows: tuple[Row, ...], of: str) -> list[str]:
    names = " | ".join(TITLES[name] for name in FORMATS)
    lines = [f"| {of} | {names} |\n|---|{'---|' * len(FORMATS)}\n"]
    for line in rows:
        lines.append(f"| {title(line)} | {' | '.join(MARKS[line.slots[name].kind] for name in FORMATS)} |\n")
    return lines


def page() -> str:
    lines = [HEAD, *overview(EFFECT_ROWS, "Effect"), "\n", *overview(DEVICE_ROWS, "Device file")]
    for name in FORMATS:
        lines.append(f"\n## {TITLES[name]}\n\n| | Slot or substitute | What is lost |\n|---|---|---|\n")
        none: dict[str, list[str]] = {}
        for line in (*EFFECT_ROWS, *DEVICE_ROWS):
            slot = line.slots[name]
            if slot.where:
                lines.append(f"| {title(line)} | {cell(slot.where)} | {cell(slot.cost)} |\n")
            else:
                none.setdefault(slot.cost, []).append(title(line))
        lines.append("\nWithout a slot or substitute:\n\n")
        lines += [f"- {cost}: {'; '.join(titles)}\n" for cost, titles in none.items()]
    return "".join(lines)


def test_page_equals_the_table() -> None:
    assert PAGE.read_text(encoding="utf-8") == page()


def test_every_effect_is_in_the_table() -> None:
    assert {line.item for line in EFFECT_ROWS} == {*EFFECTS, DEVICE_NUMBERS.name}


def test_a_slot_costs_nothing_and_anything_else_states_what_is_lost() -> None:
    for line in (*EFFECT_ROWS, *DEVICE_ROWS):
        for name in FORMATS:
            slot = line.slots[name]
            assert bool(slot.cost) == (slot.kind != "slot"), (line.item, name)
            assert bool(slot.where) == (slot.kind != "none"), (line.item, name)


def test_every_entry_of_a_device_file_has_a_line() -> None:
    lines = " ".join(line.item for line in DEVICE_ROWS)
    about = set(Device.model_fields) - {*("name", "title", "source", "confidence", "remark", "arrangement", "drive"),
                                        *("observed", "tolerances", "wire")}  # fmt: skip
    for entry in about:
        assert entry in lines, entry
    assert {"inertia", "gravity", "friction"} <= {line.item.split(": ")[-1] for line in DEVICE_ROWS}
    assert Link.model_fields and Sensors.model_fields


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
