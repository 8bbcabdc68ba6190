"""The usual sample in one piece: the same frames and the same objects as part by part."""

from __future__ import annotations

import struct
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canfb.cia301.codes import SdoAbort
from canfb.cia301.frame import Frame
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from canfb.signal.feedback import Feedback
from canfb.signal.sample import Sample
from canfb.signal.stages import Stages
from ideal_tracks import counts_at, wavy_table

SYNC, ADC_PDO = 0x80, 0x190
TABLE = wavy_table(64, 0.02)
STOP, OPERATIONAL, PRE_OPERATIONAL, RESET_COMMUNICATION = (
    Frame(0, bytes([command, 32])) for command in (2, 1, 128, 130)
)
WRITES: dict[str, list[tuple[int, int, float]]] = {
    "scaling": [(0x6001, 0, 10_000), (0x6000, 0, 4)],
    "reverse": [(0x6000, 0, 1)],
    "preset": [(0x6003, 0, 77)],
    "cam": [(0x6310, 1, 100), (0x6320, 1, 9000), (0x6330, 1, 20), (0x6301, 1, 1)],
    "predict": [(0x2013, 1, 1)],
    "no prediction": [(0x2013, 1, 0)],
    "acceleration": [(0x2010, 2, 1e4)],
    "residual": [(0x2010, 1, 2000)],
    "flags": [(0x2000, 6, 2)],
    "no flags": [(0x2000, 6, 0)],
    "low": [(0x2001, 3, 1400)],
    "warnings": [(0x2004, 2, 0)],
    "noise margin": [(0x2010, 9, 8.0)],
    "recording": [(0x2050, 1, 1)],
    "PDO off": [(0x1800, 1, 0x800001A0)],
    "PDO on": [(0x1800, 1, 0x1A0)],
    "PDO at SYNC": [(0x1800, 2, 1)],
    "cycles": [(0x2001, 1, 100)],
    "delay": [(0x2002, 7, 3e-4), (0x2020, 3, 0)],
    "negative delay": [(0x2002, 7, -2e-4), (0x2020, 3, TABLE.crc32)],
    "cosine delay": [(0x2002, 6, 1e-5), (0x2020, 3, 0)],
    "no delays": [(0x2002, 6, 0.0), (0x2002, 7, 0.0), (0x2020, 3, TABLE.crc32)],
    "corner": [(0x2001, 5, 800.0)],
    "no corner": [(0x2001, 5, 0.0)],
}
FRAMES = {
    "stop": STOP,
    "operational": OPERATIONAL,
    "pre-operational": PRE_OPERATIONAL,
    "reset": RESET_COMMUNICATION,
    "bad length": Frame(ADC_PDO, b"\1\2\3"),
}
SAMPLES = (
    "run",
    "run",
    "run",
    "still",
    "jump",
    "weak",
    "missed",
    "lost SYNC",
    "doubled",
    "doubled SYNC",
    "late",
)
happenings = st.lists(
    st.tuples(
        st.sampled_from([*SAMPLES, *WRITES, *FRAMES, "table", "stamps", "listen"]), st.floats(0.0, 1.0)
    ),
    min_size=3,
    max_size=15,
)


class Resolving(Stages):
    """Stages that take no sample for a usual one."""

    def _look_again(self, feedback: Feedback) -> None:
        super()._look_again(feedback)
        self._nothing_in_doubt = False


class Observer:
    """Sees samples, and forgets them."""

    def take(self, sample: Sample, feedback: Feedback) -> None: ...

    def miss(self) -> None: ...


