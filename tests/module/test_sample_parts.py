"""A sample in several PDOs: parts of two samples make no valid one, whatever is doubled, late or lost."""

from __future__ import annotations

import struct
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from canfb import objects as od
from canfb.cia301.frame import Frame
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from canfb.signal.feedback import Feedback
from canfb.signal.sample import Sample
from canfb.signal.supervision import VALID

PERIOD_S = 1e-3
TRACKS, EXTRA, TIME = 0x190, 0x290, 0x390


class Parts:
    """A module of four pairs and their time, in three PDOs; each part of sample n has the number n in it."""

    def __init__(self) -> None:
        self.module = FeedbackModule(ModuleConfig(node_id=32, samples_per_sync=4, times=True, autostart=True))
        self.module.start(0.0)
        self.taken: list[Sample] = []
        self.valid: list[bool] = []  # the position of each of these
        step = self.module.chain.step

        def spy(sample: Sample, *known: Any) -> Feedback:
            before = self.module.chain.samples
            feedback = step(sample, *known)
            if feedback.samples > before:  # else its time is an earlier one
                self.taken.append(sample)
                self.valid.append(bool(feedback.status & VALID))
            return feedback

        self.module.chain.step = spy  # type: ignore[method-assign, assignment]
        self.now = 1.0

    def hear(self, can_id: int, data: bytes = b"") -> None:
        self.now += 1e-5
        self.module.receive(Frame(can_id, data, timestamp=self.now), self.now)

    def part(self, can_id: int, number: int) -> None:
        if can_id == TIME:
            self.hear(TIME, struct.pack("<I", number * 10_000))
        else:
            self.hear(can_id, struct.pack("<4h", 1000, number, 1000, number))

    def sync(self, number: int) -> None:
        self.now = 1.0 + number * PERIOD_S
        self.hear(0x80)

    @property
    def bad_frames(self) -> int:
        return int(self.module.dictionary.entry(*od.COUNTER_BAD_FRAMES).value)


def numbers(sample: Sample) -> set[int]:
    """Which samples this one is made of."""
    times = [] if sample.time_100ns is None else [sample.time_100ns // 10_000]
    return {int(sample.cosine), *times, *(int(pair[1]) for pair in sample.earlier)}


FATES = st.sampled_from(["sent"] * 6 + ["lost", "doubled", "late"])


@given(st.lists(FATES, min_size=1, max_size=30), st.randoms(use_true_random=False))
def test_no_sample_has_parts_of_two(fates: list[str], random: object) -> None:
    bus, late = Parts(), list[tuple[int, int]]()
    choose = random.choice  # type: ignore[attr-defined]
    for number, fate in enumerate(["sent", "sent", *fates], 1):
        bus.sync(number)
        frames = [(can_id, number) for can_id in (TRACKS, EXTRA, TIME)]
        struck = choose(frames)
        if fate == "lost":
            frames.remove(struck)
        if fate == "doubled":
            frames.insert(choose(range(4)), struck)
        came = {can_id for can_id, _ in frames}
        for one in late:
            if one[0] in came:  # a late part in place of a lost one is that of a healthy bus
                frames.insert(choose(range(len(frames) + 1)), one)
        late = [struck] if fate == "late" and not late else []
        for one in late:
            frames.remove(one)
        for can_id, of in frames:
            bus.part(can_id, of)
    mixed = [len(numbers(sample)) > 1 for sample in bus.taken]  # its time gives it away, if nothing else does
    assert not any(one and valid for one, valid in zip(mixed, bus.valid, strict=True))


def test_a_doubled_part_costs_its_sample_only() -> None:
    bus = Parts()
    for number in range(1, 20):
        bus.sync(number)
        for can_id in (TRACKS, EXTRA, TIME):
            bus.part(can_id, number)
            if number == 10 and can_id == TRACKS:
                bus.part(TRACKS, 9)
    assert [int(sample.cosine) for sample in bus.taken] == [*range(1, 10), *range(11, 20)]
    assert bus.bad_frames == 1
