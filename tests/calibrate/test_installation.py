"""Upload, proof and saving: all of it, or the module is left as it was. Every step is made to fail."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import pytest

from canfb.calibrate.measurement import Measurement, Settings
from canfb.calibrate.procedure import Installation, install, verify
from canfb.cia301.frame import Frame
from canfb.device.storage.storage import MemoryStore
from canfb.master.access import CommissioningError
from canfb.master.all_or_nothing import Guard, put_in_force, put_in_force_again, read_active, save
from canfb.master.samples import TrackSamples
from canfb.signal.correction import NO_CORRECTION, Correction
from commissioning_kit import Bench

SDO_REQUEST, SDO_ANSWER = 0x620, 0x5A0
AS_BEFORE = "the previous table and conditioning are active in module 32 (20h)"


class Fault:
    """Between the bus and the module: spoils the n-th SDO request, or those to an object."""

    def __init__(self, bench: Bench) -> None:
        self.requests = 0
        self.spoil: Callable[[int, Frame], list[Frame] | None] = lambda number, frame: None
        self._receive = bench.module.receive
        bench.module.receive = self.receive  # type: ignore[method-assign]

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        if frame.can_id != SDO_REQUEST:
            return self._receive(frame, now)
        self.requests += 1
        spoiled = self.spoil(self.requests, frame)
        return self._receive(frame, now) if spoiled is None else spoiled


def abort(frame: Frame, code: int = 0x08000000) -> list[Frame]:
    return [Frame(SDO_ANSWER, b"\x80" + frame.data[1:4] + struct.pack("<I", code))]


def object_of(frame: Frame) -> tuple[int, int]:
    """Index and sub-index of an initiating request."""
    index, subindex = struct.unpack_from("<HB", frame.data, 1)
    return index, subindex


def is_write(frame: Frame) -> bool:
    return frame.data[0] >> 5 in (1, 6)


def prepared(old: Correction, **options: Any) -> Bench:
    bench = Bench(sync=False, **options)
    if old != NO_CORRECTION:
        put_in_force(bench.access, old)
    return bench


def run_install(
    bench: Bench,
    measured: Measurement,
    fresh: TrackSamples,
    settings: Settings,
    collect: Callable[[], TrackSamples] | None = None,
    **options: Any,
) -> Installation:
    collected = collect or (lambda: fresh)
    return install(
        bench.access, measured, lambda found: verify(collected(), found, settings), Guard(), **options
    )[1]


def test_the_new_set_is_in_force_proven_and_saved(
    measured: Measurement, old: Correction, fresh: TrackSamples, settings: Settings
) -> None:
    store = MemoryStore()
    bench = prepared(old, store=store)
    done = run_install(bench, measured, fresh, settings)
    assert read_active(bench.access) == measured.found
    assert bench.module.chain.correction.table == measured.calibration.table
    assert done.active
    assert done.saved_as == "1010:04"
    assert done.fresh is not None
    assert 0.5 < done.fresh.rms / measured.calibration.residual_rms < 1.3
    again = prepared(NO_CORRECTION, store=store)
    assert read_active(again.access) == measured.found, "after the power was off"
    assert done.phase_error_cycles is not None
    assert done.phase_error_cycles == pytest.approx(max(0.005, 2.0 * done.fresh.peak), abs=1 / 65536)
    for one in (bench, again):
        assert one.access.integer(*PHASE_ERROR, "H") == round(done.phase_error_cycles * 65536)


@pytest.mark.parametrize(
    ("keep", "note"),
    [(True, "not saved: module 32 (20h) cannot save"), (False, "not saved: the table is lost")],
)
def test_what_is_not_saved_is_active_and_said(
    keep: bool, note: str, measured_first: Measurement, fresh: TrackSamples, settings: Settings
) -> None:
    store = None if keep else MemoryStore()
    bench = prepared(NO_CORRECTION, store=store)
    done = run_install(bench, measured_first, fresh, settings, keep=keep)
    assert done.saved_as is None
    assert store is None or store.images == {}
    assert done.save_note.startswith(note)
    assert read_active(bench.access) == measured_first.found


PHASE_ERROR = (0x2010, 12)
WRITES = [(0x2002, n) for n in range(1, 6)] + [(0x2020, 1), (0x2020, 3), PHASE_ERROR, (0x1010, 4)]


@pytest.mark.parametrize("target", WRITES, ids=lambda one: f"{one[0]:04X}:{one[1]:02X}")
@pytest.mark.parametrize("before", ["a table", "nothing"])
def test_a_refused_write_leaves_the_old_set(
    target: tuple[int, int],
    before: str,
    measured: Measurement,
    measured_first: Measurement,
    old: Correction,
    fresh: TrackSamples,
    settings: Settings,
) -> None:
    known, chosen = (old, measured) if before == "a table" else (NO_CORRECTION, measured_first)
    bench = prepared(known, store=MemoryStore())
    if known.table is not None:
        save(bench.access)
    fault = Fault(bench)
    refused: list[int] = []

    def spoil(number: int, frame: Frame) -> list[Frame] | None:
        if is_write(frame) and object_of(frame) == target and len(refused) < 2:
            refused.append(number)
            return abort(frame)
        return None

    if target != (0x2020, 1):  # the block transfer and the segmented one
        refused.append(0)
    fault.spoil = spoil
    with pytest.raises(CommissioningError, match="refused") as error:
        run_install(bench, chosen, fresh, settings)
    assert str(error.value).endswith(AS_BEFORE)
    assert "\n" not in str(error.value)
    assert len(refused) == 2
    assert read_active(bench.access) == known
    assert bench.module.chain.correction.table == known.table
    assert bench.access.integer(*PHASE_ERROR, "H") == 819


def lying(bench: Bench, index: int, subindex: int, times: int) -> None:
    """The module tells a wrong CRC."""
    fault = Fault(bench)
    left = [times]

    def spoil(number: int, frame: Frame) -> list[Frame] | None:
        if frame.data[0] == 0x40 and object_of(frame) == (index, subindex) and left[0]:
            left[0] -= 1
            return [Frame(SDO_ANSWER, b"\x43" + frame.data[1:4] + b"\x01\x02\x03\x04")]
        return None

    fault.spoil = spoil


def test_a_wrong_crc_of_the_staged_table_activates_nothing(
    measured: Measurement, old: Correction, fresh: TrackSamples, settings: Settings
) -> None:
    bench = prepared(old)
    lying(bench, 0x2020, 2, 1)
    with pytest.raises(CommissioningError, match="CRC of the staged table is 04030201h") as error:
        run_install(bench, measured, fresh, settings)
    assert str(error.value).endswith(AS_BEFORE)
    assert read_active(bench.access) == old


@pytest.mark.parametrize("number", [1, 12, 40, 55])
def test_an_interruption_leaves_the_old_set(
    number: int, measured: Measurement, old: Correction, fresh: TrackSamples, settings: Settings
) -> None:
    bench = prepared(old)
    guard, fault, said = Guard(), Fault(bench), list[str]()

    def spoil(count: int, frame: Frame) -> list[Frame] | None:
        if count >= number:  # Ctrl-C again and again: while it puts the old set back, too
            guard.interrupt()
        return None

    fault.spoil = spoil
    with pytest.raises(KeyboardInterrupt):
        install(bench.access, measured, lambda found: verify(fresh, found, settings), guard, step=said.append)
    fault.spoil = lambda count, frame: None
    assert said[-1] == AS_BEFORE
    assert read_active(bench.access) == old


def test_an_interruption_of_the_proof_leaves_the_old_set(
    measured: Measurement, old: Correction, fresh: TrackSamples, settings: Settings
) -> None:
    bench = prepared(old)

    def collect() -> TrackSamples:
        assert read_active(bench.access) == measured.found
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_install(bench, measured, fresh, settings, collect)
    assert read_active(bench.access) == old


def test_put_back_tells_when_it_is_not_what_it_was(old: Correction, measured: Measurement) -> None:
    bench = prepared(measured.found)
    lying(bench, 0x2020, 4, 100)
    with pytest.raises(CommissioningError, match="CRC of the active table is 04030201h"):
        put_in_force_again(bench.access, old)
