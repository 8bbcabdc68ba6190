from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.objects import MISSED_COUNTS
from canfb.signal import sample_recording
from canfb.signal.sample_recording import BYTES_PER_SAMPLE, SampleRecording

COUNTS = st.integers(-0x8000, 0x7FFF)
SAMPLES = st.lists(st.one_of(st.none(), st.tuples(COUNTS, COUNTS)), max_size=40)


@given(SAMPLES, st.integers(1, 50))
def test_samples_and_gaps_keep_their_places(samples: list[tuple[int, int] | None], capacity: int) -> None:
    recording = SampleRecording(capacity)
    for one in samples:
        recording.miss() if one is None else recording.take(*one)
    kept = [one or (MISSED_COUNTS, MISSED_COUNTS) for one in samples][:capacity]
    assert recording.to_bytes() == b"".join(struct.pack("<hh", *one) for one in kept)
    assert len(recording) == len(kept) == len(recording.to_bytes()) // BYTES_PER_SAMPLE
    assert recording.is_full == (len(kept) == capacity)
    recording.clear()
    assert (len(recording), recording.to_bytes(), recording.is_full) == (0, b"", False)


def test_another_byte_order_gives_the_same_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    recording = SampleRecording()
    recording.take(0x0102, 0x0304)
    monkeypatch.setattr(sample_recording.sys, "byteorder", "big")
    assert recording.to_bytes() == b"\x01\x02\x03\x04"
    monkeypatch.undo()
    assert recording.to_bytes() == b"\x02\x01\x04\x03"


@pytest.mark.parametrize("capacity", [0, -1])
def test_a_recording_holds_at_least_one_sample(capacity: int) -> None:
    with pytest.raises(ValueError, match="1 or more"):
        SampleRecording(capacity)