class Pair:
    """Two modules that hear the same; the second takes each sample part by part."""

    @property
    def usual(self) -> int:
        """Samples that took the short way."""
        return self.modules[0].chain.samples - self.resolved

    def __init__(self, times: bool = False) -> None:
        config = ModuleConfig(node_id=32, encoder_interface=16, autostart=True, times=times)
        self.times = times
        self.modules = FeedbackModule(config), FeedbackModule(config)
        self.modules[1].chain.stages.__class__ = Resolving
        self.modules[1]._observers.add(Observer())  # who gets each sample as a Sample
        self.resolved = 0
        resolve = self.modules[0].chain.stages._resolve

        def counted(*arguments: Any) -> Feedback:
            self.resolved += 1
            return resolve(*arguments)

        self.modules[0].chain.stages._resolve = counted  # type: ignore[method-assign, assignment]
        self.now, self.stamps = 0.0, True
        self.heard: tuple[list[Feedback], list[Feedback]] = ([], [])
        for module in self.modules:
            module.start(0.0)

    def send(self, frame: Frame, after_s: float = 0.0) -> None:
        self.now += after_s
        for module in self.modules:
            while (due := module.deadline()) is not None and due <= self.now:
                module.tick(due)
        stamped = frame._replace(timestamp=self.now) if self.stamps else frame
        ours, theirs = (module.receive(stamped, self.now) for module in self.modules)
        assert ours == theirs

    def sample(self, position: float, amplitude: float = 1500.0) -> None:
        data = struct.pack("<hh", *counts_at(position, amplitude))
        if self.times:
            data += struct.pack("<I", round(self.now * 1e7) & 0xFFFFFFFF)
        self.send(Frame(ADC_PDO, data), 0.0002)

    def write(self, index: int, subindex: int, value: float) -> None:
        for module in self.modules:
            entry = module.dictionary.entry(index, subindex)
            try:
                entry.store(value)
            except SdoAbort:
                continue

    def listen(self) -> None:
        for module, heard in zip(self.modules, self.heard, strict=True):
            module.on_feedback = lambda feedback, now, heard=heard: heard.append(feedback)

    def compare(self) -> None:
        ours, theirs = (
            [(entry.index, entry.subindex, read(entry)) for entry in module.dictionary]
            for module in self.modules
        )
        assert ours == theirs
        assert repr(self.modules[0].feedback) == repr(self.modules[1].feedback)
        assert repr(self.heard[0]) == repr(self.heard[1])
        assert self.modules[0].deadline() == self.modules[1].deadline()


def read(entry: object) -> str:
    try:
        return repr(entry.current())  # type: ignore[attr-defined]
    except SdoAbort as abort:
        return str(abort)


@pytest.mark.parametrize("times", [False, True])
@given(happenings=happenings, speed=st.floats(0.05, 0.4))
@example(  # the pace of the interface passes a limit in a usual sample
    happenings=[("lost SYNC", 0.0), ("run", 0.0), ("run", 0.0), ("run", 0.0)], speed=0.25
)
@example(  # the interval of SYNC changes by less than a limit, by more than the delay of the cosine bears
    happenings=[("missed", 0.0), ("cosine delay", 0.0), ("missed", 0.0), ("run", 0.0)], speed=0.25
)
def test_frames_and_objects_are_those_of_the_parts(
    times: bool, happenings: list[tuple[str, float]], speed: float
) -> None:
    pair = Pair(times)
    position = step = 0.0
    for kind, x in [("run", 0.0), *happenings]:
        if kind in WRITES:
            for write in WRITES[kind]:
                pair.write(*write)
        elif kind in FRAMES:
            pair.send(FRAMES[kind], 0.0003)
        elif kind == "table":
            for module in pair.modules:
                module.dictionary.entry(0x2020, 1).download(TABLE.to_bytes())
                module.dictionary.entry(0x2020, 3).download(TABLE.crc32.to_bytes(4, "little"))
        elif kind == "stamps":
            pair.stamps = x > 0.5
        elif kind == "listen":
            pair.listen()
        for k in range(30 if kind == "run" else 6):
            step += (speed - step) * 0.02
            position += 0.0 if kind == "still" else step
            if not (kind == "lost SYNC" and k == 3):
                pair.send(Frame(SYNC, b""), 0.0008)
            if kind == "doubled SYNC" and k == 3:
                pair.send(Frame(SYNC, b""), 0.00001)
            if kind == "missed" and k == 3:
                continue
            if kind == "late" and k == 3:
                pair.now += 0.0007 * x
            amplitude = 1500.0 * x if kind == "weak" and k == 3 else 1500.0
            pair.sample(position + (x if kind == "jump" and k == 3 else 0.0), amplitude)
            if kind == "doubled" and k == 3:
                pair.sample(position)
        pair.compare()
    assert pair.usual > 10


def test_nearly_each_sample_of_a_healthy_machine_takes_the_short_way() -> None:
    pair = Pair()
    for k in range(2000):
        pair.send(Frame(SYNC, b""), 0.0008)
        pair.sample(0.3 * k if k > 20 else 0.0)
    assert pair.usual > 1900
    pair.compare()
