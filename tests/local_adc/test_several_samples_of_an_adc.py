"""A converter that samples by a clock of its own, faster than SYNC: several samples for each, time stamps."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from emulated_iiod import EmulatedIiod
from iio_kit import LIMIT_S, Machine, deliver, reading

from canfb.cia301.frame import Frame
from canfb.configuration import ANY_NODES, Config, parse_config
from canfb.errors import ConfigError
from canfb.hosting.captured_source import CapturedSource
from canfb.hosting.hosting import make_interface, open_source
from canfb.interface.encoder_interface import EncoderInterface
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from canfb.signal.supervision import MISSED, VALID
from canfb.simulation.motion import Ramp

Iiod = Callable[..., EmulatedIiod]
SYNC = Frame(0x80, b"")
SYNC_S, SCANS = 1e-3, 4
SYNCS = 700
FAST_RPM = 600.0  # 25 cycles in each interval of SYNC
ADC_S = 2.6e-4  # no part of SYNC_S: a scan is up to a quarter of an interval old
SLOW_RPM = 60.0  # 2.5 cycles in each interval: 0.65 between two of these scans
SOURCE = f"source: {{kind: iio, device: ads7950, scans_per_sync: {SCANS}, uri: "
KEYS = f"samples_per_sync: 2, autostart: true, {SOURCE}"


@pytest.fixture
def resources() -> Iterator[contextlib.ExitStack]:
    with contextlib.ExitStack() as stack:
        yield stack


def configured(server: EmulatedIiod, text: str) -> Any:
    return parse_config(text.replace("uri: ", f"uri: 'ip:127.0.0.1:{server.port}'}}"), needs=ANY_NODES)


def turning(scan_s: float = SYNC_S / SCANS * (1.0 + 20e-6), rpm: float = FAST_RPM) -> Machine:
    return Machine(scan_s, Ramp(0.1, 0.0), Ramp(0.5, rpm))


def follow(
    server: EmulatedIiod,
    source: CapturedSource,
    module: FeedbackModule,
    sync: Callable[[float], object],
    machine: Machine,
) -> None:
    """SYNC after SYNC, heard up to 0.2 ms late; the position is right at each of them that is valid."""
    rng, valid = np.random.default_rng(5), 0
    for number in range(1, SYNCS + 1):
        heard_s = number * SYNC_S + float(rng.uniform(0.0, 2e-4))
        deliver(server, source, *machine.scans_until(heard_s))
        sync(heard_s)
        feedback = module.feedback
        if feedback is None or not feedback.status & VALID:
            continue
        valid += 1
        scan = round(1e-7 * int(module.dictionary.entry(0x2000, 5).value) / machine.scan_s)
        truth = machine.truth_cycles[scan]
        assert abs(feedback.cycles + feedback.phase - truth) < 0.02, number
        assert number < 20 or not feedback.status & MISSED
    assert valid > 0.95 * SYNCS
    assert truth > 500


def test_a_module_with_an_adc_of_its_own_takes_two(iiod: Iiod, resources: contextlib.ExitStack) -> None:
    server = iiod()
    (config,) = configured(server, f"modules: [{{node_id: 32, {KEYS}}}]").modules
    assert config.source is not None
    config, source = open_source(config, config.source, Config(), resources)
    assert isinstance(source, CapturedSource)
    assert server.opened.wait(LIMIT_S)
    module = FeedbackModule(config, source=source)
    module.start(0.0)
    follow(server, source, module, lambda now: module.receive(SYNC, now), turning())
    assert module.dictionary.entry(0x2011, 8).current() > 1.9 * 0.95 * SYNCS, "all pairs are processed"
    newest, earlier = (
        (module.dictionary.entry(0x2000, sine).value, module.dictionary.entry(0x2000, sine + 1).value)
        for sine in (1, 8)
    )
    assert newest != earlier


def interface_of(
    server: EmulatedIiod, resources: contextlib.ExitStack
) -> tuple[EncoderInterface, CapturedSource]:
    """An interface that sends two samples for each SYNC, and its source."""
    (config,) = configured(server, f"interfaces: [{{node_id: 16, times: true, {KEYS}}}]").interfaces
    interface = make_interface(config, resources, {})
    assert server.opened.wait(LIMIT_S)
    assert isinstance(interface.source, CapturedSource)
    return interface, interface.source


def test_an_interface_sends_two_and_the_module_follows(iiod: Iiod, resources: contextlib.ExitStack) -> None:
    server = iiod()
    interface, source = interface_of(server, resources)
    module = FeedbackModule(ModuleConfig(node_id=32, times=True, samples_per_sync=2, autostart=True))
    for device in (interface, module):
        device.start(0.0)

    def sync(now: float) -> None:
        module.receive(SYNC._replace(timestamp=now), now)
        sent = interface.receive(SYNC._replace(timestamp=now), now)
        assert [len(frame.data) for frame in sent] in ([8, 4], [])
        for frame in sent:
            module.receive(frame, now + 1e-4)

    follow(server, source, module, sync, turning())
    assert interface.missed < 5


def test_the_pairs_are_half_an_interval_apart(iiod: Iiod, resources: contextlib.ExitStack) -> None:
    server = iiod()
    interface, source = interface_of(server, resources)
    interface.start(0.0)
    sent: list[Frame] = []
    for number in range(1, 20):
        scans = range(SCANS * (number - 1), SCANS * number)
        deliver(server, source, *[reading(2048 + n, 2048 - n, n * 250_000) for n in scans])
        sent += interface.receive(SYNC, number * SYNC_S)
    pairs = [struct.unpack("<4h", frame.data) for frame in sent if frame.can_id == 0x190]
    times = [struct.unpack("<I", frame.data)[0] for frame in sent if frame.can_id == 0x290]
    assert len(pairs) == len(times) > 15
    for (sine, cosine, sine_1, cosine_1), time in zip(pairs, times, strict=True):
        assert (cosine, sine_1, cosine_1) == (-sine, sine - 2, 2 - sine)
        assert time == sine * 2500


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("", "samples_per_sync: 2 need scans_per_sync in source, a multiple of it, not None"),
        (", scans_per_sync: 5", "samples_per_sync: 2 need scans_per_sync in source, a multiple of it, not 5"),
        (", scans_per_sync: 4, time_stamps: false", "scans_per_sync needs time_stamps: true"),
        (", scans_per_sync: 1", "scans_per_sync must be a whole number 2..256, not 1"),
    ],
)
def test_what_cannot_be_is_told_by_the_configuration(source: str, words: str) -> None:
    for key in ("modules", "interfaces"):
        with pytest.raises(ConfigError) as caught:
            parse_config(
                f"{key}: [{{node_id: 3, samples_per_sync: 2, source: {{kind: iio, device: x{source}}}}}]",
                needs=ANY_NODES,
            )
        assert words in str(caught.value)


def test_a_trigger_that_is_fired_has_no_clock(iiod: Iiod, opened: Callable[..., CapturedSource]) -> None:
    with pytest.raises(ConfigError, match="'sysfstrig7' gives one scan for each SYNC; scans_per_sync"):
        opened(iiod(), trigger="sysfstrig7", scans_per_sync=4)


def on_its_own(source: CapturedSource) -> FeedbackModule:
    """A module on a converter whose scans are no part of the interval of SYNC."""
    module = FeedbackModule(ModuleConfig(node_id=32, adc_bits=source.adc_bits, autostart=True), source=source)
    module.start(0.0)
    return module


def test_with_time_stamps_the_position_is_right(iiod: Iiod, opened: Callable[..., CapturedSource]) -> None:
    server = iiod()
    source = opened(server)
    module = on_its_own(source)
    follow(server, source, module, lambda now: module.receive(SYNC, now), turning(ADC_S, SLOW_RPM))


def test_without_them_it_is_lost_and_nobody_is_told_a_wrong_one(
    iiod: Iiod, opened: Callable[..., CapturedSource]
) -> None:
    server = iiod()
    source = opened(server, time_stamps=False)
    module, machine = on_its_own(source), turning(ADC_S, SLOW_RPM)
    for number in range(1, SYNCS + 1):
        deliver(server, source, *machine.scans_until(number * SYNC_S))
        module.receive(SYNC, number * SYNC_S)
        feedback = module.feedback
        assert feedback is not None
        error = feedback.cycles + feedback.phase - machine.truth_cycles[-1]
        is_valid = bool(feedback.status & VALID)
        assert not is_valid or abs(error) <= 0.5
    assert not is_valid
