"""Upload, proof on fresh samples, saving: all of it, or the module is as before, if the terminal goes."""

import io
import os
import pty
import signal
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from calibrating import calibrate

from canfb import CalibrationError, Frame
from canfb.bus.runner import ending_on_signals
from canfb.calibrate.calibration_summary import outcome
from canfb.calibrate.measurement import Measurement, Settings, block_of
from canfb.calibrate.procedure import Installation, install, verify
from canfb.calibration.deviation import best_deviation
from canfb.cli.printing import Progress
from canfb.device.storage.storage import MemoryStore
from canfb.master.access import CommissioningError
from canfb.master.all_or_nothing import Guard, put_in_force_again, read_active
from canfb.master.machine_watch import Provenance
from canfb.master.samples import TrackSamples
from canfb.signal.correction import NO_CORRECTION, Correction, CorrectionTable
from commissioning_kit import Bench, bench_with, random_encoder, recorded
from node_commands import ANSWER, between, place_of

AS_BEFORE = "the previous table and conditioning are active in module 32 (20h)"
Installs = Callable[..., Installation]


@pytest.fixture
def installed(measured: Measurement, fresh: TrackSamples, settings: Settings) -> Installs:
    """Installs what was measured in the module of a bench."""

    def run(bench: Bench, guard: Guard | None = None, **options: Any) -> Installation:
        prove = lambda found: verify(fresh, found, settings)  # noqa: E731
        return install(bench.access, measured, prove, guard or Guard(), **options)[1]

    return run


def test_the_new_set_is_in_force_proven_and_saved(
    installed: Installs, measured: Measurement, old: Correction
) -> None:
    store = MemoryStore()
    bench = bench_with(old, store=store)
    done = installed(bench)
    assert read_active(bench.access) == measured.found
    assert bench.module.chain.correction.table == measured.calibration.table
    assert done.saved_as == "1010:04"
    assert done.fresh is not None
    assert 0.5 < done.fresh.rms / measured.calibration.residual_rms < 1.3
    again = bench_with(store=store)
    assert read_active(again.access) == measured.found, "after the power was off"
    assert done.phase_error_cycles is not None
    assert done.phase_error_cycles == pytest.approx(max(0.005, 2.0 * done.fresh.peak), abs=1 / 65536)
    for one in (bench, again):
        assert one.access.integer(0x2010, 12, "H") == round(done.phase_error_cycles * 65536)


def test_what_is_not_saved_is_active_and_said(
    installed: Installs, measured: Measurement, old: Correction
) -> None:
    store = MemoryStore()
    bench = bench_with(old, store=store)
    done = installed(bench, keep=False)
    assert done.saved_as is None
    assert store.images == {}
    assert "; not saved: the table is lost" in outcome(measured, done, Provenance("", module=0x20))
    assert read_active(bench.access) == measured.found


def lying(bench: Bench, place: tuple[int, int], times: int) -> None:
    """The module tells a wrong CRC."""
    left = [times]

    def spoil(frame: Frame) -> list[Frame] | None:
        if frame.data[0] == 0x40 and place_of(frame) == place and left[0]:
            left[0] -= 1
            return [Frame(ANSWER, b"\x43" + frame.data[1:4] + b"\x01\x02\x03\x04")]
        return None

    between(bench, spoil)


def test_a_wrong_crc_of_the_staged_table_activates_nothing(installed: Installs, old: Correction) -> None:
    bench = bench_with(old)
    lying(bench, (0x2020, 2), 1)
    with pytest.raises(CommissioningError, match="CRC of the staged table is 04030201h") as error:
        installed(bench)
    assert str(error.value).endswith(AS_BEFORE)
    assert read_active(bench.access) == old


@pytest.mark.parametrize("number", [1, 12, 40, 55])
def test_an_interruption_leaves_the_old_set(number: int, installed: Installs, old: Correction) -> None:
    bench = bench_with(old)
    guard, said, requests = Guard(), list[str](), list[Frame]()

    def spoil(frame: Frame) -> None:
        requests.append(frame)
        if len(requests) >= number:  # Ctrl-C again and again: while it puts the old set back, too
            guard.interrupt()

    receive = bench.module.receive
    between(bench, spoil)
    with pytest.raises(KeyboardInterrupt):
        installed(bench, guard, step=said.append)
    bench.module.receive = receive  # type: ignore[method-assign]
    assert said[-2:] == ["restoring the old table", AS_BEFORE]
    assert read_active(bench.access) == old


def test_put_back_tells_when_it_is_not_what_it_was(old: Correction, measured: Measurement) -> None:
    bench = bench_with(measured.found)
    lying(bench, (0x2020, 4), 100)
    with pytest.raises(CommissioningError, match="CRC of the active table is 04030201h"):
        put_in_force_again(bench.access, old)


