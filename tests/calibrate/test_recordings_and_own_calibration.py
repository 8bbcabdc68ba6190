"""Where `canfb calibrate` has its samples from: PDOs, 2050h of module and interface, 2030h of the module."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from calibrating import calibrate, position_errors

from canfb import CalibrationError, FeedbackModule, Frame, ModuleConfig
from canfb.cli.commands import build_parser
from canfb.cli.node_options import measured_nodes
from canfb.configuration import parse_config
from canfb.master.access import CommissioningError
from canfb.master.all_or_nothing import read_active
from canfb.master.samples import listen, record
from canfb.master.session import agreed_layout
from canfb.signal.correction import NO_CORRECTION
from canfb.simulation.embedded_bus import EmbeddedBus, SyncProducer, SyncTiming
from canfb.simulation.encoder import Motion, Ramp
from commissioning_kit import CYCLES, MODULE_ID, RATE_HZ, Bench, random_encoder, running
from folding import each


def with_calculator(bench: Bench) -> Bench:
    """What `canfb run` does in another process is done here while somebody waits."""

    def work(now: float) -> None:
        job = bench.module.pending_job()
        if job is not None:
            bench.module.finish_job(job, job(), now)

    bench.master.on_wait = work
    bench.access.write(0x2030, 0x0A, "I", 1500)
    return bench


def test_a_recording_of_the_module() -> None:
    bench = Bench()
    parts: list[float] = []
    samples = record(bench.access, 1.0, None, parts.append)
    assert len(samples) == pytest.approx(1000, abs=300)
    assert samples.rate_hz == pytest.approx(RATE_HZ, rel=0.01)
    assert samples.missed == 0
    assert np.abs(samples.sine).max() > 900
    assert parts == sorted(parts)
    assert bench.access.integer(0x2050, 1, "B") == 0, "it records no more"


def test_a_recording_ends_when_the_memory_is_full() -> None:
    bench = Bench()
    bench.module._recorder._recording.capacity = 300
    samples = record(bench.access, 60.0, None, lambda part: None)
    assert len(samples) == 300
    assert bench.bus.now < 5.0


def test_a_recording_takes_longer_for_enough_samples() -> None:
    bench, parts = Bench(), list[float]()
    assert 800 <= len(record(bench.access, 0.2, None, parts.append, 800)) < 1050
    assert parts == sorted(parts)
    assert len(record(bench.access, 0.1, None, parts.append, 10**6)) < 800, "no longer than six times"


def test_a_recording_is_stopped_when_it_is_interrupted() -> None:
    bench = Bench()

    def interrupt(now: float) -> None:
        if now > 0.5:
            bench.master.on_wait = lambda now: None
            raise KeyboardInterrupt

    bench.master.on_wait = interrupt
    with pytest.raises(KeyboardInterrupt):
        record(bench.access, 60.0, None, lambda part: None)
    assert bench.access.integer(0x2050, 1, "B") == 0


def test_what_cannot_record_says_so() -> None:
    bench = Bench(operational=False)
    with pytest.raises(CommissioningError, match=r"module 32 \(20h\) has recorded nothing \(2050:02\)"):
        record(bench.access, 0.5, None, lambda part: None)


def test_the_rate_of_a_recording_that_does_not_say_it(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench()
    monkeypatch.delitem(bench.module.dictionary._entries, (0x2050, 4))
    assert record(bench.access, 0.5, 990.0, lambda part: None).rate_hz == 990.0


def test_the_module_measures_by_itself_and_tells_its_drift(
    figures_of: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bench = with_calculator(Bench())
    assert calibrate(bench, "--source", "module", "--dry-run") == 0
    assert "dry run" in capsys.readouterr().out
    assert read_active(bench.access) == NO_CORRECTION
    assert bench.access.integer(0x2030, 2, "B") == 0, "dropped"
    figures = figures_of(bench, "--source", "module", "--out", str(tmp_path))
    active = read_active(bench.access)
    assert figures["crc32"] == f"{active.crc32:08X}" != "00000000"
    assert figures["active"]
    assert bench.access.integer(0x2030, 2, "B") == 5, "accepted"
    assert (tmp_path / "table.bin").read_bytes() == active.table.to_bytes()  # type: ignore[union-attr]
    assert "Accepted." in (tmp_path / "report.html").read_text()
    rms = bench.access.read(0x2030, 5, "f")
    assert figures["residual_rms_cycles"] == pytest.approx(rms, rel=0.1)
    bench.source.change = lambda counts: (counts[0] + 12, counts[1])
    figures = figures_of(bench, "--source", "module", "--check")
    want = 12 / bench.encoder.amplitude_counts / (2 * np.pi * np.sqrt(2))
    assert figures["drift_rms_cycles"] == pytest.approx(want, rel=0.2)
    assert read_active(bench.access) == active
    assert bench.access.integer(0x2030, 2, "B") == 0


class OwnConverter(Bench):
    """The bench with a module that asks the encoder itself, and nobody else on the bus."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.bus = EmbeddedBus()
        self.module = FeedbackModule(
            ModuleConfig(node_id=MODULE_ID, cycles_per_revolution=CYCLES, autostart=True), source=self.source
        )
        self.master = type(self.master)(self.bus)
        self.bus.attach(self.module)
        self.bus.attach(SyncProducer(1.0 / RATE_HZ))


