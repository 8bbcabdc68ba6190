"""Objects of the nodes by name, and the enumerations that they hold.

The manufacturer part, and of CiA 301 and CiA 406 what more than one part of the package uses. A name is made
of words of the EDS; those of the encoder interface begin with INTERFACE.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum, IntFlag, StrEnum
from typing import Final, NamedTuple

from canfb.cia301.cob import TPDOS
from canfb.cia301.codes import CodeWithText
from canfb.cia301.frame import mapping_values


class Multiplexer(NamedTuple):
    """Index and sub-index of an object (CiA 301, 7.2.4.3)."""

    object_index: int
    subindex: int = 0

    def mapped(self, bits: int) -> int:
        """The mapping entry of a PDO for this object, ``bits`` long (CiA 301, 7.5.2.36)."""
        return self.object_index << 16 | self.subindex << 8 | bits


def record(index: int, count: int, first: int = 1) -> tuple[Multiplexer, ...]:
    """Sub-indices of a record, in the order of the EDS."""
    return tuple(Multiplexer(index, subindex) for subindex in range(first, first + count))


def place_text(place: tuple[int, int]) -> str:
    """2010:01."""
    return f"{place[0]:04X}:{place[1]:02X}"


# Communication profile, CiA 301.
DEVICE_TYPE: Final = Multiplexer(0x1000)
SYNC_COB_ID: Final = Multiplexer(0x1005)
CYCLE_PERIOD: Final = Multiplexer(0x1006)
SYNCHRONOUS_COUNTER_OVERFLOW: Final = Multiplexer(0x1019)
EMCY_COB_ID: Final = Multiplexer(0x1014)
IDENTITY = (
    IDENTITY_VENDOR_ID,
    IDENTITY_PRODUCT_CODE,
    IDENTITY_REVISION_NUMBER,
    IDENTITY_SERIAL_NUMBER,
) = record(0x1018, 4)
STORE_ALL_PARAMETERS: Final = Multiplexer(0x1010, 1)
STORE_MANUFACTURER_PARAMETERS: Final = Multiplexer(0x1010, 4)

RPDO: Final = 0x1400  # Index of the communication parameters of RPDO1; the other RPDOs follow.
RPDO_MAPPING: Final = 0x1600
TPDO: Final = 0x1800
TPDO_MAPPING: Final = 0x1A00

# 2000h: a sample as the RPDOs bring it to the module.
(
    SAMPLE_SINE,
    SAMPLE_COSINE,
    SAMPLE_COARSE_SINE,
    SAMPLE_COARSE_COSINE,
    SAMPLE_TIME,
    SAMPLE_FLAGS,
    SAMPLE_ZERO_PULSE_PLACE,
) = record(0x2000, 7)
# Sine and cosine of earlier pairs in the same interval of SYNC, the newest first.
SAMPLE_EARLIER: Final = tuple(
    (Multiplexer(0x2000, first), Multiplexer(0x2000, first + 1)) for first in (8, 10, 12, 15, 17, 19, 21)
)
SAMPLE_SECOND_POSITION: Final = Multiplexer(0x2000, 14)


def sample_pdos(
    parameters: int,
    mapping: int,
    pairs: Sequence[tuple[Multiplexer, Multiplexer]],
    times: Sequence[Multiplexer],
    node_id: int,
) -> dict[tuple[int, int], int]:
    """PDOs of ``node_id``; ``parameters``, ``mapping``: indices of the first."""
    tracks = [one.mapped(16) for pair in pairs for one in pair]
    mapped = mapping_values(mapping, [*tracks, *(one.mapped(32) for one in times)])
    return mapped | {
        (parameters + index - mapping, 1): TPDOS[index - mapping] + node_id for index, _ in mapped
    }


# 6401h and 2000h of the encoder interface: the same, as its TPDOs send it.
(
    INTERFACE_SINE,
    INTERFACE_COSINE,
    INTERFACE_COARSE_SINE,
    INTERFACE_COARSE_COSINE,
) = record(0x6401, 4)
INTERFACE_EARLIER: Final = tuple(
    (Multiplexer(0x6401, 5 + 2 * j), Multiplexer(0x6401, 6 + 2 * j)) for j in range(7)
)
(
    INTERFACE_SAMPLE_TIME,
    INTERFACE_FLAGS,
    INTERFACE_ZERO_PULSE_PLACE,
) = record(0x2000, 3)


INTERFACE_MACHINE: Final = Multiplexer(0x2060)


class MachineCommand(IntEnum):
    """2060h of a simulated encoder interface."""

    STOP = 0
    START = 1


class SampleFlag(IntFlag):
    """Bits of 2000:06 of the module and 2000:02 of the encoder interface."""

    ZERO_PULSE = 1 << 0
    INVALID = 1 << 1


(
    ENCODER_CYCLES_PER_REVOLUTION,
    ENCODER_FULL_SCALE,
    ENCODER_LOWEST_AMPLITUDE,
    ENCODER_HIGHEST_AMPLITUDE,
    ENCODER_CORNER_FREQUENCY,
    ENCODER_COSINE_CORNER_FREQUENCY,
) = record(0x2001, 6)

# 2002:01..07 and 2005:01..0E, in the order of the fields of :class:`canfb.Conditioning`.
CONDITIONING: Final = record(0x2002, 7) + record(0x2005, 14)

(
    ADAPTATION,
    ADAPTATION_OFFSET_LIMIT,
    ADAPTATION_GAIN_LIMIT,
    ADAPTATION_PHASE_LIMIT,
    ADAPTATION_RATE_LIMIT,
    ADAPTATION_STATE,
    ADAPTATION_USED,
) = record(0x2002, 7, 8)
# 2002:0F..12, in the order of the fields of :class:`canfb.signal.adaptation.FollowedDrift`.
DRIFT: Final = record(0x2002, 4, 15)


class AdaptationState(IntEnum):
    """2002:0D."""

    OFF = 0
    WAITING = 1
    FOLLOWING = 2
    AT_LIMIT = 3


(
    SCALE_SPEED_MULTIPLIER,
    SCALE_SPEED_DIVISOR,
    SCALE_ACCELERATION_MULTIPLIER,
    SCALE_ACCELERATION_DIVISOR,
) = record(0x2003, 4)

(
    WARNINGS_BY_EMCY,
    WARNING_OVER_TIME,
) = record(0x2004, 2)

(
    SUPERVISION_RESIDUAL_LIMIT,
    SUPERVISION_ACCELERATION,
    SUPERVISION_COAST,
    SUPERVISION_FROZEN,
    SUPERVISION_COARSE_LIMIT,
    SUPERVISION_PERIODS,
    SUPERVISION_ORDER,
    SUPERVISION_JERK,
    SUPERVISION_NOISE_MARGIN,
    SUPERVISION_BAD_SAMPLES,
    SUPERVISION_DOUBT_ACCELERATION,
    SUPERVISION_PHASE_ERROR,
    SUPERVISION_SYNC_JITTER,
    SUPERVISION_ANSWER_DELAY,
) = record(0x2010, 14)

(
    FEEDBACK_STATUS,
    FEEDBACK_RESIDUAL,
    FEEDBACK_PHASE,
    FEEDBACK_CYCLE_COUNT,
    FEEDBACK_AMPLITUDE,
    FEEDBACK_RAW_PHASE,
    FEEDBACK_VELOCITY,
    FEEDBACK_SAMPLES,
    FEEDBACK_ACCELERATION,
    FEEDBACK_JUMP,
    FEEDBACK_NOISE,
) = record(0x2011, 11)


class StatusBit(IntFlag):
    """Bits of the status word, object 2011:01."""

    VALID = 1 << 0
    COASTING = 1 << 1
    LOST = 1 << 2
    RESIDUAL = 1 << 3
    AMPLITUDE = 1 << 4
    CLIPPED = 1 << 5
    MISSED = 1 << 6
    TABLE_ACTIVE = 1 << 7
    REFERENCED = 1 << 8
    COARSE = 1 << 9
    CALIBRATING = 1 << 10
    FROZEN = 1 << 11
    EXTRAPOLATED = 1 << 12
    SECOND_POSITION = 1 << 13


# Bits of the status word for what is wrong, in words. All but the last take the valid bit.
FAULT_WORDS: Final[dict[int, str]] = {
    StatusBit.MISSED.value: "sample missed",
    StatusBit.RESIDUAL.value: "residual over its limit",
    StatusBit.AMPLITUDE.value: "amplitude outside of its limits",
    StatusBit.CLIPPED.value: "clipped",
    StatusBit.FROZEN.value: "frozen input",
    StatusBit.COARSE.value: "coarse track disagrees",
    StatusBit.SECOND_POSITION.value: "second position disagrees",
}


def fault_words(status: int) -> list[str]:
    return [words for bit, words in FAULT_WORDS.items() if status & bit]


class PositionState(StrEnum):
    """What the status word says of the position."""

    VALID = "valid"
    COASTING = "coasting"
    LOST = "lost"
    NOT_VALID = "not valid"


def position_state(status: int) -> PositionState:
    if status & StatusBit.VALID:
        return PositionState.VALID
    if status & StatusBit.LOST:
        return PositionState.LOST
    return PositionState.COASTING if status & StatusBit.COASTING else PositionState.NOT_VALID


class LossCause(CodeWithText):
    """Why the position was lost, object 2012:10."""

    NONE = 0, "not lost since the start"
    COASTED = 1, "more samples in a row were bad or missing than 2010:03 allows"
    AMBIGUOUS = 2, "several motions within the declared limits fit the samples"
    CONTRADICTED = 3, "no motion within the declared limits fits the samples"
    JUMP = 4, "the samples jumped from one motion to another"
    UNDECIDED = 5, "the samples did not decide between several motions in time"
    TIME = 6, "the number of intervals that passed is not known"
    PAUSE = 7, "the machine moved during a pause"
    START = 8, "the samples contradict the speed assumed at the start"
    REFERENCE = 9, "coarse track or zero pulse contradicts the cycle count"


def loss_cause(number: float | None) -> LossCause | None:
    """The cause of this number, as 2012:10 or an EMCY 7300h has it; None for NONE and for unknown numbers."""
    return next((one for one in LossCause if one and one == number), None)


class EncoderEmergency(CodeWithText):
    """Emergency error codes of the warnings 6505h, FF10h plus the number of the bit, and their meaning."""

    FREQUENCY = 0xFF10, "residual near its limit"
    AMPLITUDE_LOW = 0xFF11, "low amplitude"
    NOT_REFERENCED = 0xFF15, "zero pulse not yet confirmed"
    SECOND_POSITION = 0xFF1C, "second position disagrees"
    DRIFT = 0xFF1D, "drift of the tracks at its limit"


# What the emergency error codes of the module mean, beyond those of CiA 301.
EMERGENCY_TEXTS: Final = {int(code): code.text for code in EncoderEmergency}


(
    COUNTER_MISSED,
    COUNTER_RESIDUAL,
    COUNTER_AMPLITUDE,
    COUNTER_COASTED,
    COUNTER_LOST,
    COUNTER_RECOVERED,
    COUNTER_ZERO_PULSES,
    COUNTER_BAD_FRAMES,
    COUNTER_CLIPPED,
    COUNTER_FROZEN,
    COUNTER_COARSE_DISAGREEMENTS,
    COUNTER_SET_RIGHT,
    COUNTER_DUPLICATE_SYNCS,
    COUNTER_SYNCS_NOT_HEARD,
    COUNTER_SECOND_DISAGREEMENTS,
    COUNTER_LOSS_CAUSE,
    COUNTER_LOSS_AGE,
    COUNTER_LOSS_BAD,
    COUNTER_LOSS_RESIDUAL,
    COUNTER_LOSS_LIMIT,
    COUNTER_LOSS_SPEED,
    COUNTER_LOSS_FAULTS,
) = record(0x2012, 22)

# What 2012h counts, by name.
COUNTERS: Final[dict[Multiplexer, str]] = {
    COUNTER_MISSED: "missed",
    COUNTER_RESIDUAL: "residual",
    COUNTER_AMPLITUDE: "amplitude",
    COUNTER_COASTED: "coasted",
    COUNTER_LOST: "lost",
    COUNTER_RECOVERED: "recovered",
    COUNTER_ZERO_PULSES: "zero pulses",
    COUNTER_BAD_FRAMES: "bad frames",
    COUNTER_CLIPPED: "clipped",
    COUNTER_FROZEN: "frozen",
    COUNTER_COARSE_DISAGREEMENTS: "coarse disagreements",
    COUNTER_SET_RIGHT: "set right",
    COUNTER_DUPLICATE_SYNCS: "duplicate SYNCs",
    COUNTER_SYNCS_NOT_HEARD: "SYNCs not heard",
    COUNTER_SECOND_DISAGREEMENTS: "second position disagreements",
}

# Those that count samples with a bit of the status word; clipping is an amplitude fault, too.
COUNTED: Final[dict[Multiplexer, int]] = {
    COUNTER_MISSED: StatusBit.MISSED.value,
    COUNTER_RESIDUAL: StatusBit.RESIDUAL.value,
    COUNTER_AMPLITUDE: StatusBit.AMPLITUDE.value | StatusBit.CLIPPED.value,
    COUNTER_COASTED: StatusBit.COASTING.value,
    COUNTER_CLIPPED: StatusBit.CLIPPED.value,
    COUNTER_FROZEN: StatusBit.FROZEN.value,
    COUNTER_COARSE_DISAGREEMENTS: StatusBit.COARSE.value,
    COUNTER_SECOND_DISAGREEMENTS: StatusBit.SECOND_POSITION.value,
}

(
    PREDICTION_POSITION,
    PREDICTION_NOMINAL_SYNC,
) = record(0x2013, 2)

(
    SECOND_INCREMENTS,
    SECOND_REVOLUTIONS,
    SECOND_REVERSED,
    SECOND_TOLERANCE,
    SECOND_INVALIDATES,
    SECOND_DIFFERENCE,
) = record(0x2014, 6)

# The values of :data:`CONDITIONING` in force, REAL32 each; 2002h and 2005h: those of the next activation.
(
    TABLE_STAGED,
    TABLE_STAGED_CRC,
    TABLE_ACTIVATE,
    TABLE_ACTIVE_CRC,
    TABLE_ACTIVE_ENTRIES,
    TABLE_SAVED_CRC,
    TABLE_ACTIVE_CONDITIONING,
) = record(0x2020, 7)

(
    MEASUREMENT_COMMAND,
    MEASUREMENT_STATE,
    MEASUREMENT_PROGRESS,
    MEASUREMENT_COVERAGE,
    MEASUREMENT_RESIDUAL_RMS,
    MEASUREMENT_RESIDUAL_PEAK,
    MEASUREMENT_REASON,
    MEASUREMENT_DRIFT_RMS,
    MEASUREMENT_DRIFT_PEAK,
    MEASUREMENT_SAMPLES,
) = record(0x2030, 10)


(
    WRITE_LOCK_MODE,
    WRITE_LOCK_UNLOCK_CODE,
    WRITE_LOCK_NEW_UNLOCK_CODE,
    WRITE_LOCK_LOCKED,
) = record(0x2040, 4)


class WriteLockMode(IntEnum):
    """2040:01."""

    OFF = 0
    PREOP = 1
    CODE = 2


class MeasurementCommand(IntEnum):
    """2030:01."""

    START = 1
    STOP = 2
    ACCEPT = 3
    CHECK = 4
    FINISH = 5


class MeasurementState(IntEnum):
    """2030:02."""

    IDLE = 0
    RECORDING = 1
    COMPUTING = 2
    READY = 3
    REFUSED = 4
    ACCEPTED = 5
    CHECKED = 6


# 2050h, of the module and of the encoder interface.
(
    RECORDING_COMMAND,
    RECORDING_RECORDED,
    RECORDING_SAMPLES,
    RECORDING_RATE,
    RECORDING_CAPACITY,
) = record(0x2050, 5)

# Sine and cosine in 2050:03 where a sample is missing. As a sample it would be clipped on both tracks, and
# so nothing that could be used is mistaken for it.
MISSED_COUNTS: Final = -32768


class RecordingCommand(IntEnum):
    """2050:01; it reads 1 while samples are taken, else 0."""

    START = 1
    STOP = 2


class OperatingParameter(IntFlag):
    """6000h."""

    CODE_SEQUENCE = 1 << 0  # the position falls when the machine turns clockwise
    SCALING = 1 << 2  # 6001h and 6002h are used


# Encoder profile, CiA 406.
(
    OPERATING_PARAMETERS,
    UNITS_PER_REVOLUTION,
    TOTAL_RANGE,
    PRESET_VALUE,
    POSITION_VALUE,
) = map(Multiplexer, range(0x6000, 0x6005))
HIGH_PRECISION_POSITION: Final = Multiplexer(0x6008)
HIGH_PRECISION_PRESET: Final = Multiplexer(0x6009)
SINGLE_TURN_RESOLUTION: Final = Multiplexer(0x6501)
DISTINGUISHABLE_REVOLUTIONS: Final = Multiplexer(0x6502)
OFFSET_VALUE: Final = Multiplexer(0x6509)
SERIAL_NUMBER: Final = Multiplexer(0x650B)
