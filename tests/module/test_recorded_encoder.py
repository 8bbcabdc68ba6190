"""The tracks of a real encoder, played SYNC by SYNC, tracked by the module, compared with their own index."""

import math
import os
import struct
from pathlib import Path

import numpy as np
import pytest

from canfb import Conditioning, FeedbackModule, Frame, ModuleConfig, StatusBit
from canfb.interface.encoder_interface import EncoderInterface
from canfb.simulation.embedded_bus import EmbeddedBus
from canfb.sources.recording_source import RecordingLayout, open_recording

FOLDER = Path(os.environ.get("CANFB_RECORDINGS", Path(__file__).parents[3] / "shared" / "data"))
RECORDING = FOLDER / "servoproject_optical_encoder.csv"
NODE_ID, INTERFACE_ID = 0x20, 0x10
SYNC_PERIOD_S = 1e-3
GAP_S, INDEX_RANGE, UNITS_PER_CYCLE = 0.1, 2048, 8192
MID_SCALE, RADIUS = 8192, 4000
LAYOUT = RecordingLayout(("b", "a"), MID_SCALE, "t_s", gap_samples=6)
# The ellipse that the recording's description gives, track b as the sine.
CONDITIONING = Conditioning(
    sine_offset_counts=12910 - MID_SCALE,
    cosine_offset_counts=9593 - MID_SCALE,
    sine_gain=RADIUS / 3132,
    cosine_gain=RADIUS / 5251,
    phase_error_rad=math.radians(14.6),
)


def play(rows: int) -> list[list[tuple[int, int]]]:
    """SYNC by SYNC through the recording: position and status of every sample, by segment.

    As a master would, the module is started again when it says that the position is lost.
    """
    bus = EmbeddedBus()
    played: list[list[tuple[int, int]]] = [[]]
    positions: list[Frame] = []
    bus.observers.append(
        lambda frame, now: positions.append(frame) if frame.can_id == 0x180 + NODE_ID else None
    )
    module = ModuleConfig(
        node_id=NODE_ID, encoder_interface=INTERFACE_ID, adc_bits=14, conditioning=CONDITIONING
    )
    feedback = FeedbackModule(module)
    bus.attach(feedback)
    bus.attach(EncoderInterface(INTERFACE_ID, open_recording(RECORDING, LAYOUT)))
    for node in (NODE_ID, INTERFACE_ID):
        bus.send(Frame(0, bytes([1, node])))
    count = 0
    while count < rows:
        bus.run_until(bus.now + SYNC_PERIOD_S)
        positions.clear()
        bus.send(Frame(0x80, b""))
        for frame in positions[:]:
            position, status, _ = struct.unpack("<IHH", frame.data)
            if not status & StatusBit.MISSED:
                played[-1].append((position, status))
                count += 1
            elif status & StatusBit.LOST:
                played.append([])
                feedback.chain.restart()  # it turns on: NMT alone would leave it lost
    return [part for part in played if part]


@pytest.mark.skipif(not RECORDING.exists(), reason="no recording here; CANFB_RECORDINGS names its folder")
def test_the_published_cycles_agree_with_the_index_over_every_segment() -> None:
    rows = np.genfromtxt(RECORDING, delimiter=",", names=True)
    *parts, last = np.split(rows["fw_index"], np.flatnonzero(np.diff(rows["t_s"]) > GAP_S) + 1)
    # Stretches between the gaps, without the last sample before each gap.
    segments = [part for part in (*(part[:-1] for part in parts), last) if part.size]
    played = play(sum(map(len, segments)))
    assert [len(part) for part in played] == [len(part) for part in segments]
    assert len(segments) == 25
    for part, places in zip(played, segments, strict=True):
        position = np.unwrap([p for p, _ in part], period=2500 * UNITS_PER_CYCLE * 209) / UNITS_PER_CYCLE
        index = np.unwrap(places, period=INDEX_RANGE) / INDEX_RANGE
        deviation = (position - position[0]) - (index - index[0])
        assert all(status & StatusBit.VALID for _, status in part)
        assert abs(deviation[-1]) < 0.25
        assert 0.001 < np.abs(deviation - np.median(deviation)).max() < 0.25
