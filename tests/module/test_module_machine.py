"""The whole module against the plain model of it (reference_model), whatever happens in whatever order.

A machine that accelerates, with SYNCs and samples; samples that are missing, faulty or flagged, SYNCs and
PDOs that come twice or are too short, frames of others, SDO writes, NMT, resets, pauses, silence. Every PDO
is that of the model; after a pause, which it does not know, a valid position is right, and none in motion
is valid.
"""

import math
import struct
from collections import Counter
from dataclasses import replace

from hypothesis import event, settings, strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from reference_model import RANGE, Beyond, Limits, Published, ReferenceModel

from canfb import CorrectionTable, FeedbackModule, Frame, ModuleConfig
from canfb.objects import StatusBit as Bit
from ideal_tracks import counts_at

SYNC, ADC_PDO, POSITION_PDO, NODE = 0x80, 0x190, 0x1A0, 32
UNITS = 8192  # of 6004h in a cycle
TABLE = CorrectionTable([k / 64 + 0.008 * math.sin(4 * math.pi * k / 64) for k in range(64)])
MOST_ACCELERATION = 0.06  # cycles per interval^2: with the error of Table 1 within the 0.1 that is assumed
PHASE_ERROR = 0.0135  # cycles: of Table 1 where no table is, and of the rounding of 6004h
AMPLITUDES = {"weak": 300.0, "edge": 415.0, "strong": 2600.0}  # edge: refused after another fault only
FAULTS = ("weak", "edge", "strong", "clipped", "glitch", "invalid")
CONFIRMED, AT_REST, STANDING = 30, 20, 300  # samples; the last ends a loss
# What concerns others than the position PDO: index, sub-index, type, value.
WRITES = {
    "recording": (0x2050, 1, "B", 1), "no recording": (0x2050, 1, "B", 2), "cam": (0x6310, 1, "i", 100),
    "cams on": (0x6301, 1, "B", 1), "predict": (0x2013, 1, "B", 1), "noise margin": (0x2010, 9, "B", 8),
    "heartbeat": (0x1017, 0, "H", 7), "guard of 1016h": (0x1016, 1, "I", 0x100010),
    "refused": (0x2001, 1, "I", 0),
}  # fmt: skip
COUNTER_MISSED, COUNTER_BAD_FRAMES, COUNTER_DOUBLED_SYNCS = (0x2012, 1), (0x2012, 8), (0x2012, 13)
TURNING = st.floats(0.03, 0.12) | st.floats(0.12, 3.0) | st.floats(-3.0, -0.03)
STATUS_WORD, FLAGS = (0x2011, 1), (0x2000, 6, "B")
# Sub-index of 2012h: the bits of the published status words that it counts.
COUNTERS = {2: Bit.RESIDUAL, 3: Bit.AMPLITUDE | Bit.CLIPPED, 4: Bit.COASTING, 9: Bit.CLIPPED}


