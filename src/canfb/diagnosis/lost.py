"""Why a position is lost (2012:10..16), how to restore it, how to avoid the loss; a status word (2011:01) in
words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from canfb import objects as od
from canfb.errors import saying
from canfb.master.access import CommissioningError, NodeAccess, ObjectAbsentError
from canfb.objects import LossCause, StatusBit, fault_words, position_state
from canfb.rows import Result, Row, age_words, as_figures, as_lines, those
from canfb.signal.limits import MOST_IN_A_ROW, cycles_per_interval_squared, kept_samples, max_acceleration
from canfb.view.module_view import LIMIT_UNITS, LimitSettings, limit_settings, mapped_objects

MEANINGS = {
    StatusBit.VALID: "position valid",
    StatusBit.COASTING: "coasting: bad or missed samples are bridged",
    StatusBit.LOST: "position lost: 'canfb why NODE' says why",
    StatusBit.RESIDUAL: "residual over its limit",
    StatusBit.AMPLITUDE: "amplitude outside of its limits",
    StatusBit.CLIPPED: "clipped: a track reaches the end of the ADC",
    StatusBit.MISSED: "sample missed",
    StatusBit.TABLE_ACTIVE: "correction table active",
    StatusBit.REFERENCED: "referenced to the zero pulse",
    StatusBit.COARSE: "coarse track disagrees",
    StatusBit.CALIBRATING: "calibrating",
    StatusBit.FROZEN: "frozen input: equal samples in motion",
    StatusBit.EXTRAPOLATED: "position extrapolated to its SYNC (2013h)",
    StatusBit.SECOND_POSITION: "the other sensor disagrees",
}
# Of these, a status word of one sample has at most one.
APART = (StatusBit.VALID, StatusBit.COASTING, StatusBit.LOST)


def decoded(word: int) -> Result:
    unknown, apart = word & ~sum(MEANINGS), sum(bool(word & bit) for bit in APART)
    both = "bits 0, 1 and 2 exclude each other: words of two samples, or another object (6041h?)"
    rows = [
        Row(
            f"status {word:04X}h",
            f"position {position_state(word)}",
            status=word,
            position=str(position_state(word)),
            faults=fault_words(word),
        ),
        *(
            Row(f"bit {bit.bit_length() - 1} ({bit:04X}h)", text)
            for bit, text in MEANINGS.items()
            if word & bit
        ),
        Row(f"{unknown:04X}h", "bits without a meaning: is this 2011:01?" if unknown else None),
        Row("note", both if apart > 1 else None),
    ]
    return Result(as_figures(rows), as_lines(rows))


RATE_S = 2.0  # time over which the sample rate is measured, for 1 Hz or more
BAD_SIGNAL = StatusBit.AMPLITUDE | StatusBit.CLIPPED
BAD_SIGNAL_ADVICE = "a signal within 2001:03 to 2001:04: watch it with canfb monitor, check the wiring"
MOTION = (LossCause.CONTRADICTED, LossCause.JUMP, LossCause.UNDECIDED)
NOT_DECLARED = (
    "2010:02 is 0, not declared: set it to the largest acceleration of the machine, rad/s², "
    "so that only motions that it can do are considered"
)
# What would have avoided the loss: causes; True: with sample times, False: without, None: both; advice.
ADVICE: tuple[tuple[tuple[LossCause, ...], bool | None, str], ...] = (
    (
        (LossCause.TIME,),
        True,
        "a clock of the encoder interface that is not restarted while the module runs",
    ),
    ((LossCause.TIME,), False, "sample times from the encoder interface: map 2000:05 (times: true)"),
    ((LossCause.TIME,), None, "one even SYNC, its counter (1019h), and a bus driver with receive times"),
    (
        (LossCause.PAUSE,),
        None,
        "standstill from before NMT stop, preop or another RPDO mapping until samples come again",
    ),
    (
        (LossCause.START,),
        None,
        "a start at standstill; or a coarse track, which finds the speed of a turning machine",
    ),
    (
        (LossCause.REFERENCE,),
        None,
        "wiring and scale of coarse track and zero pulse: one contradicted the count (2010:05)",
    ),
)
SAME = 0.9  # ratio of limits, then / now, above which they count as equal: noise narrows them (2010:09)


@dataclass(frozen=True)
class Loss:
    """2012:10..16 in SI units and cycles."""

    cause: LossCause
    since_s: float
    bad_samples: int
    residual_cycles: float
    limit_cycles: float
    speed_cycles: float | None  # None: unknown modulo one cycle per interval, as standstill was assumed
    faults: int


@dataclass(frozen=True)
class LostPosition:
    """The position of a module and its last loss.

    losses, missed, missed_syncs  2012:05, :01 and :0E
    sample_hz               present sample rate; 0.0: no samples
    coarse, zero_pulse, second   whether mapped in its RPDOs
    """

    node_id: int
    status: int
    loss: Loss | None
    losses: int
    missed: int
    missed_syncs: int
    sample_hz: float
    limits: LimitSettings
    coarse: bool
    zero_pulse: bool
    second: bool

    def figures(self) -> dict[str, Any]:
        loss = self.loss
        return {
            "node": self.node_id,
            "position": str(od.position_state(self.status)),
            "status": self.status,
            "faults": od.fault_words(self.status),
            "sample_hz": self.sample_hz,
            "last_loss": None
            if loss is None
            else {
                "cause": loss.cause.name.lower(),
                "text": loss.cause.text,
                "since_s": loss.since_s,
                "bad_samples": loss.bad_samples,
                "residual_cycles": loss.residual_cycles,
                "residual_limit_cycles": loss.limit_cycles,
                "speed_cycles_per_interval": loss.speed_cycles,
                "faults": od.fault_words(loss.faults),
            },
            "counters": {"losses": self.losses, "missed": self.missed, "syncs_not_heard": self.missed_syncs},
            "limits": {
                "acceleration_rad_s2": self.limits.acceleration_rad_s2,
                "coast_samples": self.limits.coast_samples,
                "residual_limit_cycles": self.limits.widest_cycles,
            },
            "mapped": {
                "coarse_track": self.coarse,
                "zero_pulse": self.zero_pulse,
                "second_position": self.second,
                "sample_time": self.limits.timed,
            },
            "brings_back": self.brings_back(),
            "would_have_kept": self.would_have_kept(),
        }

    def result(self) -> Result:
        return Result(self.figures(), self.lines())

    def lines(self) -> list[str]:
        now = those(
            (
                not self.sample_hz,
                "no samples are processed now: is it OPERATIONAL (canfb node start "
                f"{self.node_id:#04x}), does SYNC come, does the encoder interface send?",
            ),
            (self.sample_hz and self.status & BAD_SIGNAL, BAD_SIGNAL_ADVICE),
        )
        position = f"module {self.node_id} ({self.node_id:02X}h): position {od.position_state(self.status)}"
        lines = [", ".join([position, *od.fault_words(self.status)]), *(f"  {text}" for text in now)]
        for head, texts in (
            ("last loss", self.happened()),
            ("what brings it back", self.brings_back()),
            ("what would have kept it", self.would_have_kept()),
        ):
            lines += [head, *(f"  {text}" for text in texts)] if texts else []
        return lines

    def happened(self) -> list[str]:
        """Cause and conditions of the last loss."""
        loss, losses = self.loss, f"{self.losses} {'loss' if self.losses == 1 else 'losses'}"
        if loss is None:
            unknown = f"not known: this module does not keep the cause; {losses} so far"
            return [unknown if self.losses else "none since the start"]
        faults = ", ".join(od.fault_words(loss.faults))
        compared = (
            "nothing to compare" if loss.residual_cycles >= 0.5 else f"{loss.residual_cycles:.3g} cycle"
        )
        return [
            f"{age_words(loss.since_s)} ago: {loss.cause.text}",
            *those(
                (
                    loss.bad_samples,
                    f"{loss.bad_samples} samples in a row missed or bad{f' ({faults})' if faults else ''}; "
                    f"2010:03 bridges {self.limits.bounds(0.0).coasting}",
                ),
                (faults and not loss.bad_samples, f"faults since the last valid position: {faults}"),
            ),
            f"residual then: {compared}; limit {loss.limit_cycles:.3g} cycle",
            f"speed then: {self._speed_words(loss.speed_cycles)}",
            f"since the start: {losses}, {self.missed} missed samples, {self.missed_syncs} SYNCs not heard",
        ]

    def _speed_words(self, cycles: float | None) -> str:
        if cycles is None:
            return "not known, standstill was assumed"
        if not self.sample_hz:
            return f"{cycles:.3g} cycles per interval"
        rpm = cycles * self.sample_hz / self.limits.cycles_per_revolution * 60.0
        return f"{cycles:.3g} cycles per interval, {rpm:.3g} rpm"

    def brings_back(self) -> list[str]:
        if not self.status & StatusBit.LOST:  # not lost: a reset would not help
            return []
        return [
            f"stand still, then canfb node reset {self.node_id:#04x}: the count begins at 0; reference the "
            "machine again",
            "coarse track: finds the speed, in motion too; the count if 2010:05 is below half a cycle"
            if self.coarse
            else "coarse track: not mapped (2000:03 and 2000:04 in an RPDO)",
            "zero pulse: two that agree correct the count, once coarse track or two pulses give the speed"
            if self.zero_pulse
            else "zero pulse: not mapped (2000:06 in an RPDO)",
            "second position: finds the count alone if exactly one is within its tolerance"
            if self.second
            else "second position: not in use (2000:0E in an RPDO, and a tolerance in 2014:04)",
        ]

    def would_have_kept(self) -> list[str]:
        loss, in_force = self.loss, self.limits
        if loss is None:
            return []
        cause, missed, residual = loss.cause, loss.faults & StatusBit.MISSED, loss.faults & StatusBit.RESIDUAL
        gentler = cause in MOTION and self.sample_hz > 0.0 and not in_force.acceleration_rad_s2
        largest = (
            max_acceleration(in_force.cycles_per_revolution, self.sample_hz, in_force.widest_cycles)
            if gentler
            else 0.0
        )
        doubtful = cause is LossCause.AMBIGUOUS or (cause is LossCause.COASTED and missed)
        return those(
            (cause is LossCause.COASTED, self._longer(loss)),
            (doubtful, self._declared()),
            (
                doubtful and missed,
                "fewer missed samples: docs/service.md, and the priority of SYNC and ADC PDO on the bus",
            ),
            (loss.faults & BAD_SIGNAL, BAD_SIGNAL_ADVICE),
            *(self._narrow(loss) if cause in MOTION or (residual and cause is not LossCause.PAUSE) else ()),
            (
                gentler,
                f"the motion must stay below {largest:.4g} rad/s² at {self.sample_hz:.4g} Hz and 2010:01: "
                "a faster SYNC, or a gentler motion",
            ),
            (
                cause in MOTION,
                "a correction table of this encoder: check the active one by canfb calibrate --check"
                if self.status & StatusBit.TABLE_ACTIVE
                else "a correction table, which removes phase errors: canfb calibrate",
            ),
            *((cause in causes and timed in (None, in_force.timed), text) for causes, timed, text in ADVICE),
        )

    def _longer(self, loss: Loss) -> str:
        bridged = self.limits.bounds(0.0).coasting
        time = f", {bridged / self.sample_hz * 1e3:.3g} ms" if self.sample_hz else ""
        text = f"2010:03 bridges {bridged} samples{time}"
        if self.limits.coast_samples >= MOST_IN_A_ROW:
            return f"{text}, its largest value"
        most = self.longest_gap() if loss.faults & StatusBit.MISSED else None
        if most is not None and most <= bridged:
            return f"{text}; more would not help at this acceleration (2010:02) and SYNC rate"
        return f"{text}: a larger value bridges a longer fault"

    def _declared(self) -> str:
        most, largest = self.longest_gap(), self.limits.acceleration_rad_s2
        said = "" if most is None else f", which bridges at most {most} missed samples"
        known = f"2010:02 is {largest:.4g} rad/s²{said}; a smaller one, if true, "
        return f"{known}or a faster SYNC bridges more" if largest else NOT_DECLARED

    def longest_gap(self) -> int | None:
        """Missed samples after which 2010:02 leaves one possible motion; None: unknown."""
        if not (self.limits.acceleration_rad_s2 and self.sample_hz):
            return None
        n, interval_s = self.limits.cycles_per_revolution, 1.0 / self.sample_hz
        largest = cycles_per_interval_squared(self.limits.acceleration_rad_s2, n, interval_s)
        return kept_samples(largest, largest, phase_error_cycles=0.0)

    def _narrow(self, loss: Loss) -> list[tuple[bool, str]]:
        sync_hz = self.sample_hz / self.limits.samples_per_sync
        now_cycles, needed = self.limits.limit_cycles(sync_hz), self.limits.needed_cycles(sync_hz)
        then, now = f"{loss.limit_cycles:.3g} cycle", f"{now_cycles:.3g} cycle"
        reasons = (
            (
                loss.limit_cycles < SAME * now_cycles,
                f"the residual limit was {then} and is {now} now: 2010:01 was written since "
                "(or 2010:02, 2010:0C, which narrow it); the limit at that time lost the position",
            ),
            (
                self.limits.widest_cycles < needed,
                f"2010:01 is {self.limits.widest_cycles:.3g} cycle, and the declared acceleration (2010:02) "
                f"and phase error (2010:0C) need {needed:.3g}",
            ),
            (
                loss.limit_cycles < self.limits.widest_cycles,
                f"2010:02 is {self.limits.acceleration_rad_s2:.4g} rad/s², which narrows the residual limit "
                f"to {then}: is it the largest acceleration, also in a jolt? See canfb commission",
            ),
        )
        return [one for one in reasons if one[0]][:1]


def read_lost_position(module: NodeAccess) -> LostPosition:
    """Read by SDO, within two seconds. CommissioningError."""
    master = module.master
    missed = int(module.read_known(od.COUNTER_MISSED) or 0)
    with saying(CommissioningError, "not a feedback module, give the NODE of one", ObjectAbsentError):
        began, first = master.now(), module.integer(*od.FEEDBACK_SAMPLES, "I")
    mapped = mapped_objects(module.read_known)
    tolerance = module.read_known(od.SECOND_TOLERANCE) or 0.0
    master.wait(max(0.0, began + RATE_S - master.now()))
    samples = module.integer(*od.FEEDBACK_SAMPLES, "I") - first & 0xFFFFFFFF
    passed_s = master.now() - began
    missed_now = int(module.read_known(od.COUNTER_MISSED) or 0)
    return LostPosition(
        module.node_id,
        module.integer(*od.FEEDBACK_STATUS, "H"),
        _read_loss(module),
        losses=int(module.read_known(od.COUNTER_LOST) or 0),
        missed=missed_now,
        missed_syncs=int(module.read_known(od.COUNTER_SYNCS_NOT_HEARD) or 0),
        sample_hz=samples / passed_s if samples > missed_now - missed else 0.0,
        coarse=od.SAMPLE_COARSE_SINE.mapped(16) in mapped and od.SAMPLE_COARSE_COSINE.mapped(16) in mapped,
        zero_pulse=od.SAMPLE_FLAGS.mapped(8) in mapped,
        second=od.SAMPLE_SECOND_POSITION.mapped(32) in mapped and tolerance > 0.0,
        limits=limit_settings(module.read_known),
    )


def _read_loss(module: NodeAccess) -> Loss | None:
    cause = od.loss_cause(module.read_known(od.COUNTER_LOSS_CAUSE))
    if cause is None:
        return None
    since_ms, bad, residual, limit, speed, faults = (
        module.integer(*place, "I")
        for place in (
            od.COUNTER_LOSS_AGE,
            od.COUNTER_LOSS_BAD,
            od.COUNTER_LOSS_RESIDUAL,
            od.COUNTER_LOSS_LIMIT,
            od.COUNTER_LOSS_SPEED,
            od.COUNTER_LOSS_FAULTS,
        )
    )
    return Loss(
        cause,
        since_ms / 1e3,
        bad,
        residual / LIMIT_UNITS,
        limit / LIMIT_UNITS,
        None if cause in (LossCause.PAUSE, LossCause.START) else speed / LIMIT_UNITS,
        faults,
    )
