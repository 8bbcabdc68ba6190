"""A file is parsed once in a process, and no dictionary sees what another one does."""

from __future__ import annotations

from pathlib import Path

import pytest
import sample_eds

from canfb.device.od import eds
from canfb.device.od.dictionary import Dictionary, Entry

SHIPPED = sorted((Path(__file__).parents[2] / "eds").glob("*.eds"))
HOOKS = ("on_read", "on_check", "on_written", "on_download")


def facts(entry: Entry) -> tuple[object, ...]:
    return tuple(getattr(entry, name) for name in Entry.__slots__)


def all_facts(dictionary: Dictionary) -> list[tuple[object, ...]]:
    return [facts(entry) for entry in dictionary]


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """Which files canopen has parsed, from empty templates on."""
    made: list[object] = []
    real = eds.import_od

    def counted(*arguments: object) -> object:
        made.append(arguments[0])
        return real(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(eds, "import_od", counted)
    eds._file.cache_clear()
    eds._template.cache_clear()
    return made


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: str(path.stem))
def test_what_is_done_to_one_dictionary_reaches_no_other(path: Path) -> None:
    untouched = all_facts(Dictionary.load(path, 7))
    first, other = Dictionary.load(path, 7), Dictionary.load(path, 7)
    for entry in first:
        entry.value, entry.default, entry.low, entry.high = b"value", b"default", 1.0, 2.0
        entry.access, entry.name = "const", "another name"
        for hook in HOOKS:
            setattr(entry, hook, lambda *_: pytest.fail("the hook of another dictionary"))
    first.dummies = frozenset({1})
    assert all_facts(other) == untouched
    assert all_facts(Dictionary.load(path, 7)) == untouched
    assert other.dummies == Dictionary.load(path, 7).dummies != first.dummies
    assert not {id(entry) for entry in first} & {id(entry) for entry in other}
    assert all(getattr(entry, hook) is None for entry in other for hook in HOOKS)


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: str(path.stem))
def test_a_fresh_entry_has_every_fact_of_the_first(path: Path) -> None:
    for entry in Dictionary.load(path, 9):
        assert facts(entry.fresh()) == facts(entry)


def test_one_content_is_parsed_once_for_every_node_and_every_path(
    tmp_path: Path, calls: list[object]
) -> None:
    paths = [sample_eds.write(tmp_path / f"{number}.eds") for number in range(3)]
    for path in paths:
        for node_id in (1, 32, 32, 127, 255):
            assert Dictionary.load(path, node_id).entry(0x1014).value == 0x80 + node_id
    assert len(calls) == 1


def test_a_file_that_has_changed_is_read_again(tmp_path: Path, calls: list[object]) -> None:
    path = sample_eds.write(tmp_path / "device.eds")
    before = Dictionary.load(path, 3)
    path.write_text(path.read_text().replace("a sample device!", "another sample!!"))
    assert Dictionary.load(path, 3).entry(0x1008).value == "another sample!!"
    assert before.entry(0x1008).value == "a sample device!"
    assert len(calls) == 2


def test_a_file_that_is_refused_is_refused_again_with_its_own_name(tmp_path: Path) -> None:
    for name in ("one.eds", "two.eds", "two.eds"):
        path = tmp_path / name
        path.write_text(sample_eds.HEAD + "[2100]\nParameterName=x\nDataType=0x17\nAccessType=rw\n")
        with pytest.raises(ValueError, match=rf"{name}: \[2100\]: 2100h:00 has the unknown data type"):
            Dictionary.load(path, 5)
