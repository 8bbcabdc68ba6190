"""A status word (2011:01) in words."""

from __future__ import annotations

from canfb.objects import StatusBit, fault_words, position_state
from canfb.rows import Result, Row, as_figures, as_lines

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
APART = (StatusBit.VALID, StatusBit.COASTING, StatusBit.LOST)
"""At most one of them is set in the word of one sample."""


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
