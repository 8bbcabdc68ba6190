"""A converter that samples by a clock of its own, faster than the SYNC: what its time stamps are worth."""

from __future__ import annotations

from collections.abc import Callable

from emulated_iiod import EmulatedIiod
from iio_kit import Machine, deliver

from canfb.cia301.frame import Frame
from canfb.hosting.captured_source import CapturedSource
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from canfb.signal.supervision import MISSED, VALID
from canfb.simulation.motion import Ramp

SYNC_S, ADC_S = 1e-3, 2.6e-4  # no multiple of one another: a scan is up to a quarter of an interval old
SYNCS = 1200
RPM = 60.0  # 2.5 cycles in each interval: 0.65 between two scans


def run(server: EmulatedIiod, source: CapturedSource) -> tuple[list[int], list[float]]:
    """Status words, and errors of the position against the truth at the instant of the scan, cycles."""
    machine = Machine(ADC_S, Ramp(0.1, 0.0), Ramp(0.8, RPM))
    module = FeedbackModule(ModuleConfig(node_id=32, adc_bits=source.adc_bits, autostart=True), source=source)
    module.start(0.0)
    status, errors = [], []
    for number in range(1, SYNCS + 1):
        deliver(server, source, *machine.scans_until(number * SYNC_S))
        module.receive(Frame(0x80, b""), number * SYNC_S)
        feedback = module.feedback
        assert feedback is not None
        status.append(feedback.status)
        errors.append(feedback.cycles + feedback.phase - machine.truth_cycles[-1])
    assert machine.truth_cycles[-1] > 1500
    return status, errors


def test_with_time_stamps_the_position_is_right(
    iiod: Callable[..., EmulatedIiod], opened: Callable[..., CapturedSource]
) -> None:
    server = iiod()
    status, errors = run(server, opened(server))
    assert all(word & VALID and not word & MISSED for word in status)
    whole = round(errors[0])  # the count begins anew where the encoder stands
    assert max(abs(error - whole) for error in errors) < 0.02


def test_without_them_it_is_lost_and_nobody_is_told_a_wrong_one(
    iiod: Callable[..., EmulatedIiod], opened: Callable[..., CapturedSource]
) -> None:
    server = iiod()
    status, errors = run(server, opened(server, time_stamps=False))
    assert not status[-1] & VALID
    wrong = [error for word, error in zip(status, errors, strict=True) if word & VALID and abs(error) > 0.5]
    assert not wrong
