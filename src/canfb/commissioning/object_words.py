"""Values in words: bits and enumerations of objects, and the abort codes of SDO with what to do."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum, IntFlag

from canfb import objects as od
from canfb.calibration.result import Reason
from canfb.cia301.codes import AbortCode, ErrorRegister
from canfb.commissioning.object_description import ObjectDescription, Place

MODULE, INTERFACE = "canfb drive feedback module", "canfb encoder interface"  # ProductName of the EDS
SAVE_SIGNATURE = {"save": int.from_bytes(b"save", "little")}
LOAD_SIGNATURE = {"load": int.from_bytes(b"load", "little")}

_ANY: dict[Place, type[IntFlag | IntEnum]] = {(0x1001, 0): ErrorRegister}
_OF: dict[str, dict[Place, type[IntFlag | IntEnum]]] = {
    MODULE: {
        od.SAMPLE_FLAGS: od.SampleFlag,
        od.FEEDBACK_STATUS: od.StatusBit,
        od.COUNTER_LOSS_CAUSE: od.LossCause,
        od.COUNTER_LOSS_FAULTS: od.StatusBit,
        od.MEASUREMENT_COMMAND: od.MeasurementCommand,
        od.MEASUREMENT_STATE: od.MeasurementState,
        od.RECORDING_COMMAND: od.RecordingCommand,
    },
    INTERFACE: {
        od.INTERFACE_FLAGS: od.SampleFlag,
        od.INTERFACE_MACHINE: od.MachineCommand,
        od.RECORDING_COMMAND: od.RecordingCommand,
    },
}

_TO_DO: dict[int, str] = {
    AbortCode.NO_OBJECT: "the node has no such object: is it this node, and the EDS of its version?",
    AbortCode.NO_SUBINDEX: "the node has no such sub-index: is it the EDS of its version?",
    AbortCode.LENGTH: "the type in the EDS is not that of the node: give its own with --eds",
    AbortCode.TOO_LONG: "the type in the EDS is not that of the node: give its own with --eds",
    AbortCode.TOO_SHORT: "the type in the EDS is not that of the node: give its own with --eds",
    AbortCode.VALUE_TOO_HIGH: "write a lower value",
    AbortCode.VALUE_TOO_LOW: "write a higher value",
    AbortCode.INVALID_VALUE: "the node does not take this value; its manual says which ones it takes",
    AbortCode.DEVICE_STATE: "not in this state of the node: try canfb nmt preop, or switch its PDO off first",
    AbortCode.LOCAL_CONTROL: "the node is under local control: release it there",
    AbortCode.NOT_STORED: "the node cannot keep it (canfb run: state_dir), or wants the word save or load",
    AbortCode.HARDWARE: "its memory or its disk fails",
    AbortCode.UNSUPPORTED_ACCESS: "not now: a PDO that is valid cannot be changed; set bit 31 of its COB-ID",
    AbortCode.NOT_MAPPABLE: "no PDO carries this object",
    AbortCode.PDO_LENGTH: "more than 8 bytes are mapped",
    AbortCode.NO_DATA: "there is nothing to read yet",
    AbortCode.TIMEOUT: "the node was too slow; try again",
}

_NO_PRESET = "a preset needs a valid position at standstill: stop the machine (canfb why, if it is not valid)"
_OF_PLACE: dict[str, dict[Place, str]] = {
    MODULE: {
        od.PRESET_VALUE: _NO_PRESET,
        od.HIGH_PRECISION_PRESET: _NO_PRESET,
        od.MEASUREMENT_COMMAND: "not in this state of the calibration: read 2030:02",
    },
    INTERFACE: {
        od.INTERFACE_MACHINE: "only a simulated motion stops here: no drive, recording or real converter",
        od.RECORDING_COMMAND: "what is sampled is a file: it has no samples between two SYNCs",
    },
}
"""What to do where an object of ours is refused in this state of the node (08000022h)."""


def in_words(product: str, place: Place, value: object) -> str:
    """An enumeration or bits in words; "" where there are none. Bits without a name are numbered."""
    kind = _kind(product, place)
    if not isinstance(value, int):
        return ""
    if product == MODULE and place == od.MEASUREMENT_REASON:
        return str(Reason.of_number(value).text) if value else ""
    if kind is None:
        return ""
    if kind is od.LossCause:
        return next((one.text for one in od.LossCause if one == value), "")
    if issubclass(kind, IntEnum):
        return next((_spoken(one.name) for one in kind if one == value), "")
    names = {one.value: _spoken(str(one.name)) for one in kind}
    bits = [bit for bit in range(value.bit_length()) if value >> bit & 1]
    return ", ".join(names.get(1 << bit, f"bit {bit}") for bit in bits) or "nothing set"


def from_words(product: str, place: Place, text: str) -> int | None:
    """The number of a word such as start, or save for 1010h; None where it is none."""
    return words_of(product, place).get(text.strip().lower().replace("_", " "))


def words_of(product: str, place: Place) -> Mapping[str, int]:
    """The words that can be written to an object."""
    signatures = {0x1010: SAVE_SIGNATURE, 0x1011: LOAD_SIGNATURE}
    if place[0] in signatures and place[1]:
        return signatures[place[0]]
    kind = _kind(product, place)
    return {_spoken(str(one.name)): int(one.value) for one in kind} if kind else {}


def abort_words(code: int, entry: ObjectDescription | None, product: str = "") -> str:
    """What an abort code means, and what to do; ``product`` is the name of it in the EDS."""
    meaning = next((one.text for one in AbortCode if one == code), "a code of the manufacturer")
    advice = _TO_DO.get(code, "")
    if code == AbortCode.DEVICE_STATE and entry is not None:
        advice = _OF_PLACE.get(product, {}).get(entry.place, advice)
    is_range = code in (AbortCode.VALUE_TOO_HIGH, AbortCode.VALUE_TOO_LOW, AbortCode.INVALID_VALUE)
    if is_range and entry is not None and (entry.low is not None or entry.high is not None):
        low, high = ("" if limit is None else f"{limit:g}" for limit in (entry.low, entry.high))
        advice = f"the EDS allows {low}..{high}"
    return f"{meaning} ({code:08X}h){'; ' * bool(advice)}{advice}"


def _kind(product: str, place: Place) -> type[IntFlag | IntEnum] | None:
    return _OF.get(product, {}).get(place) or _ANY.get(place)


def _spoken(name: str) -> str:
    return name.lower().replace("_", " ")