def test_its_own_recording_calibrates_it(figures_of: Any) -> None:
    bench = OwnConverter()
    bench.bus.run_until(0.5)
    before = position_errors(bench, 1000)
    assert figures_of(bench, *RECORDED)["encoder_interface"] is None
    after = position_errors(bench, 1000)
    assert bench.value(0x2020, 4) != 0
    assert np.abs(after).max() < 0.2 * np.abs(before).max()


MODULE = ("--source", "module")
RECORDED = ("--source", "recording", "--recorder", "module")
NO_INTERFACE = (
    r"encoder interface 17 \(11h\) does not answer, .* from node 16 \(10h, PDO 190h\): set the right"
)


def away_for_a_moment() -> Bench:
    bench = Bench()
    receive = bench.module.receive
    bench.module.receive = lambda frame, now: [] if 1.0 <= now < 1.4 else receive(frame, now)  # type: ignore[method-assign]
    return bench


NOT_OPERATIONAL = r"module 32 \(20h\) has .* OPERATIONAL"
REFUSED: list[tuple[Callable[[], Bench], list[tuple[str, ...]], str]] = [
    (Bench, [(), MODULE, RECORDED, RECORDED[:2], ("--check",), (*MODULE, "--check")], NO_INTERFACE),
    (Bench, [MODULE, RECORDED, (*MODULE, "--check")], NOT_OPERATIONAL),
    (away_for_a_moment, [(*RECORDED, "--dry-run"), MODULE, (*MODULE, "--check")], "no answer"),
    (OwnConverter, [(), MODULE], "--source recording --recorder module"),
    (
        lambda: with_calculator(Bench(motion=Motion(()))),
        [MODULE],
        r"module 32 \(20h\) refuses its measurement: parts of the cycle were never",
    ),
]


@each("made, arguments, words", [(made, one, words) for made, every, words in REFUSED for one in every])
def test_what_gives_no_samples_is_refused_within_three_seconds(
    made: Callable[[], Bench], arguments: tuple[str, ...], words: str
) -> None:
    bench = made()
    bench.bus.run_until(0.5)
    if words == NO_INTERFACE:
        arguments = (*arguments, "--encoder-interface", "0x11")
    if words == NOT_OPERATIONAL:
        bench.bus.send(Frame(0, bytes([0x80, 0x20])))  # the interface stays OPERATIONAL
    began = bench.bus.now
    with pytest.raises((CommissioningError, CalibrationError), match=words):
        calibrate(bench, "--seconds", "20", *arguments)
    assert bench.bus.now - began < 3.0
    assert read_active(bench.access) == NO_CORRECTION
    assert bench.access.integer(0x2030, 2, "B") == 0
    assert bench.access.integer(0x2050, 1, "B") == 0


def test_the_configuration_of_such_a_module_names_no_encoder_interface() -> None:
    config = parse_config("modules: [{node_id: 16, source: {kind: motion}}]")
    options = build_parser().parse_args(["calibrate"])
    assert measured_nodes(options, config) == (16, None)


@each("per_sync", [2, 3, 4])
def test_every_sample_is_heard_in_its_order(per_sync: int) -> None:
    network = Bench(config={"samples_per_sync": per_sync}, timing=SyncTiming(sync_jitter_us=20.0))
    layout = agreed_layout(network.access, network.interface_access)
    network.master.send(0x000, bytes((2, MODULE_ID)))  # stop it: the interface alone is heard
    samples = listen(network.master, layout, 1.0)
    assert samples.rate_hz == pytest.approx(RATE_HZ * per_sync, rel=1e-3)
    assert len(samples) % per_sync == 0
    assert samples.time_s is not None
    phase = np.arctan2(samples.sine, samples.cosine) / (2.0 * np.pi)
    there = np.isfinite(phase)
    apart = np.diff(samples.time_s)[there[1:] & there[:-1]]
    steps = np.diff(phase)[there[1:] & there[:-1]]
    speed = 10.0 * CYCLES  # 600 rpm, give or take 3 %
    away = (steps - speed * apart + 0.5) % 1.0 - 0.5
    locked = away[len(away) // 2 :]  # to SYNC, whose jitter of 20 us is half a cycle
    assert np.abs(locked).max() < 0.05 * speed / (RATE_HZ * per_sync) + 0.1
    assert samples.missed <= 2 * per_sync  # the first SYNC has none


def test_the_interface_records_and_the_position_becomes_right(figures_of: Any) -> None:
    motion = Motion((Ramp(0.2, 0.0), Ramp(1.0, 13.3)))
    bench = running(1.5, encoder=random_encoder(3), motion=motion, timing=SyncTiming())
    assert bench.value(0x2011, 1) & 0x7F == 0x01
    before = np.ptp(position_errors(bench, 400))
    words = ("--method", "zero-crossings", "--source", "recording", "--seconds", "2")
    figures = figures_of(bench, *words)
    assert figures["crc32"] == f"{bench.value(0x2020, 4):08X}"
    after = np.ptp(position_errors(bench, 400))
    assert before > 0.01
    assert 1e-5 < after < 0.002
    assert bench.value(0x2011, 1) & 0x7F == 0x01, "valid, and nothing else to say"
    assert bench.value(0x2012, 1) == 0, "no sample missed"
