"""Samples of the ADC PDO, SYNC by SYNC, with their times, and what is said when they do not come."""

import itertools
import json
import math
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from canfb import objects as od
from canfb.cli.calibrate import measured
from canfb.cli.commands import build_parser
from canfb.cli.printing import Progress
from canfb.master.access import CommissioningError, NodeAccess
from canfb.master.all_or_nothing import Guard
from canfb.master.samples import PdoRecorder, TrackSamples, listen, read_npz, write_npz
from canfb.master.session import agreed_layout
from canfb.simulation.embedded_bus import SyncTiming
from canfb.view.module_view import PdoLayout, coarse_layout
from commissioning_kit import RATE_HZ, Bench, random_encoder
from folding import each

LAYOUT = PdoLayout(0x190)
OFF = 1 << 31


def pdo(sine: int, cosine: int) -> bytes:
    return struct.pack("<hh", sine, cosine)


def heard(*events: bytes | None) -> PdoRecorder:
    """SYNCs (None) and PDOs, a millisecond apart from SYNC to SYNC."""
    recorder = PdoRecorder(LAYOUT)
    time_s = 100.0
    for event in events:
        if event is None:
            time_s += 0.001
            recorder.on_sync(0x80, b"", time_s)
        else:
            recorder.on_pdo(0x190, event, time_s + 0.0003)
    return recorder


def test_one_sample_for_each_sync() -> None:
    recorder = heard(pdo(9, 9), None, pdo(1, 2), None, pdo(3, -4), None, None, pdo(5, 6), pdo(7, 8), None)
    samples = recorder.result("here")
    assert samples.sine.tolist()[:2] == [1.0, 3.0]
    assert math.isnan(samples.sine[2]), "a SYNC without a PDO is a missed sample"
    assert samples.cosine.tolist()[3] == 6.0, "the first PDO after a SYNC counts"
    assert (len(samples), samples.missed) == (4, 1)
    assert samples.rate_hz == pytest.approx(1000.0)


def test_the_lowest_pair_and_a_short_pdo_are_missed_samples() -> None:
    samples = heard(None, pdo(-32768, -32768), None, b"\x01\x02\x03", None, pdo(-32768, 5), None).result(
        "here"
    )
    assert np.isnan(samples.sine).tolist() == [True, True, False]
    assert samples.sine[2] == -32768.0


@given(st.lists(st.one_of(st.none(), st.binary(max_size=8)), max_size=40))
def test_whatever_comes_gives_one_entry_for_each_whole_interval(events: list[bytes | None]) -> None:
    samples = heard(*events).result("here")
    assert len(samples) == max(0, events.count(None) - 1)


def test_late_time_stamps_and_a_pause_do_not_bend_the_rate() -> None:
    recorder = PdoRecorder(LAYOUT)
    rng = np.random.default_rng(1)
    times = np.arange(1000) * 0.002 + rng.uniform(0.0, 0.0004, 1000)
    times[500:] += 30.0
    for time_s in times.tolist():
        recorder.on_sync(0x80, b"", time_s)
    assert recorder.result("here").rate_hz == pytest.approx(500.0, rel=0.002)


def test_pauses_of_the_sync_are_in_the_mean_rate_and_in_what_was_skipped() -> None:
    recorder = PdoRecorder(LAYOUT)
    rng = np.random.default_rng(1)
    # Stalls of 20 intervals after every 100 SYNCs, and the late SYNC close before the next one.
    place = np.concatenate([120.0 * stall + np.arange(100.0) for stall in range(20)])
    place[100::100] += 0.9
    times = place * 0.001 + rng.uniform(0.0, 0.0001, len(place))
    for time_s in times.tolist():
        recorder.on_sync(0x80, b"", time_s)
    samples = recorder.result("here")
    assert samples.rate_hz == pytest.approx(1000.0, rel=0.01)
    assert samples.mean_rate_hz == pytest.approx(1000.0 * 100 / 120, rel=0.01)
    assert samples.duration_s == pytest.approx(2.38, rel=0.01)
    assert samples.skipped == pytest.approx(19 * 20, rel=0.05)
    assert heard(*[None] * 500).result("here").skipped == 0


def test_listening_takes_what_was_asked_for_and_says_nothing_on_the_bus() -> None:
    bench = Bench()
    parts: list[float] = []
    samples = listen(bench.master, LAYOUT, 0.5, progress=parts.append)
    assert 490 < len(samples) < 710
    assert samples.missed == 0
    assert samples.rate_hz == pytest.approx(RATE_HZ, rel=1e-3)
    assert bench.master.sent == [frame for frame in bench.master.sent if frame.can_id == 0x080]
    assert parts == sorted(parts)
    assert parts[-1] == 1.0
    assert 0x190 not in bench.master.network.subscribers
    again = listen(bench.master, LAYOUT, 0.2, least_samples=800)
    assert 800 <= len(again) < 1000, "longer, for enough samples, less the interval that is open"
    assert len(listen(bench.master, LAYOUT, 0.1, least_samples=10**6)) < 800, "and no longer than six times"


