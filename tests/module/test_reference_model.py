"""The module against a plain model of it, PDO by PDO."""

from __future__ import annotations

import math
import struct

import pytest
from hypothesis import event, example, given
from hypothesis import strategies as st
from reference_model import RANGE, Beyond, Limits, Published, ReferenceModel

from canfb.cia301.frame import Frame
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from canfb.objects import StatusBit as Bit
from canfb.signal.correction import CorrectionTable

SYNC, ADC_PDO, POSITION_PDO = 0x80, 0x190, 0x1A0
TABLE = CorrectionTable([k / 64 + 0.008 * math.sin(4 * math.pi * k / 64) for k in range(64)])
MOST_ACCELERATION = 0.06  # cycles per interval^2: with the error of Table 1 within the 0.1 that is assumed
AMPLITUDES = {"weak": 300.0, "edge": 415.0, "strong": 2600.0}  # edge: refused after another fault only
FAULTS = ("missed", "weak", "edge", "strong", "clipped", "glitch")
# What concerns others than the position PDO, or brings samples another way through the module.
WRITES: dict[str, list[tuple[int, int, float]]] = {
    "recording": [(0x2050, 1, 1)],
    "no recording": [(0x2050, 1, 2)],
    "cam": [(0x6310, 1, 100), (0x6320, 1, 9000), (0x6330, 1, 20), (0x6301, 1, 1)],
    "predict": [(0x2013, 1, 1)],
    "warnings": [(0x2004, 2, 0)],
    "noise margin": [(0x2010, 9, 8)],
    "reverse": [(0x6000, 0, 1)],
    "forward": [(0x6000, 0, 0)],
}
happenings = st.lists(
    st.tuples(
        st.sampled_from([*FAULTS, *FAULTS, *WRITES, "table", "listen", "none"]),
        st.integers(1, 3) | st.integers(1, 6),
        st.integers(1, 40),
        st.floats(-1.0, 1.0),
    ),
    min_size=1,
    max_size=8,
)


class Bench:
    """A module and the model, and what both say of the same counts."""

    def __init__(self, limits: Limits) -> None:
        self.module = FeedbackModule(
            ModuleConfig(node_id=32, autostart=True, bad_samples=limits.bad, coast_samples=limits.coast)
        )
        self.model = ReferenceModel(limits)
        self.published: list[Published] = []
        self.expected: list[Published] = []
        self.now = 0.0
        self.module.start(0.0)

    def send(self, can_id: int, data: bytes, after_s: float) -> None:
        self.now += after_s
        while (due := self.module.deadline()) is not None and due <= self.now:
            self._take(self.module.tick(due))
        self._take(self.module.receive(Frame(can_id, data, timestamp=self.now), self.now))

    def _take(self, frames: list[Frame]) -> None:
        self.published += [
            Published(*struct.unpack("<IHH", frame.data)) for frame in frames if frame.can_id == POSITION_PDO
        ]

    def sync(self) -> None:
        self.send(SYNC, b"", 0.0008)

    def sample(self, position: float, amplitude: float = 1500.0) -> None:
        """One SYNC and its sample."""
        self.sync()
        angle = 2.0 * math.pi * position
        sine, cosine = (
            max(-2048, min(2047, round(amplitude * track))) for track in (math.sin(angle), math.cos(angle))
        )
        self.send(ADC_PDO, struct.pack("<hh", sine, cosine), 0.0002)
        self.expected.append(self.model.sample(sine, cosine))

    def miss(self) -> None:
        """One SYNC without a sample."""
        self.sync()
        self.now += 0.0002
        expected = self.model.missed()
        self.expected += [] if expected is None else [expected]

    def write(self, what: str) -> None:
        entry = self.module.dictionary.entry
        if what == "listen":
            self.module.on_feedback = lambda feedback, now: None
        elif what == "table":
            entry(0x2020, 1).download(TABLE.to_bytes())
            entry(0x2020, 3).download(TABLE.crc32.to_bytes(4, "little"))
            self.model.table = [float(one) for one in TABLE.entries]
        for index, subindex, value in WRITES.get(what, ()):
            entry(index, subindex).store(value)
        units = abs(self.model.units_per_revolution)
        if what in ("reverse", "forward"):
            self.model.units_per_revolution = -units if what == "reverse" else units

    def compare(self) -> None:
        for number, (one, other) in enumerate(zip(self.published, self.expected, strict=False)):
            off = abs((one.position - other.position + RANGE // 2) % RANGE - RANGE // 2)
            same = one.status == other.status and off <= 1 and abs(one.residual - other.residual) <= 1
            assert same, f"PDO {number}: {one} {Bit(one.status)!r}, expected {other} {Bit(other.status)!r}"


@given(
    happenings=happenings,
    speed=st.floats(-0.45, 3.0),
    bad=st.integers(1, 2),
    coast=st.integers(1, 5) | st.just(0),
)
@example(happenings=[("glitch", 1, 1, 0.0)], speed=0.0, bad=1, coast=3)
@example(happenings=[("missed", 3, 9, 0.0), ("weak", 2, 9, 0.0)], speed=1.5, bad=1, coast=3)
@example(happenings=[("edge", 2, 9, 0.0)], speed=0.5, bad=1, coast=3)
@example(happenings=[("table", 1, 9, 0.0), ("missed", 4, 9, 0.0)], speed=0.3, bad=2, coast=3)
def test_the_module_publishes_what_the_model_says(
    happenings: list[tuple[str, int, int, float]], speed: float, bad: int, coast: int
) -> None:
    bench = Bench(Limits(bad=bad, coast=coast))
    position = step = 0.0
    end = "all of it"
    try:
        for _ in range(30):
            bench.sample(0.0)
        for fault, row, run, x in [*happenings, ("none", 0, 30, 0.0)]:
            if fault not in FAULTS:
                bench.write(fault)
            for k in range(row + run):
                step += max(-MOST_ACCELERATION, min(speed - step, MOST_ACCELERATION))
                position += step
                if k >= row or fault not in FAULTS:
                    bench.sample(position)
                elif fault == "missed":
                    bench.miss()
                elif fault == "glitch":
                    bench.sample(position + (0.5 + 0.02 * x if k == 0 else 0.0))
                elif fault == "clipped":
                    bench.sample(round(4.0 * position) / 4.0, 2200.0)
                else:
                    bench.sample(position, AMPLITUDES[fault if k else "weak"])
    except Beyond as beyond:
        end = str(beyond)
    event(end)
    event("lost" if bench.model.lost else "counted")
    bench.sync()
    bench.compare()
    assert len(bench.published) >= len(bench.expected)


@pytest.mark.parametrize("speed", [0.0, 0.2, 7.25])
def test_the_model_follows_the_machine(speed: float) -> None:
    """What is compared with is right where the truth is known: no fault, and a gap that is bridged."""
    model = ReferenceModel()
    position = step = 0.0
    for k in range(400):
        step += max(-MOST_ACCELERATION, min(speed - step, MOST_ACCELERATION))
        position += step
        if k in (200, 201):
            missed = model.missed()
            assert missed is not None
            assert missed.status == Bit.COASTING | Bit.MISSED
            continue
        angle = 2.0 * math.pi * position
        published = model.sample(round(1500 * math.sin(angle)), round(1500 * math.cos(angle)))
        assert published.status == Bit.VALID
        assert abs((published.position - position * 8192 + RANGE // 2) % RANGE - RANGE // 2) < 0.0125 * 8192