def test_a_terminal_that_has_gone_does_not_keep_the_old_table_away() -> None:
    """SIGHUP, twice, as soon as the new table is active."""
    bench, guard = Bench(), Guard()
    ours, theirs = pty.openpty()
    terminal = [ours]
    stream = os.fdopen(theirs, "w", encoding="utf-8")

    def hang_up(now: float) -> None:
        if bench.value(0x2020, 4):
            while terminal:
                os.close(terminal.pop())
            for _ in range(2):
                signal.raise_signal(signal.SIGHUP)

    bench.master.on_wait = hang_up
    with ending_on_signals(guard.interrupt), pytest.raises(KeyboardInterrupt):
        calibrate(bench, progress=Progress(stream=stream), guard=guard)
    with pytest.raises(OSError, match="Input/output error"):
        stream.close()  # what it still holds
    bench.master.on_wait = lambda now: None
    assert read_active(bench.access) == NO_CORRECTION


def test_the_second_signal_is_too_late_to_stop_what_the_first_one_began() -> None:
    guard = Guard()
    with pytest.raises(KeyboardInterrupt):
        guard.interrupt()
    guard.interrupt()
    with guard.held():
        guard.interrupt()
    guard.interrupt()


class Gone(io.StringIO):
    """A terminal that refuses all."""

    def isatty(self) -> bool:
        return True

    def write(self, text: str) -> int:
        raise OSError(5, "Input/output error")


def test_progress_never_fails() -> None:
    progress = Progress(stream=Gone())
    progress.step("one")
    progress.part(0.5)
    progress.clear()


def found(measured: Measurement, samples: TrackSamples) -> float:
    return best_deviation(
        samples.recording(12), measured.found, measured.before, block_of(measured.calibration)
    ).rms


@pytest.mark.parametrize("rpm", [31.0, 250.0, 600.0, 1900.0, -700.0])
@pytest.mark.parametrize(("size", "order"), [(0.0, 1), (0.0005, 1), (0.002, 2), (0.002, 5)])
def test_it_is_the_noise_and_the_error_of_a_wrong_table(
    rpm: float, size: float, order: int, measured: Measurement
) -> None:
    samples = recorded(random_encoder(3), 2000, rpm=rpm, start_s=60.0, seed=2)
    x = np.arange(256) / 256
    wrong = CorrectionTable(measured.calibration.table(x) + size * np.sin(2 * np.pi * order * x))
    used = Correction(wrong, measured.found.conditioning) if size else measured.found
    got = best_deviation(samples.recording(12), used, measured.before, block_of(measured.calibration))
    want = np.hypot(size / np.sqrt(2), measured.calibration.residual_rms)
    assert got.rms == pytest.approx(want, rel=0.25)
    assert got.peak > got.rms


def test_a_few_bad_samples_do_not_count(measured: Measurement, fresh: TrackSamples) -> None:
    """Faulty ones, gaps, and a SYNC with its PDO that this computer has not heard."""
    faulty, gaps = fresh.sine.copy(), fresh.sine.copy()
    faulty[[100, 700, 701, 1200]] = [900.0, -900.0, 0.0, 1500.0]
    gaps[200:230] = gaps[900:903] = np.nan
    sine, cosine = (np.delete(track, [300, 1100]) for track in (fresh.sine, fresh.cosine))
    lost = TrackSamples.of(sine, cosine, fresh.rate_hz, "with lost frames")
    for bad in (replace(fresh, sine=faulty), replace(fresh, sine=gaps), lost):
        assert found(measured, bad) == pytest.approx(found(measured, fresh), rel=0.15)


@pytest.mark.parametrize("speed", [0.0, 1.0, 0.5, 0.25])
def test_nothing_is_said_of_a_machine_that_stands_or_is_locked(speed: float, measured: Measurement) -> None:
    position = 0.3 + speed * np.arange(1500)
    sine, cosine = random_encoder(3).sample(position, np.random.default_rng(1))
    with pytest.raises(CalibrationError, match="at standstill, or its motion is locked"):
        found(measured, TrackSamples.of(sine, cosine, None, "locked"))


def test_slow_motion_is_not_taken_for_errors_nor_errors_for_motion(measured: Measurement) -> None:
    """At 150 samples a cycle a short block would follow the errors of the encoder."""
    samples = recorded(random_encoder(3), 6000, rpm=0.16, seed=4)
    right = best_deviation(samples.recording(12), measured.found, measured.before, 16)
    assert right.rms == pytest.approx(measured.calibration.residual_rms, rel=0.3)
    assert right.before_rms > 0.5 * measured.on_samples.before_rms
