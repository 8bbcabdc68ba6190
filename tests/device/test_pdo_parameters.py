from __future__ import annotations

from pathlib import Path

import pytest
import sample_eds
from device_kit import ID, OK, Bench

from canfb.cia301.codes import AbortCode
from canfb.device.node import Node
from canfb.device.od.dictionary import Dictionary

NOT_MAPPABLE = AbortCode.NOT_MAPPABLE

OFF = {0x1400: 0x80000190, 0x1401: 0x80000320, 0x1800: 0xC00001A0, 0x1801: 0x800002A0}
FREE = 0x80000000


def remap(bench: Bench, index: int, mappings: list[int]) -> list[AbortCode | str]:
    """The procedure of CiA 301, 7.5.2.36, with the answer to each step."""
    number_of = index + 0x200
    answers = [bench.write(index, 1, OFF[index], 4), bench.write(number_of, 0, 0, 1)]
    answers += [bench.write(number_of, sub, value, 4) for sub, value in enumerate(mappings, 1)]
    answers.append(bench.write(number_of, 0, len(mappings), 1))
    answers.append(bench.write(index, 1, OFF[index] & ~FREE, 4))
    return answers


def test_the_whole_procedure(bench: Bench) -> None:
    assert remap(bench, 0x1800, [0x20100210]) == [OK] * 5
    bench.operational()
    bench.dictionary.entry(0x2010, 2).value = 0x1234
    bench.node.trigger_tpdo(1, bench.now)
    assert bench.tick() == ["1A0#3412"]


def test_it_takes_effect_in_operational_too(bench: Bench) -> None:
    bench.operational()
    assert remap(bench, 0x1400, [0x20000210, 0x20000110]) == [OK] * 6
    bench.send(0x190, "01000200")
    assert bench.dictionary.entry(0x2000, 2).value == 1
    assert bench.dictionary.entry(0x2000, 1).value == 2


@pytest.mark.parametrize(
    ("index", "mapping", "expected"),
    [
        (0x1400, 0x20000110, OK),
        (0x1400, 0x20000720, OK),
        (0x1400, 0x20100720, OK),
        (0x1400, 0x00020008, OK),
        (0x1400, 0x00070020, OK),
        (0x1400, 0x00010001, OK),
        (0x1400, 0x00020010, NOT_MAPPABLE),
        (0x1400, 0x00020108, NOT_MAPPABLE),
        (0x1400, 0x00080020, AbortCode.NO_OBJECT),
        (0x1400, 0x10010008, NOT_MAPPABLE),
        (0x1400, 0x20100401, NOT_MAPPABLE),
        (0x1400, 0x10170010, NOT_MAPPABLE),
        (0x1400, 0x20000108, NOT_MAPPABLE),
        (0x1400, 0x20000100, NOT_MAPPABLE),
        (0x1400, 0x20001010, AbortCode.NO_OBJECT),
        (0x1400, 0x2FFF0010, AbortCode.NO_OBJECT),
        (0x1800, 0x10010008, OK),
        (0x1800, 0x20100401, OK),
        (0x1800, 0x20100720, OK),
        (0x1800, 0x20000110, NOT_MAPPABLE),
        (0x1800, 0x20000720, NOT_MAPPABLE),
        (0x1800, 0x10000020, NOT_MAPPABLE),
        (0x1800, 0x00020008, AbortCode.NO_OBJECT),
        (0x1800, 0x20200000, NOT_MAPPABLE),
    ],
)
def test_what_can_be_mapped(bench: Bench, index: int, mapping: int, expected: AbortCode | str) -> None:
    bench.write(index, 1, OFF[index], 4)
    bench.write(index + 0x200, 0, 0, 1)
    before = bench.read(index + 0x200, 1)
    assert bench.write(index + 0x200, 1, mapping, 4) == expected
    assert bench.read(index + 0x200, 1) == (mapping if expected == OK else before)


@pytest.mark.parametrize(
    "rows",
    [
        sample_eds.rpdo(1, "0x190", 255, [0x2FFF0110]),
        sample_eds.rpdo(1, "0x190", 255, [0x20100120]),
        sample_eds.tpdo(1, "0x1A0", 255, [0x20100120] * 3),
        [row for row in sample_eds.rpdo(1, "0x190", 255, [0x20000110] * 2) if row[:2] != (0x1600, 2)][:-6],
    ],
)
def test_an_impossible_default_mapping(tmp_path: Path, rows: list[sample_eds.Row]) -> None:
    others = [row for row in sample_eds.ROWS if row[0] >= 0x2000]
    path = sample_eds.write(tmp_path / "sample.eds", rows + others)
    with pytest.raises(ValueError, match=r"mapping 1[6A]00h"):
        Node(Dictionary.load(path, ID), ID)