def losing(lost: Callable[[int], bool]) -> Bench:
    """Samples are lost by their numbers."""
    bench, numbers = Bench(), itertools.count(1)
    bench.source.change = lambda counts: None if lost(next(numbers)) else counts
    return bench


@each("made, words", [
    (lambda: Bench(sync=False), r"no SYNC \(080h\) for 2 s: start the node .* \(--rate HZ\)"),
    (lambda: Bench(operational=False), "SYNC is received, but not PDO 190h .* OPERATIONAL"),
    (lambda: losing(lambda n: n % 3 > 0), "SYNCs were not followed by PDO 190h"),
])  # fmt: skip
def test_what_does_not_come_is_said(made: Callable[[], Bench], words: str) -> None:
    with pytest.raises(CommissioningError, match=words):
        listen(made().master, LAYOUT, 0.5)


def test_samples_that_stop_are_told_and_not_waited_for() -> None:
    bench = Bench()
    bench.master.on_wait = lambda now: (
        setattr(bench.source, "change", lambda counts: None) if now > 1 else None
    )
    with pytest.raises(CommissioningError, match="SYNC is received, but not PDO 190h"):
        listen(bench.master, LAYOUT, 60.0)
    assert bench.bus.now < 5.0


def test_another_mapping_and_cob_id_are_found() -> None:
    bench = Bench(sync=False, operational=False)
    node = bench.interface_access
    node.write(0x1800, 1, "I", OFF | node.integer(0x1800, 1, "I"))
    node.write(0x1A00, 0, "B", 0)
    for n, entry in enumerate((0x64010210, 0x64010310, 0x64010110), start=1):
        node.write(0x1A00, n, "I", entry)
    node.write(0x1A00, 0, "B", 3)
    for one, index in ((node, 0x1800), (bench.access, 0x1400)):
        one.write(index, 1, "I", OFF | 0x1C5)
        one.write(index, 1, "I", 0x1C5)
    layout = agreed_layout(bench.access, node)
    assert layout == PdoLayout(0x1C5, 4, 0)
    assert layout.unpack(struct.pack("<hhh", 5, 0, -7)) == (-7, 5)


@each("index, cob_ids, words", [
    (0x1400, [OFF | 0x191, 0x191], "receives its samples in PDO 191h, but .* sends them in 190h"),
    (0x1800, [OFF | 0x190], "encoder interface 16 .* has no valid TPDO"),
    (0x1400, [OFF | 0x190], "module 32 .* has no valid RPDO"),
])  # fmt: skip
def test_a_pdo_that_is_off_or_elsewhere_is_told(index: int, cob_ids: list[int], words: str) -> None:
    bench = Bench(sync=False)
    node = bench.access if index == 0x1400 else bench.interface_access
    for cob_id in cob_ids:
        node.write(index, 1, "I", cob_id)
    with pytest.raises(CommissioningError, match=words):
        agreed_layout(bench.access, bench.interface_access)


def test_a_silent_interface_is_taken_as_the_module_expects_it() -> None:
    bench = Bench(sync=False)
    bench.bus._participants.remove(bench.interface)
    assert agreed_layout(bench.access, bench.interface_access) == LAYOUT


def test_with_a_cob_id_of_nobody_a_silent_interface_is_believed() -> None:
    bench = Bench(sync=False)
    for cob_id in (OFF | 0x500, 0x500):
        bench.access.write(0x1400, 1, "I", cob_id)
    other = NodeAccess(bench.master, 0x11, "encoder interface")
    assert agreed_layout(bench.access, other) == PdoLayout(0x500)


JITTER = SyncTiming(sync_jitter_us=100.0, sync_drift_ppm=-50.0)
TIMED = PdoLayout(0x190, 0, 2, 0x80, 4)


def timed_pdo(ticks: int) -> bytes:
    return struct.pack("<hhI", 1, 2, ticks % (1 << 32))


def test_the_times_of_the_interface_are_heard_and_unwrapped() -> None:
    bench = Bench(timing=JITTER)
    layout = agreed_layout(bench.access, bench.interface_access)
    assert layout == TIMED
    samples = listen(bench.master, layout, 0.5)
    assert samples.time_s is not None
    steps = np.diff(samples.time_s)
    assert len(samples.time_s) == len(samples) > 400
    assert 0.8e-3 < steps.min() < 0.85e-3
    assert 1.15e-3 < steps.max() < 1.21e-3
    assert steps.mean() == pytest.approx(1.00015e-3, abs=1e-6)


