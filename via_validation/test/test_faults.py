"""The page of faulty and sound signals: figures of one device, misses in bold."""

from dataclasses import replace

from via_core.devices import load_device
from via_core.modulated_rows import IMPOSSIBLE
from via_validation.compare import faults, faults_page
from via_validation.provenance import provenance

DEVICE = load_device("visco_elastic_demo")


def test_a_fault_and_a_sound_variation_are_separated_and_shown(tmp_path):
    faulty = faults.fault_result(DEVICE, "torques reversed", faults.moved(DEVICE))
    assert faulty.impossible == faulty.named == 1.0 and max(faulty.ok.values()) == 0.0
    sound = faults.sound_result(DEVICE, "motor damping x 3")
    assert sound.implausible == 0.0 and sound.unexplained.max() < IMPOSSIBLE < faulty.unexplained.min()
    missed = replace(faulty, fault="torque frozen", ok={**faulty.ok, "residual": 0.5})
    faults_page.draw([faulty, missed], [sound], tmp_path / "faults.png")
    faults_page.write([faulty, missed], [sound], provenance("via faults"), "faults.png", tmp_path / "faults.md")
    page = (tmp_path / "faults.md").read_text("utf-8")
    assert (tmp_path / "faults.png").stat().st_size > 10_000
    cases = len(faulty.ok) + len(missed.ok)
    assert "**50 %**" in page and f"{cases - 1} of {cases} are within the limit" in page
    assert "Missed: visco_elastic_demo, torque frozen, residual." in page


def test_every_fault_and_variation_of_the_default_devices_can_be_made():
    for device in map(load_device, faults.DEVICES):
        for fault in faults.faults_of(device).values():
            channels = {name: values[:2100] for name, values in faults.moved(device).channels.items()}
            assert fault.change(channels).keys() == channels.keys()
    assert len(faults.variations_of(DEVICE)) == 12