class ModuleMachine(RuleBasedStateMachine):
    """One module, its model, and the machine that both follow."""

    @initialize(bad=st.integers(1, 2), coast=st.integers(0, 5))
    def power_on(self, bad: int, coast: int) -> None:
        config = ModuleConfig(node_id=NODE, autostart=True, bad_samples=bad, coast_samples=coast)
        self.module = FeedbackModule(config)
        self.limits = Limits(bad=bad, coast=coast)
        self.now = self.position = self.speed = self.target = 0.0
        self.said: list[Published] = []
        self.last = Published(0, 0, 0)
        self.module.start(0.0)
        self._begin()

    def _begin(self) -> None:
        """As after a reset at standstill."""
        self.model = ReferenceModel(self.limits)
        self.missed = self.bad_frames = self.doubled_syncs = 0
        self.flagged: Counter[int] = Counter()
        self.is_beyond = False
        for _ in range(CONFIRMED):
            self._sample()
        self.count = round(self.position - self.last.position / UNITS)  # cycles where it counts from zero

    def _sync(self, sine: int, cosine: int) -> None:
        self._send(SYNC, b"", 0.0008)
        self._send(ADC_PDO, struct.pack("<hh", sine, cosine), 0.0002)

    def _send(self, can_id: int, data: bytes, after_s: float = 0.0) -> list[Frame]:
        self.now += after_s
        sent: list[Frame] = []
        while (due := self.module.deadline()) is not None and due <= self.now:
            sent += self.module.tick(due)
        sent += self.module.receive(Frame(can_id, data, timestamp=self.now), self.now)
        said = [Published(*struct.unpack("<IHH", f.data)) for f in sent if f.can_id == POSITION_PDO]
        self.flagged.update(sub for one in said for sub, bits in COUNTERS.items() if one.status & bits)
        self.said += said
        return sent

    def _compare(self, *expected: Published | None) -> None:
        wanted = [one for one in expected if one is not None]
        said, self.said = self.said, []
        self.is_withheld = False
        assert len(said) == len(wanted), (said, wanted)
        self.last = said[-1] if said else self.last
        for one, other in zip(said, wanted, strict=True):
            off = abs((one.position - other.position + RANGE // 2) % RANGE - RANGE // 2)
            same = one.status == other.status and off <= 1 and abs(one.residual - other.residual) <= 1
            assert same, f"{one} {Bit(one.status)!r}, expected {other} {Bit(other.status)!r}"

    def _step(self) -> None:
        self.speed += max(-MOST_ACCELERATION, min(self.target - self.speed, MOST_ACCELERATION))
        self.position += self.speed

    def _counts(self, position: float, amplitude: float = 1500.0) -> tuple[int, int]:
        sine, cosine = counts_at(position, amplitude)
        return max(-2048, min(2047, sine)), max(-2048, min(2047, cosine))

    def _sample(self, shift: float = 0.0, amplitude: float = 1500.0, *, axis: bool = False) -> None:
        """One SYNC and its sample; on an axis of the circle both tracks can clip."""
        self._step()
        self.doubled = False
        shown = round(4.0 * self.position) / 4.0 if axis else self.position + shift
        pair = self._counts(shown, amplitude)
        self._sync(*pair)
        self._compare(self.model.sample(*pair))

    def _invalid(self) -> None:
        """The interface flags its sample, 2000:06."""
        self._write(*FLAGS, 2)
        self._step()
        self._sync(*self._counts(self.position))
        self.doubled = False
        self._compare(self.model.invalid())
        self._write(*FLAGS, 0)

    def _stop(self) -> None:
        """Brake, and stand for long enough to end a loss, also one of a doubt; nothing is compared."""
        self.target, standing = 0.0, 0
        while standing < (STANDING if self.model.lost or self.model.motions or self.is_beyond else AT_REST):
            self._step()
            standing += self.speed == 0.0
            self._sync(*self._counts(self.position))
        self.said = []

    def _reset(self) -> None:
        """Reset of the node at standstill: what it was told is forgotten, and the table."""
        self._stop()
        self._send(0x000, bytes([129, NODE]), 0.001)
        self.said = []
        self._begin()

    def _try(self, happens: list[tuple[str, int]]) -> None:
        """Samples of these kinds; a reset where the model knows no more."""
        try:
            for kind, count in happens:
                for n in range(count):
                    if kind == "missed":
                        self._miss()
                    elif kind == "good":
                        self._sample()
                    elif kind == "glitch":
                        self._sample(0.5 if n == 0 else 0.0)
                    elif kind == "invalid":
                        self._invalid()
                    elif kind == "clipped":
                        self._sample(amplitude=2200.0, axis=True)
                    else:
                        self._sample(amplitude=AMPLITUDES[kind if n else "weak"])
        except Beyond as beyond:
            event(str(beyond))
            self.is_beyond = True
            self._reset()
            return
        event("lost" if self.model.lost else "counted")
        if self.model.lost:
            self._reset()

    def _miss(self) -> None:
        """A SYNC without a sample: it shows at the next SYNC, or when that is overdue."""
        self._step()
        self._send(SYNC, b"", 0.0008)
        self.missed += 1
        expected = self.model.missed()
        self._step()
        self._send(SYNC, b"", 0.001)
        self._compare(expected)
        self.doubled = False
        pair = self._counts(self.position)
        self._send(ADC_PDO, struct.pack("<hh", *pair), 0.0002)
        self._compare(self.model.sample(*pair))

    def _write(self, index: int, sub: int, kind: str, value: float) -> int:
        """By SDO; the command of the answer."""
        data = struct.pack("<" + kind, value)
        head = struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, index, sub)
        sent = self._send(0x600 + NODE, head + data.ljust(4, b"\0"))
        (answer,) = [one.data[0] for one in sent if one.can_id == 0x580 + NODE]
        return answer

    @rule(speed=st.integers(-29, 192).map(lambda one: one / 64.0), count=st.integers(1, 60))
    def turns(self, speed: float, count: int) -> None:
        self.target = speed
        self._try([("good", count)])

    @rule(kind=st.sampled_from(FAULTS), row=st.integers(1, 6), after=st.integers(1, 40))
    def faults(self, kind: str, row: int, after: int) -> None:
        self._try([(kind, row), ("good", after)])

    @rule(row=st.integers(1, 4), after=st.integers(0, 40))
    def samples_missing(self, row: int, after: int) -> None:
        self._try([("missed", row), ("good", after)])

    @rule(what=st.sampled_from([*WRITES]))
    def writes(self, what: str) -> None:
        assert self._write(*WRITES[what]) == (0x80 if what == "refused" else 0x60)

    @rule(low=st.sampled_from([100, 410, 1000]), scale=st.sampled_from([1800, 2048]))
    def limits_of_a_sample(self, low: int, scale: int) -> None:
        """They are those of the next sample, which is judged without hysteresis."""
        self._write(0x2001, 3, "H", low)
        self._write(0x2001, 2, "H", scale)
        self.model.limits = replace(self.model.limits, low=low, full_scale=scale)
        self.model.after_fault = False

    @rule(reverse=st.booleans())
    def code_sequence(self, reverse: bool) -> None:
        self._write(0x6000, 0, "H", reverse)
        units = abs(self.model.units_per_revolution)
        self.model.units_per_revolution = -units if reverse else units

    @rule()
    def table(self) -> None:
        self.module.dictionary.entry(0x2020, 1).download(TABLE.to_bytes())
        self._write(0x2020, 3, "I", TABLE.crc32)
        self.model.table = [float(one) for one in TABLE.entries]

    @rule(data=st.binary(max_size=3))
    def short_pdo(self, data: bytes) -> None:
        """After the sample of its SYNC, so that nothing is missing."""
        self._send(ADC_PDO, data)
        self.bad_frames += 1

    @rule()
    def doubled_pdo(self) -> None:
        """Once for each sample: four in a row that fit no SYNC are a delay that has changed."""
        if self.module.feedback is not None and not self.doubled:
            self.doubled = True
            self._send(ADC_PDO, struct.pack("<hh", *self._counts(self.position)))
            self.bad_frames += 1

    @rule()
    def doubled_sync(self) -> None:
        """Within the same period: it brings no sample, and none is missed; in motion it ends the validity."""
        self._send(SYNC, b"")
        self.doubled_syncs += 1
        self.is_withheld = True

    @rule(can_id=st.sampled_from([0x123, 0x182, 0x701, 0x77F]), data=st.binary(max_size=8))
    def others(self, can_id: int, data: bytes) -> None:
        self._send(can_id, data)

    @rule()
    def reset(self) -> None:
        self._reset()

    @rule(command=st.sampled_from([2, 128]), pause_s=st.floats(0.001, 100.0))
    def pause(self, command: int, pause_s: float) -> None:
        """NMT, at standstill: the position is valid again, and the same."""
        self._try([("good", 1)])
        self._stop()
        self._reset()
        self._send(0x000, bytes([command, NODE]), 0.0005)
        self._send(SYNC, b"", pause_s)
        self._send(ADC_PDO, struct.pack("<hh", *self._counts(self.position)))
        assert self.said == []
        self._send(0x000, bytes([1, NODE]), 0.001)
        self.said = []
        for _ in range(CONFIRMED):
            self._sync(*self._counts(self.position))
        said, self.said = self.said, []
        assert said[-1].status & Bit.VALID
        for one in said:
            assert not one.status & Bit.VALID or self._error(one) <= PHASE_ERROR

    @rule(speed=TURNING, pause_s=st.floats(0.1, 100.0), started=st.sampled_from([0.0, 0.5, 1.0]))
    def pause_in_motion(self, speed: float, pause_s: float, started: float) -> None:
        """Nobody knows how far it went until samples come again: the position is lost, and stays so."""
        self._reset()
        self.target = speed
        self._try([("good", 80)])
        self._send(0x000, bytes([128, NODE]), 0.0005)
        assert not self.module.dictionary.entry(*STATUS_WORD).current() & Bit.VALID
        self.position += self.speed * pause_s / 0.001
        self._send(0x000, bytes([1, NODE]), pause_s * started)
        self._send(SYNC, b"", pause_s * (1.0 - started))
        self.said = []
        for _ in range(CONFIRMED):
            self._step()
            self._sync(*self._counts(self.position))
        assert len(self.said) == CONFIRMED
        assert all(one.status & Bit.LOST and not one.status & Bit.VALID for one in self.said)
        self.is_beyond = True
        self._reset()

    @rule(periods=st.integers(1, 300), samples_only=st.booleans())
    def silence(self, periods: int, samples_only: bool) -> None:
        """Without SYNC, or with nothing but SYNC, no position is valid after the two periods of 2010:06."""
        self._reset()
        for _ in range(2 + periods):
            self._send(SYNC if samples_only else 0x123, b"", 0.0008)
            self._send(0x123, b"", 0.0002)
        status = self.module.dictionary.entry(*STATUS_WORD).current()
        assert not status & Bit.VALID
        assert status & Bit.LOST or periods < 4
        assert not any(one.status & Bit.VALID for one in self.said)
        self.is_beyond = True
        self._reset()

    def _error(self, one: Published) -> float:
        """Of a position, cycles; the code sequence is forward after a reset."""
        true = (self.position - self.count) * UNITS
        return abs((one.position - true + RANGE // 2) % RANGE - RANGE // 2) / UNITS

    @precondition(lambda self: hasattr(self, "module"))
    @invariant()
    def counters(self) -> None:
        assert self.said == []
        entry = self.module.dictionary.entry
        assert entry(*COUNTER_MISSED).current() == self.missed
        assert entry(*COUNTER_BAD_FRAMES).current() == self.bad_frames
        assert entry(*COUNTER_DOUBLED_SYNCS).current() == self.doubled_syncs
        status = entry(*STATUS_WORD).current()
        assert status == self.last.status or (self.is_withheld and not status & Bit.VALID)
        assert {sub: entry(0x2012, sub).current() for sub in COUNTERS} == {
            sub: self.flagged[sub] for sub in COUNTERS
        }


TestModule = ModuleMachine.TestCase
TestModule.settings = settings(max_examples=min(60, settings().max_examples), stateful_step_count=15)