@given(
    st.integers(0, (1 << 32) - 1),
    st.lists(st.integers(9_000, 11_000), min_size=2, max_size=40),
    st.sets(st.integers(0, 40), max_size=20),
)
def test_a_missed_sample_has_a_time_between_its_neighbours(
    start: int, steps: list[int], lost: set[int]
) -> None:
    recorder, at = PdoRecorder(TIMED), [start]
    for step in steps:
        at.append(at[-1] + step)
    for n, ticks in enumerate(at):
        recorder.on_sync(0x80, b"", ticks * 1e-7)
        if n not in lost:
            recorder.on_pdo(0x190, timed_pdo(ticks), ticks * 1e-7)
    recorder.on_sync(0x80, b"", (at[-1] + 10_000) * 1e-7)
    samples = recorder.result("here")
    came = [n for n in range(len(at)) if n not in lost]
    if len(came) < 2:
        assert samples.time_s is None
        return
    assert samples.time_s is not None
    assert (np.diff(samples.time_s) > 0.0).all()
    assert samples.time_s[came] == pytest.approx([(at[n] - at[came[0]]) * 1e-7 for n in came], abs=1e-9)


def test_a_pdo_without_its_time_has_none() -> None:
    assert TIMED.sample_time(timed_pdo(77)) == 77
    assert TIMED.sample_time(b"\0" * 7) is None
    assert PdoLayout(0x190).sample_time(timed_pdo(77)) is None


def test_the_times_are_kept_in_the_file(tmp_path: Path) -> None:
    plain = TrackSamples.of([1.0, 2.0, 3.0], [4.0, 5.0, 6.0], 1000.0, "here")
    write_npz(tmp_path / "plain.npz", plain)
    assert read_npz(tmp_path / "plain.npz").time_s is None
    write_npz(tmp_path / "timed.npz", plain.timed([0xFFFFFFF0, None, 19_990]))
    read = read_npz(tmp_path / "timed.npz").time_s
    assert read is not None
    assert read == pytest.approx([0.0, 1.0003e-3, 2.0006e-3], abs=1e-9)


def test_calibrating_on_a_bus_that_jitters(capsys: pytest.CaptureFixture[str]) -> None:
    """Equidistant they would be refused: 100 us are 2.5 cycles at 600 rpm."""
    bench, rpm = Bench(random_encoder(3), rpm=600.0, timing=JITTER), 600.0
    bench.access.write(0x1006, 0, "I", 1000)
    bench.bus.run_until(0.2)
    options, master = build_parser().parse_args(["calibrate", "--seconds", "5", "--json"]), bench.master
    assert (
        measured(options, Progress(quiet=True), "", lambda run: run.over_bus(master, 32, None, Guard())) == 0
    )
    figures = json.loads(capsys.readouterr().out)
    noise = bench.encoder.noise_lsb / (2 * np.pi * bench.encoder.amplitude_counts)
    stamps = rpm / 60 * 2500 * 100e-9 / 12**0.5
    assert figures["residual_rms_cycles"] < 2.0 * np.hypot(noise, stamps) + 5e-5


@pytest.mark.parametrize("same_pdo", [True, False])
def test_it_is_heard_with_its_sample(same_pdo: bool) -> None:
    coarse = PdoLayout(0x190, 4, 6) if same_pdo else PdoLayout(0x290)
    recorder = PdoRecorder(PdoLayout(0x190, coarse=coarse))
    for k in range(5):
        recorder.on_sync(0x80, b"", 0.001 * k)
        if k == 2:
            continue
        tracks = struct.pack("<hh", 100 + k, -100 - k)
        if same_pdo:
            data = tracks + struct.pack("<hh", k, -k)
            recorder.on_pdo(0x190, data, 0.0)
        else:
            recorder.on_pdo(0x190, tracks, 0.0)
            recorder.on_pdo(0x290, struct.pack("<hh", k, -k), 0.0)
    samples = recorder.result("a test")
    assert samples.coarse is not None
    assert np.array_equal(samples.coarse[0], [0.0, 1.0, np.nan, 3.0], equal_nan=True)
    assert np.array_equal(samples.coarse[1], [0.0, -1.0, np.nan, -3.0], equal_nan=True)
    assert samples.received_s is not None
    assert samples.received_s == pytest.approx([0.0, 0.001, 0.002, 0.003])


def test_its_pdo_is_found_in_the_module() -> None:
    bench = Bench(sync=False, operational=False)
    assert coarse_layout(bench.access.read_known) is None
    write = bench.access.write
    write(0x1401, 1, "I", 0x80000290)
    write(0x1601, 0, "B", 0)
    write(0x1601, 1, "I", od.SAMPLE_COARSE_SINE.mapped(16))
    write(0x1601, 2, "I", od.SAMPLE_COARSE_COSINE.mapped(16))
    write(0x1601, 0, "B", 2)
    write(0x1401, 1, "I", 0x290)
    found = coarse_layout(bench.access.read_known)
    assert found is not None
    assert (found.can_id, found.sine_byte, found.cosine_byte) == (0x290, 0, 2)
