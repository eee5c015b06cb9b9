"""A few damaged files of each kind; `via fuzz` reads thousands."""

import numpy as np
import pytest
from via_core.bags.reader import read_bag
from via_core.devices import load_device
from via_core.errors import DeviceError
from via_validation.fuzz import run
from via_validation.fuzz.inputs import Kind, damaged, kinds
from via_validation.fuzz.page import write
from via_validation.fuzz.run import Result
from via_validation.provenance import provenance


@pytest.mark.parametrize("kind", list(kinds()))
def test_damaged_files_are_read_or_refused(kind):
    (result,) = run.batches(kind, 100, seed=1)
    assert result.faults == [] and result.read + result.refused == 100
    assert result.refused > 0 or kind == "bag"  # see below


def test_a_damaged_bag_is_remarked_or_has_its_content(tmp_path):
    """What is sound in a damaged bag is read, so that hardly any is refused; nothing wrong is read in silence."""

    def content(data):
        (tmp_path / "x.mcap").write_bytes(data)
        bag = read_bag(tmp_path / "x.mcap")
        values = {name: {each: column.tolist() for each, column in bag[name].fields.items()} for name in bag.topics}
        return bag.remarks, repr((values, {name: bag[name].stamp.tolist() for name in bag.topics}))

    (whole,) = kinds()["bag"].originals
    rng, (remarks, expected) = np.random.default_rng(1), content(whole)
    assert not remarks
    found = [content(damaged(rng, whole)) for _ in range(100)]
    assert sum(bool(remarks) for remarks, _ in found) > 90
    assert all(remarks or read == expected for remarks, read in found)


def test_a_loader_that_raises_something_else_is_a_fault(monkeypatch):
    def read(path):
        if path.read_bytes() != b"abcdef":
            raise ZeroDivisionError

    monkeypatch.setattr(run, "kinds", lambda: {"x": Kind(".x", (b"abcdef",), read)})
    result = run._read("x", range(5), 0)
    assert len(result.faults) + result.read == 5 and "ZeroDivisionError" in result.faults[0]


def test_an_error_with_values_and_lists_of_a_file_is_short(tmp_path):
    path = tmp_path / "x.yaml"
    path.write_text("name: x\nmotors: [" + "{inert: 1}, " * 50 + "]\n")
    with pytest.raises(DeviceError, match=r"x.yaml: .*motors\.1\.inert.*; and \d+ more$") as many:
        load_device(path)
    path.write_text("name: x\n" + "".join(f"{letter * 900}: 1\n" for letter in "klm"))
    with pytest.raises(DeviceError, match=r"x.yaml: .* \.\. .*is no known key$") as long:
        load_device(path)
    assert max(len(str(each.value)) for each in (many, long)) < 1600


def test_the_page_states_counts_faults_and_kinds_not_run(tmp_path):
    found = {"a": sum([Result(2, 1, 1), Result(3, 0, 2, ["a 4: `x`"], 1.5)], Result()), "b": Result(1, 1)}
    write(found, ["c"], 7, provenance("via fuzz"), tmp_path / "fuzz.md")
    text = (tmp_path / "fuzz.md").read_text()
    assert "| a | 5 | 1 | 3 | 1 | 1.5 |" in text and "| all | 6 | 2 | 3 | 1 | |" in text
    assert "`a 4: 'x'`" in text and "Not run: c." in text


def test_damage_is_the_same_for_a_seed():
    first, again = (damaged(np.random.default_rng(3), b"some text") for _ in range(2))
    assert first == again != b"some text"
