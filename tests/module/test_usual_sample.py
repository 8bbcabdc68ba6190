"""A sample in one piece, the same as part by part; parts of two samples, which make no valid one."""

import struct
from typing import Any

import pytest
from hypothesis import example, given, strategies as st

from canfb import Feedback, FeedbackModule, Frame, ModuleConfig, Sample, objects as od
from canfb.cia301.codes import SdoAbort
from canfb.signal.supervision import VALID
from drawing import examples
from ideal_tracks import Resolving, adc_pdo, wavy_table

SYNC, ADC_PDO = 0x80, 0x190
TABLE = wavy_table(64, 0.02)
STOP, OPERATIONAL, PRE_OPERATIONAL, RESET_COMMUNICATION = (
    Frame(0, bytes([command, 32])) for command in (2, 1, 128, 130)
)
ONE_WRITE: dict[str, tuple[int, int, float]] = {
    "reverse": (0x6000, 0, 1), "preset": (0x6003, 0, 77), "predict": (0x2013, 1, 1),
    "no prediction": (0x2013, 1, 0), "acceleration": (0x2010, 2, 1e4), "residual": (0x2010, 1, 2000),
    "flags": (0x2000, 6, 2), "no flags": (0x2000, 6, 0), "low": (0x2001, 3, 1400),
    "warnings": (0x2004, 2, 0), "noise margin": (0x2010, 9, 8.0), "recording": (0x2050, 1, 1),
    "PDO off": (0x1800, 1, 0x800001A0), "PDO on": (0x1800, 1, 0x1A0), "PDO at SYNC": (0x1800, 2, 1),
    "cycles": (0x2001, 1, 100), "corner": (0x2001, 5, 800.0), "no corner": (0x2001, 5, 0.0),
}  # fmt: skip
WRITES: dict[str, list[tuple[int, int, float]]] = {
    **{name: [write] for name, write in ONE_WRITE.items()},
    "scaling": [(0x6001, 0, 10_000), (0x6000, 0, 4)],
    "cam": [(0x6310, 1, 100), (0x6320, 1, 9000), (0x6330, 1, 20), (0x6301, 1, 1)],
    "delay": [(0x2002, 7, 3e-4), (0x2020, 3, 0)],
    "negative delay": [(0x2002, 7, -2e-4), (0x2020, 3, TABLE.crc32)],
    "cosine delay": [(0x2002, 6, 1e-5), (0x2020, 3, 0)],
    "no delays": [(0x2002, 6, 0.0), (0x2002, 7, 0.0), (0x2020, 3, TABLE.crc32)],
}
FRAMES = {
    "stop": STOP, "operational": OPERATIONAL, "pre-operational": PRE_OPERATIONAL,
    "reset": RESET_COMMUNICATION, "bad length": Frame(ADC_PDO, b"\1\2\3"),
}  # fmt: skip
SAMPLES = (
    *("run", "run", "run", "still", "jump", "weak"),
    *("missed", "lost SYNC", "doubled", "doubled SYNC", "late"),
)
happenings = st.lists(
    st.tuples(
        st.sampled_from([*SAMPLES, *WRITES, *FRAMES, "table", "stamps", "listen"]), st.floats(0.0, 1.0)
    ),
    min_size=3,
    max_size=15,
)


class Observer:
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
        self.send(adc_pdo(position, amplitude, self.now if self.times else None), 0.0002)

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
@examples(60)
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
        for can_id, of in (one for one in frames if one not in late):
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
