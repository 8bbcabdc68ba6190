"""Objects of the nodes by name, and the enumerations that they hold.

The manufacturer part, and of CiA 301 and CiA 406 what more than one part of the package uses. A name is made
of words of the EDS; those of the encoder interface begin with INTERFACE.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Sequence
from enum import IntEnum, IntFlag, StrEnum
from typing import Final, NamedTuple

from canfb.cia301.codes import CodeWithText


class Multiplexer(NamedTuple):
    """Index and sub-index of an object (CiA 301, 7.2.4.3)."""

    object_index: int
    subindex: int = 0

    def mapped(self, bits: int) -> int:
        """The mapping entry of a PDO for this object, ``bits`` long (CiA 301, 7.5.2.36)."""
        return self.object_index << 16 | self.subindex << 8 | bits


def place_text(place: tuple[int, int]) -> str:
    """2010:01."""
    return f"{place[0]:04X}:{place[1]:02X}"


# Communication profile, CiA 301.
DEVICE_TYPE: Final = Multiplexer(0x1000)
SYNC_COB_ID: Final = Multiplexer(0x1005)
CYCLE_PERIOD: Final = Multiplexer(0x1006)
EMCY_COB_ID: Final = Multiplexer(0x1014)
IDENTITY_VENDOR_ID: Final = Multiplexer(0x1018, 1)
IDENTITY_PRODUCT_CODE: Final = Multiplexer(0x1018, 2)
IDENTITY_REVISION_NUMBER: Final = Multiplexer(0x1018, 3)
IDENTITY_SERIAL_NUMBER: Final = Multiplexer(0x1018, 4)
IDENTITY: Final = (
    IDENTITY_VENDOR_ID,
    IDENTITY_PRODUCT_CODE,
    IDENTITY_REVISION_NUMBER,
    IDENTITY_SERIAL_NUMBER,
)
STORE_ALL_PARAMETERS: Final = Multiplexer(0x1010, 1)
STORE_MANUFACTURER_PARAMETERS: Final = Multiplexer(0x1010, 4)

RPDO: Final = 0x1400
"""Index of the communication parameters of RPDO1; the other RPDOs follow."""
RPDO_MAPPING: Final = 0x1600
TPDO: Final = 0x1800
TPDO_MAPPING: Final = 0x1A00

# 2000h: a sample as the RPDOs bring it to the module.
SAMPLE_SINE: Final = Multiplexer(0x2000, 1)
SAMPLE_COSINE: Final = Multiplexer(0x2000, 2)
SAMPLE_COARSE_SINE: Final = Multiplexer(0x2000, 3)
SAMPLE_COARSE_COSINE: Final = Multiplexer(0x2000, 4)
SAMPLE_TIME: Final = Multiplexer(0x2000, 5)
SAMPLE_FLAGS: Final = Multiplexer(0x2000, 6)
SAMPLE_ZERO_PULSE_PLACE: Final = Multiplexer(0x2000, 7)
SAMPLE_EARLIER: Final = tuple(
    (Multiplexer(0x2000, first), Multiplexer(0x2000, first + 1)) for first in (8, 10, 12, 15, 17, 19, 21)
)
"""Sine and cosine of earlier pairs in the same interval of SYNC, the newest first."""
SAMPLE_SECOND_POSITION: Final = Multiplexer(0x2000, 14)


def samples_per_sync(mapped: Sequence[Collection[int]]) -> int:
    """Pairs of sine and cosine for each SYNC, 1..8, by the entries that each RPDO maps.

    They count up to the first that no RPDO brings, as the module counts them.
    """
    pairs = [{one.mapped(16) for one in pair} for pair in SAMPLE_EARLIER]
    found = itertools.takewhile(lambda pair: any(pair.issubset(one) for one in mapped), pairs)
    return 1 + sum(1 for _ in found)


# 6401h and 2000h of the encoder interface: the same, as its TPDOs send it.
INTERFACE_SINE: Final = Multiplexer(0x6401, 1)
INTERFACE_COSINE: Final = Multiplexer(0x6401, 2)
INTERFACE_COARSE_SINE: Final = Multiplexer(0x6401, 3)
INTERFACE_COARSE_COSINE: Final = Multiplexer(0x6401, 4)
INTERFACE_EARLIER: Final = tuple(
    (Multiplexer(0x6401, 5 + 2 * j), Multiplexer(0x6401, 6 + 2 * j)) for j in range(7)
)
INTERFACE_SAMPLE_TIME: Final = Multiplexer(0x2000, 1)
INTERFACE_FLAGS: Final = Multiplexer(0x2000, 2)
INTERFACE_ZERO_PULSE_PLACE: Final = Multiplexer(0x2000, 3)


INTERFACE_MACHINE: Final = Multiplexer(0x2060)


class MachineCommand(IntEnum):
    """What can be written to 2060h of a simulated encoder interface."""

    STOP = 0
    START = 1


class SampleFlag(IntFlag):
    """Bits of 2000:06 of the module and 2000:02 of the encoder interface."""

    ZERO_PULSE = 1 << 0
    INVALID = 1 << 1


ENCODER_CYCLES_PER_REVOLUTION: Final = Multiplexer(0x2001, 1)
ENCODER_FULL_SCALE: Final = Multiplexer(0x2001, 2)
ENCODER_LOWEST_AMPLITUDE: Final = Multiplexer(0x2001, 3)
ENCODER_HIGHEST_AMPLITUDE: Final = Multiplexer(0x2001, 4)
ENCODER_CORNER_FREQUENCY: Final = Multiplexer(0x2001, 5)
ENCODER_COSINE_CORNER_FREQUENCY: Final = Multiplexer(0x2001, 6)

CONDITIONING: Final = tuple(
    Multiplexer(index, subindex)
    for index, most in ((0x2002, 7), (0x2005, 14))
    for subindex in range(1, most + 1)
)
"""2002:01..07 and 2005:01..0E, in the order of the fields of :class:`canfb.Conditioning`."""

ADAPTATION: Final = Multiplexer(0x2002, 8)
ADAPTATION_OFFSET_LIMIT: Final = Multiplexer(0x2002, 9)
ADAPTATION_GAIN_LIMIT: Final = Multiplexer(0x2002, 10)
ADAPTATION_PHASE_LIMIT: Final = Multiplexer(0x2002, 11)
ADAPTATION_RATE_LIMIT: Final = Multiplexer(0x2002, 12)
ADAPTATION_STATE: Final = Multiplexer(0x2002, 13)
ADAPTATION_USED: Final = Multiplexer(0x2002, 14)
DRIFT: Final = tuple(Multiplexer(0x2002, subindex) for subindex in range(15, 19))
"""2002:0F..12, in the order of the fields of :class:`canfb.signal.adaptation.FollowedDrift`."""


class AdaptationState(IntEnum):
    """What 2002:0D says."""

    OFF = 0
    WAITING = 1
    FOLLOWING = 2
    AT_LIMIT = 3


SCALE_SPEED_MULTIPLIER: Final = Multiplexer(0x2003, 1)
SCALE_SPEED_DIVISOR: Final = Multiplexer(0x2003, 2)
SCALE_ACCELERATION_MULTIPLIER: Final = Multiplexer(0x2003, 3)
SCALE_ACCELERATION_DIVISOR: Final = Multiplexer(0x2003, 4)

WARNINGS_BY_EMCY: Final = Multiplexer(0x2004, 1)
WARNING_OVER_TIME: Final = Multiplexer(0x2004, 2)

SUPERVISION_RESIDUAL_LIMIT: Final = Multiplexer(0x2010, 1)
SUPERVISION_ACCELERATION: Final = Multiplexer(0x2010, 2)
SUPERVISION_COAST: Final = Multiplexer(0x2010, 3)
SUPERVISION_FROZEN: Final = Multiplexer(0x2010, 4)
SUPERVISION_COARSE_LIMIT: Final = Multiplexer(0x2010, 5)
SUPERVISION_PERIODS: Final = Multiplexer(0x2010, 6)
SUPERVISION_ORDER: Final = Multiplexer(0x2010, 7)
SUPERVISION_JERK: Final = Multiplexer(0x2010, 8)
SUPERVISION_NOISE_MARGIN: Final = Multiplexer(0x2010, 9)
SUPERVISION_BAD_SAMPLES: Final = Multiplexer(0x2010, 10)
SUPERVISION_DOUBT_ACCELERATION: Final = Multiplexer(0x2010, 11)
SUPERVISION_PHASE_ERROR: Final = Multiplexer(0x2010, 12)
SUPERVISION_SYNC_JITTER: Final = Multiplexer(0x2010, 13)

FEEDBACK_STATUS: Final = Multiplexer(0x2011, 1)
FEEDBACK_RESIDUAL: Final = Multiplexer(0x2011, 2)
FEEDBACK_PHASE: Final = Multiplexer(0x2011, 3)
FEEDBACK_CYCLE_COUNT: Final = Multiplexer(0x2011, 4)
FEEDBACK_AMPLITUDE: Final = Multiplexer(0x2011, 5)
FEEDBACK_RAW_PHASE: Final = Multiplexer(0x2011, 6)
FEEDBACK_VELOCITY: Final = Multiplexer(0x2011, 7)
FEEDBACK_SAMPLES: Final = Multiplexer(0x2011, 8)
FEEDBACK_ACCELERATION: Final = Multiplexer(0x2011, 9)
FEEDBACK_JUMP: Final = Multiplexer(0x2011, 10)
FEEDBACK_NOISE: Final = Multiplexer(0x2011, 11)


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


FAULT_WORDS: Final[dict[int, str]] = {
    StatusBit.MISSED.value: "sample missed",
    StatusBit.RESIDUAL.value: "residual over its limit",
    StatusBit.AMPLITUDE.value: "amplitude outside of its limits",
    StatusBit.CLIPPED.value: "clipped",
    StatusBit.FROZEN.value: "frozen input",
    StatusBit.COARSE.value: "coarse track disagrees",
    StatusBit.SECOND_POSITION.value: "second position disagrees",
}
"""Bits of the status word for what is wrong, in words. All but the last take the valid bit."""


def fault_words(status: int) -> list[str]:
    """What is wrong by the status word 2011:01."""
    return [words for bit, words in FAULT_WORDS.items() if status & bit]


class PositionState(StrEnum):
    """What the status word says of the position."""

    VALID = "valid"
    COASTING = "coasting"
    LOST = "lost"
    NOT_VALID = "not valid"


def position_state(status: int) -> PositionState:
    """The position by the bits of the status word 2011:01."""
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
    JUMP = 4, "the samples changed from one motion to another at once"
    UNDECIDED = 5, "the samples did not decide between several motions in time"
    TIME = 6, "the number of intervals that passed is not known"
    PAUSE = 7, "the machine moved during a pause"
    START = 8, "the samples contradict the speed assumed at the start"
    REFERENCE = 9, "coarse track or zero pulse contradicts the cycle count"
    CONFIGURATION = 10, "the configuration changed while the position was in doubt"


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


EMERGENCY_TEXTS: Final = {int(code): code.text for code in EncoderEmergency}
"""What the emergency error codes of the module mean, beyond those of CiA 301."""


COUNTER_MISSED: Final = Multiplexer(0x2012, 1)
COUNTER_RESIDUAL: Final = Multiplexer(0x2012, 2)
COUNTER_AMPLITUDE: Final = Multiplexer(0x2012, 3)
COUNTER_COASTED: Final = Multiplexer(0x2012, 4)
COUNTER_LOST: Final = Multiplexer(0x2012, 5)
COUNTER_RECOVERED: Final = Multiplexer(0x2012, 6)
COUNTER_ZERO_PULSES: Final = Multiplexer(0x2012, 7)
COUNTER_BAD_FRAMES: Final = Multiplexer(0x2012, 8)
COUNTER_CLIPPED: Final = Multiplexer(0x2012, 9)
COUNTER_FROZEN: Final = Multiplexer(0x2012, 10)
COUNTER_COARSE_DISAGREEMENTS: Final = Multiplexer(0x2012, 11)
COUNTER_SET_RIGHT: Final = Multiplexer(0x2012, 12)
COUNTER_DUPLICATE_SYNCS: Final = Multiplexer(0x2012, 13)
COUNTER_SYNCS_NOT_HEARD: Final = Multiplexer(0x2012, 14)
COUNTER_SECOND_DISAGREEMENTS: Final = Multiplexer(0x2012, 15)
COUNTER_LOSS_CAUSE: Final = Multiplexer(0x2012, 16)
COUNTER_LOSS_AGE: Final = Multiplexer(0x2012, 17)
COUNTER_LOSS_BAD: Final = Multiplexer(0x2012, 18)
COUNTER_LOSS_RESIDUAL: Final = Multiplexer(0x2012, 19)
COUNTER_LOSS_LIMIT: Final = Multiplexer(0x2012, 20)
COUNTER_LOSS_SPEED: Final = Multiplexer(0x2012, 21)
COUNTER_LOSS_FAULTS: Final = Multiplexer(0x2012, 22)

PREDICTION_POSITION: Final = Multiplexer(0x2013, 1)
PREDICTION_NOMINAL_SYNC: Final = Multiplexer(0x2013, 2)

SECOND_INCREMENTS: Final = Multiplexer(0x2014, 1)
SECOND_REVOLUTIONS: Final = Multiplexer(0x2014, 2)
SECOND_REVERSED: Final = Multiplexer(0x2014, 3)
SECOND_TOLERANCE: Final = Multiplexer(0x2014, 4)
SECOND_INVALIDATES: Final = Multiplexer(0x2014, 5)
SECOND_DIFFERENCE: Final = Multiplexer(0x2014, 6)

TABLE_STAGED: Final = Multiplexer(0x2020, 1)
TABLE_STAGED_CRC: Final = Multiplexer(0x2020, 2)
TABLE_ACTIVATE: Final = Multiplexer(0x2020, 3)
TABLE_ACTIVE_CRC: Final = Multiplexer(0x2020, 4)
TABLE_ACTIVE_ENTRIES: Final = Multiplexer(0x2020, 5)
TABLE_SAVED_CRC: Final = Multiplexer(0x2020, 6)
TABLE_ACTIVE_CONDITIONING: Final = Multiplexer(0x2020, 7)
"""The values of :data:`CONDITIONING` in force, REAL32 each; 2002h and 2005h: those of the next activation."""

MEASUREMENT_COMMAND: Final = Multiplexer(0x2030, 1)
MEASUREMENT_STATE: Final = Multiplexer(0x2030, 2)
MEASUREMENT_PROGRESS: Final = Multiplexer(0x2030, 3)
MEASUREMENT_COVERAGE: Final = Multiplexer(0x2030, 4)
MEASUREMENT_RESIDUAL_RMS: Final = Multiplexer(0x2030, 5)
MEASUREMENT_RESIDUAL_PEAK: Final = Multiplexer(0x2030, 6)
MEASUREMENT_REASON: Final = Multiplexer(0x2030, 7)
MEASUREMENT_DRIFT_RMS: Final = Multiplexer(0x2030, 8)
MEASUREMENT_DRIFT_PEAK: Final = Multiplexer(0x2030, 9)
MEASUREMENT_SAMPLES: Final = Multiplexer(0x2030, 10)


WRITE_LOCK_MODE: Final = Multiplexer(0x2040, 1)
WRITE_LOCK_UNLOCK_CODE: Final = Multiplexer(0x2040, 2)
WRITE_LOCK_NEW_UNLOCK_CODE: Final = Multiplexer(0x2040, 3)
WRITE_LOCK_LOCKED: Final = Multiplexer(0x2040, 4)


class WriteLockMode(IntEnum):
    """What can be written to 2040:01."""

    OFF = 0
    PREOP = 1
    CODE = 2


class MeasurementCommand(IntEnum):
    """What can be written to 2030:01."""

    START = 1
    STOP = 2
    ACCEPT = 3
    CHECK = 4
    FINISH = 5


class MeasurementState(IntEnum):
    """What 2030:02 says."""

    IDLE = 0
    RECORDING = 1
    COMPUTING = 2
    READY = 3
    REFUSED = 4
    ACCEPTED = 5
    CHECKED = 6


# 2050h, of the module and of the encoder interface.
RECORDING_COMMAND: Final = Multiplexer(0x2050, 1)
RECORDING_RECORDED: Final = Multiplexer(0x2050, 2)
RECORDING_SAMPLES: Final = Multiplexer(0x2050, 3)
RECORDING_RATE: Final = Multiplexer(0x2050, 4)
RECORDING_CAPACITY: Final = Multiplexer(0x2050, 5)

MISSED_COUNTS: Final = -32768
"""Sine and cosine in 2050:03 where a sample is missing. As a sample it would be clipped on both tracks, and
so nothing that could be used is mistaken for it."""


class RecordingCommand(IntEnum):
    """What can be written to 2050:01; it reads 1 while samples are taken, else 0."""

    START = 1
    STOP = 2


# Encoder profile, CiA 406.
OPERATING_PARAMETERS: Final = Multiplexer(0x6000)
UNITS_PER_REVOLUTION: Final = Multiplexer(0x6001)
TOTAL_RANGE: Final = Multiplexer(0x6002)
PRESET_VALUE: Final = Multiplexer(0x6003)
POSITION_VALUE: Final = Multiplexer(0x6004)
HIGH_PRECISION_POSITION: Final = Multiplexer(0x6008)
HIGH_PRECISION_PRESET: Final = Multiplexer(0x6009)
SINGLE_TURN_RESOLUTION: Final = Multiplexer(0x6501)
DISTINGUISHABLE_REVOLUTIONS: Final = Multiplexer(0x6502)
OFFSET_VALUE: Final = Multiplexer(0x6509)
SERIAL_NUMBER: Final = Multiplexer(0x650B)
