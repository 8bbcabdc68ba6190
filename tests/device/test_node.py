from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from device_kit import ID, OK, Bench

from canfb.cia301.frame import Frame
from canfb.device.od.dictionary import Dictionary

SHIPPED = Path(__file__).parents[2] / "eds"


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


def test_the_defaults_of_the_file_are_there_after_every_reset(shipped: Bench) -> None:
    before = {(entry.index, entry.subindex): entry.value for entry in shipped.dictionary}
    shipped.write(0x1017, 0, 500, 2)
    shipped.write(0x1005, 0, 0x200, 4)
    shipped.nmt(130)
    assert before == {(entry.index, entry.subindex): entry.value for entry in shipped.dictionary}


def test_the_default_pdos_of_the_module() -> None:
    bench = Bench(Dictionary.load(SHIPPED / "canfb-module.eds", ID), autostart=True)
    bench.start()
    bench.send(0x190, "01000200")
    assert bench.application.told("rpdo_received") == [(1, bench.now)]
    bench.node.trigger_tpdo(1, 0.0)
    assert bench.tick() == ["1A0#0000000000000000"]
    assert bench.sync() == ["2A0#0000000000000000"]
