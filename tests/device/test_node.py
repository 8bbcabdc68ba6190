from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from device_kit import ID, OK, Bench

from canfb.cia301.codes import AbortCode
from canfb.cia301.frame import Frame
from canfb.device.od.dictionary import READABLE, WRITABLE, Dictionary

SHIPPED = Path(__file__).parents[2] / "eds"
ONLY_SPECIAL_VALUES = {0x1010, 0x1011, 0x2020}


@pytest.fixture(params=["canfb-module.eds", "encoder-interface.eds"])
def shipped(request: pytest.FixtureRequest) -> Bench:
    bench = Bench(Dictionary.load(SHIPPED / request.param, ID))
    bench.start()
    return bench


def test_frames_of_more_than_eight_bytes(bench: Bench) -> None:
    bench.operational()
    for can_id in (0x000, 0x080, 0x190, 0x620, 0x123):
        assert bench.send(can_id, bytes(9)) == []
    assert bench.node.counters.malformed_frames == 5


@pytest.mark.parametrize("can_id", [0x123, 0x621, 0x5A1, 0x721, 0x1A1])
def test_unknown_ids(bench: Bench, can_id: int) -> None:
    bench.operational()
    assert bench.send(can_id, "4000100000000000") == []
    assert bench.node.counters.unknown_cob_ids == 1
    assert bench.node.counters.malformed_frames == 0


@pytest.mark.parametrize("can_id", [0x800, 0x1FFFFFFF, -1])
def test_what_is_no_id_at_all(bench: Bench, can_id: int) -> None:
    bench.operational()
    assert bench.send(can_id, "4000100000000000") == []
    assert bench.node.counters.malformed_frames == 1
    assert bench.node.counters.unknown_cob_ids == 0


def test_the_timestamp_is_not_looked_at(bench: Bench) -> None:
    frame = Frame(0x620, bytes.fromhex("4000100000000000"), False, -1e30)
    assert len(bench.node.receive(frame, 0.0)) == 1


def test_the_deadline_is_the_earliest(bench: Bench) -> None:
    assert bench.node.deadline() is None
    bench.write(0x1006, 0, 30_000, 4)
    bench.write(0x1005, 0, 0x40000080, 4)
    bench.write(0x1016, 1, 0x00470032, 4)
    bench.send(0x747, "05")
    assert bench.node.deadline() == pytest.approx(0.03)
    bench.write(0x1006, 0, 0, 4)
    assert bench.node.deadline() == pytest.approx(0.05)
    bench.sdo("40081000")
    bench.write(0x1016, 1, 0, 4)
    assert bench.node.deadline() is None


def test_an_exception_of_the_program_loses_no_frame(bench: Bench) -> None:
    bench.operational()

    def broken(number: int, now: float) -> None:
        bench.node.trigger_tpdo(1, now)
        raise RuntimeError("a mistake in the program")

    bench.application.react(rpdo_received=broken)
    with pytest.raises(RuntimeError):
        bench.send(0x190, "01000200")
    assert bench.tick() == ["1A0#0000000000000000"]


@pytest.mark.parametrize("timeout_s", [0, -1.0, float("inf"), float("nan")])
def test_impossible_sdo_timeouts(bench: Bench, timeout_s: float) -> None:
    with pytest.raises(ValueError, match="sdo_timeout_s"):
        type(bench.node)(bench.dictionary, ID, sdo_timeout_s=timeout_s)


@pytest.mark.parametrize(("timeout_s", "given"), [(1.0, {}), (0.25, {"sdo_timeout_s": 0.25})])
def test_the_sdo_timeout(sample_path: Path, timeout_s: float, given: dict[str, Any]) -> None:
    bench = Bench(Dictionary.load(sample_path, ID), **given)
    bench.start()
    assert bench.write(0x1201, 2, 0x6D1, 4) == OK
    assert bench.write(0x1201, 1, 0x6D0, 4) == OK
    for channel in (0x620, 0x6D0):
        bench.send(channel, "4008100000000000")
        start = bench.now
        ((time, text),) = bench.run(10.0)
        assert time - start == pytest.approx(timeout_s)
        assert text.endswith("#8008100000000405")


def test_a_change_of_other_parameters_is_no_new_configuration(bench: Bench) -> None:
    bench.operational()
    bench.application.calls.clear()
    for index, value, size in ((0x1017, 500, 2), (0x1012, 0x80000100, 4), (0x1005, 0x81, 4)):
        assert bench.write(index, 0, value, size) == OK
    assert bench.write(0x1016, 1, 0x00470100, 4) == OK
    assert bench.application.told("configuration_changed") == []
    assert bench.write(0x1400, 2, 1, 1) == OK
    assert bench.application.told("configuration_changed") == [()]


def test_every_entry_is_read_and_written_back(shipped: Bench) -> None:
    """OD 01, 03, 04, 07 and 09 of the conformance cases, for numbers."""
    for entry in shipped.dictionary:
        if not 1 <= entry.byte_length <= 4:
            continue
        read = shipped.read(entry.index, entry.subindex)
        no_data = entry.index == 0x1003 and entry.subindex
        number = 0 if no_data else int.from_bytes(entry.encode(), "little")
        if entry.access not in READABLE:
            assert read is AbortCode.WRITE_ONLY
        elif no_data:
            assert read is AbortCode.NO_DATA
        else:
            assert read == number == int.from_bytes(entry.encode(), "little")
        if entry.index in ONLY_SPECIAL_VALUES or (entry.index & 0xFE00) in (0x1600, 0x1A00):
            continue
        written = shipped.write(entry.index, entry.subindex, number, entry.byte_length)
        fixed_while_valid = entry.index & 0xFF00 == 0x1800 and entry.subindex in (3, 6)
        if entry.access not in WRITABLE:
            assert written is AbortCode.READ_ONLY
        elif fixed_while_valid:
            assert written in (OK, AbortCode.INVALID_VALUE)
        else:
            assert written == OK, entry


def test_the_defaults_of_the_file_are_there_after_every_reset(shipped: Bench) -> None:
    before = {(entry.index, entry.subindex): entry.value for entry in shipped.dictionary}
    shipped.write(0x1017, 0, 500, 2)
    shipped.write(0x1005, 0, 0x200, 4)
    shipped.nmt(130)
    assert before == {(entry.index, entry.subindex): entry.value for entry in shipped.dictionary}


def test_a_sweep_of_what_is_not_there(shipped: Bench) -> None:
    indices = {info.index for info in shipped.dictionary.objects()}
    for index in range(0x10000):
        subindex = 255 if index in indices else 0
        expected = AbortCode.NO_SUBINDEX if index in indices else AbortCode.NO_OBJECT
        assert shipped.read(index, subindex) is expected
    for index in indices:
        for subindex in range(256):
            if (index, subindex) not in shipped.dictionary:
                assert shipped.read(index, subindex) is AbortCode.NO_SUBINDEX


def test_the_default_pdos_of_the_module() -> None:
    bench = Bench(Dictionary.load(SHIPPED / "canfb-module.eds", ID), autostart=True)
    bench.start()
    bench.send(0x190, "01000200")
    assert bench.application.told("rpdo_received") == [(1, bench.now)]
    bench.node.trigger_tpdo(1, 0.0)
    assert bench.tick() == ["1A0#0000000000000000"]
    assert bench.sync() == ["2A0#0000000000000000"]
