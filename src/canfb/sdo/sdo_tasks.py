"""Reading and writing objects of a node by name, for ``canfb sdo``."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from pathlib import Path
from typing import Any

from canfb import objects as od
from canfb.calibration.result import Reason
from canfb.cia301 import datatypes
from canfb.cia301.codes import AbortCode, ErrorRegister
from canfb.cia301.datatypes import DataType
from canfb.device.od.dcf import Reals, real_as_text
from canfb.errors import ConfigError, saying
from canfb.master.access import CommissioningError, NodeAccess, RefusedError, but_then
from canfb.master.all_or_nothing import SAVE_WITHIN_S
from canfb.rows import Result, those
from canfb.sdo.object_description import ObjectDescription, ObjectDescriptions, Place, numbered
from canfb.view.module_view import limit_settings

_TRUE, _FALSE = ("1", "true", "on"), ("0", "false", "off")


def type_name(data_type: int) -> str:
    return DataType(data_type).name if data_type in datatypes.KNOWN else f"type {data_type:04X}h"


def value_range(data_type: int, low: float | None = None, high: float | None = None) -> tuple[float, float]:
    """Lowest and highest value of a numeric type, within ``low`` and ``high``."""
    lowest, highest = -math.inf, math.inf
    if data_type not in datatypes.FLOATS:
        bits, signed = datatypes.bit_length(data_type), data_type in datatypes.SIGNED_BITS
        lowest, highest = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
    return lowest if low is None else max(lowest, low), highest if high is None else min(highest, high)


def check_value(data_type: int, value: Any, low: float | None = None, high: float | None = None) -> Any:
    """``value`` converted to the type, or ValueError."""
    if data_type in datatypes.FLOATS:
        value = _real(data_type, value, *value_range(data_type, low, high))
    elif data_type in datatypes.STRINGS:
        if not isinstance(value, str):
            raise ValueError(f"must be a text, not {value!r}")
    elif data_type in datatypes.BYTES or data_type not in datatypes.KNOWN:
        if not isinstance(value, bytes):
            raise ValueError(f"must be bytes, not {value!r}")
    elif data_type == DataType.BOOLEAN:
        if value not in (0, 1):
            raise ValueError(f"must be true or false, not {value!r}")
        value = bool(value)
    else:
        lowest, highest = value_range(data_type, low, high)
        if not isinstance(value, int) or isinstance(value, bool) or not lowest <= value <= highest:
            raise ValueError(f"must be a whole number {lowest}..{highest}, not {value!r}")
    datatypes.encode(data_type, value)  # ValueError, e.g. for a text beyond Latin-1
    return value


def _real(data_type: int, value: Any, lowest: float, highest: float) -> float:
    if not isinstance(value, (int, float)) or isinstance(value, bool):
        raise ValueError(f"must be a number, not {value!r}")
    if value < lowest or value > highest:
        raise ValueError(f"must be a number {lowest:g}..{highest:g}, not {value!r}")
    try:
        return float(datatypes.decode(data_type, datatypes.encode(data_type, float(value))))
    except (ValueError, OverflowError):
        raise ValueError(f"{value!r} is beyond what a {type_name(data_type)} holds") from None


def parse_value(data_type: int, text: str, low: float | None = None, high: float | None = None) -> Any:
    """The value of a text (12, 0x1F, -3.5, on, DE AD BE EF), or ValueError."""
    value: Any = text
    if data_type in datatypes.BYTES or data_type not in datatypes.KNOWN:
        value = _parsed(bytes.fromhex, text, "bytes in hexadecimal such as 01FF")
    elif data_type == DataType.BOOLEAN:
        value = _parsed((_FALSE + _TRUE).index, text.lower(), "1 or 0") >= len(_FALSE)
    elif data_type in datatypes.FLOATS:
        value = _parsed(float, text, "a number")
    elif data_type not in datatypes.STRINGS:
        value = _parsed(lambda digits: int(digits, 0), text, "a whole number")
    return check_value(data_type, value, low, high)


def _parsed(how: Callable[[str], Any], text: str, what: str) -> Any:
    try:
        return how(text)
    except ValueError:
        raise ValueError(f"must be {what}, not {text!r}") from None


def short_real(value: float, data_type: int = DataType.REAL32) -> float:
    """The float with the fewest digits that gives the same REAL32."""
    return float(real_as_text(data_type, value, Reals.DECIMAL)) if math.isfinite(value) else value


MODULE, INTERFACE = "canfb drive feedback module", "canfb encoder interface"  # ProductName of the EDS
SIGNATURES = {
    0x1010: {"save": int.from_bytes(b"save", "little")},
    0x1011: {"load": int.from_bytes(b"load", "little")},
}

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
    AbortCode.LENGTH: "the type in the EDS differs from that of the node: give its own EDS with --eds",
    AbortCode.TOO_LONG: "the type in the EDS differs from that of the node: give its own EDS with --eds",
    AbortCode.TOO_SHORT: "the type in the EDS differs from that of the node: give its own EDS with --eds",
    AbortCode.VALUE_TOO_HIGH: "write a lower value",
    AbortCode.VALUE_TOO_LOW: "write a higher value",
    AbortCode.INVALID_VALUE: "the node does not take this value; its manual says which ones it takes",
    AbortCode.DEVICE_STATE: "not in this state of the node: try canfb node preop, or switch its PDO off",
    AbortCode.LOCAL_CONTROL: "the node is locked: unlock it there; canfb: write its code to 2040:02, 1 s "
    "after a wrong one (2040:04 is 0 if it is not locked: then it may have no code)",
    AbortCode.NOT_STORED: "the node cannot keep it (canfb run: state_dir), or requires the word save or load",
    AbortCode.HARDWARE: "its memory or its disk fails",
    AbortCode.UNSUPPORTED_ACCESS: "not now: a PDO that is valid cannot be changed; set bit 31 of its COB-ID",
    AbortCode.NOT_MAPPABLE: "no PDO carries this object",
    AbortCode.PDO_LENGTH: "more than 8 bytes are mapped",
    AbortCode.NO_DATA: "there is nothing to read yet",
    AbortCode.TIMEOUT: "the node was too slow; try again",
}

_NO_PRESET = "a preset needs a valid position at standstill: stop the machine (canfb why, if it is not valid)"
# Advice if an object of canfb is refused because of the device state (08000022h).
_OF_PLACE: dict[str, dict[Place, str]] = {
    MODULE: {
        od.PRESET_VALUE: _NO_PRESET,
        od.HIGH_PRECISION_PRESET: _NO_PRESET,
        od.MEASUREMENT_COMMAND: "not in this state of the calibration: read 2030:02",
    },
    INTERFACE: {
        od.INTERFACE_MACHINE: "only a simulated motion stops here: no drive, recording or real converter",
        od.RECORDING_COMMAND: "the source is a file, without samples between two SYNCs",
    },
}


def in_words(product: str, place: Place, value: object) -> str:
    """An enumeration or bits in words; "": neither."""
    kind = _kind(product, place)
    if product == MODULE and place == od.MEASUREMENT_REASON and isinstance(value, int):
        return str(Reason.of_number(value).text) if value else ""
    if kind is None or not isinstance(value, int):
        return ""
    if issubclass(kind, IntEnum):
        return next((getattr(one, "text", _spoken(one.name)) for one in kind if one == value), "")
    names = {one.value: _spoken(str(one.name)) for one in kind}
    bits = [bit for bit in range(value.bit_length()) if value >> bit & 1]
    return ", ".join(names.get(1 << bit, f"bit {bit}") for bit in bits) or "nothing set"


def words_of(product: str, place: Place) -> Mapping[str, int]:
    """Words, such as start, and their values."""
    if place[0] in SIGNATURES and place[1]:
        return SIGNATURES[place[0]]
    kind = _kind(product, place)
    return {_spoken(str(one.name)): int(one.value) for one in kind} if kind else {}


def abort_words(code: int, entry: ObjectDescription, product: str) -> str:
    meaning = next((one.text for one in AbortCode if one == code), "a code of the manufacturer")
    advice = _TO_DO.get(code, "")
    if code == AbortCode.DEVICE_STATE:
        advice = _OF_PLACE.get(product, {}).get(entry.place, advice)
    is_range = code in (AbortCode.VALUE_TOO_HIGH, AbortCode.VALUE_TOO_LOW)
    if is_range and (entry.least is not None or entry.most is not None):
        low, high = ("" if limit is None else f"{limit:g}" for limit in (entry.least, entry.most))
        advice = f"the EDS allows {low}..{high}"
    return f"{meaning} ({code:08X}h){'; ' * bool(advice)}{advice}"


def _kind(product: str, place: Place) -> type[IntFlag | IntEnum] | None:
    return _OF.get(product, {}).get(place) or _ANY.get(place)


def _spoken(name: str) -> str:
    return name.lower().replace("_", " ")


MOST_BYTES = 32
_PART = re.compile(r"1/(\d+|2\^\d+) (\D.*)")
SUPERVISION = (0x2001, 0x2010)
WATCH_S, LOOK_S = 2.0, 0.25  # longest measurement of the sample rate, and interval of its readings
RATE_SAMPLES = 40  # number that gives the rate within 3 %; with slow SYNC fewer


@dataclass(frozen=True)
class Reading:
    """An object and its bytes."""

    entry: ObjectDescription
    data: bytes
    product: str

    @property
    def value(self) -> Any:
        try:
            return self.entry.decode(self.data)
        except ValueError:
            return None

    @property
    def words(self) -> str:
        return in_words(self.product, self.entry.place, self.value)

    def text(self) -> str:
        entry, value = self.entry, self.value
        if value is None:
            return f"{_octets(self.data)} ({len(self.data)} bytes, the EDS has {type_name(entry.data_type)})"
        if isinstance(value, bytes):
            return _octets(value)
        if isinstance(value, str):
            return value
        shown = f"{short_real(value, entry.data_type)}" if isinstance(value, float) else str(value)
        if entry.holds_bits:
            shown = f"0x{value:08X}"
        if self.words:
            return f"{shown} ({self.words})"
        part = _part(entry.unit)
        if part is not None:
            return f"{shown} ({value / part[0]:.6g} {part[1]})"
        return f"{shown} {_times(entry.unit)}".rstrip()

    def line(self) -> str:
        return f"{self.entry.number} {self.entry.title}: {self.text()}"

    def figures(self) -> dict[str, Any]:
        entry, value = self.entry, self.value
        if isinstance(value, bytes):
            value = value.hex()
        elif isinstance(value, float) and not math.isfinite(value):
            value = None
        return {
            "object": entry.number,
            "name": entry.title,
            "type": type_name(entry.data_type),
            "value": value,
            "unit": entry.unit or None,
            "words": self.words or None,
            "bytes": self.data.hex(),
        }


def _part(unit: str) -> tuple[int, str] | None:
    """65536 and "cycle" for the unit 1/65536 cycle; None for a unit without divisor."""
    match = _PART.fullmatch(unit)
    if match is None:
        return None
    return 2 ** int(match[1][2:]) if match[1].startswith("2^") else int(match[1]), match[2]


def _times(unit: str) -> str:
    return f"x {unit}" if unit[:1].isdigit() else unit


def raw_text(unit: str, text: str) -> str:
    """The number in the object (13107) for a displayed value (0.2, "0.2 cycle"), or ValueError."""
    part = _part(unit)
    if part is None:
        return text.removesuffix(_times(unit)).rstrip() if unit else text
    return str(round(float(text.removesuffix(part[1])) * part[0]))


def _written(before: Reading | None, now: Reading | None, value: Reading, warning: str) -> Result:
    """The result of a write; ``before`` and ``now`` are None if unreadable."""
    line = f"{value.line()}, written"
    if before is not None and now is not None:
        line = f"{value.entry.number} {value.entry.title}: {before.text()} -> {now.text()}"
    readings = {"before": before, "now": now, "written": value}
    figures = {name: one and one.figures() for name, one in readings.items()}
    return Result(figures | {"warning": warning or None}, [line, *those((warning, warning))])


class SdoTasks:
    """Reads and writes of one node. ConfigError for unknown objects, CommissioningError for refusals."""

    def __init__(self, node: NodeAccess, described: ObjectDescriptions) -> None:
        self._node = node
        self._described = described

    def read(self, text: str) -> list[Reading]:
        meant = self._described.meant(text)
        readable = [entry for entry in meant if entry.readable]
        if not readable:
            raise CommissioningError(f"{meant[0].number} {meant[0].title} is write only")
        if len(readable) > 1:
            readable = [entry for entry in readable if entry.subindex or entry.index in _COUNTED]
        if readable[0].place == _ERRORS:  # reading beyond the number in 1003:00 is refused
            readable = readable[: 1 + self._node.integer(*_ERRORS, "B")]
        return [self._read(entry) for entry in readable]

    def write(self, text: str, value: str | bytes, *, raw: bool = False) -> Result:
        entry = self._one(text)
        data = value if isinstance(value, bytes) else self._encoded(entry, value, raw)
        with saying(ConfigError, f"{entry.number} {entry.title}", ValueError):
            datatypes.decode(entry.data_type, data)
        was_valid = self._described.product == MODULE and entry.index in SUPERVISION and self._is_valid()
        is_domain = entry.data_type == DataType.DOMAIN
        before = self._read(entry) if entry.readable and not is_domain else None
        try:
            if is_domain:
                self._node.download_domain(*entry.place, data)
            else:
                self._node.write_bytes(
                    *entry.place, data, SAVE_WITHIN_S if entry.index in SIGNATURES else None
                )
        except RefusedError as error:
            raise self._refused("writing", entry, error) from None
        with but_then(f"{entry.number} {entry.title} is written"):
            now = self._read(entry) if before is not None else None
            warning = self._warning() if was_valid else ""
        return _written(before, now, Reading(entry, data, self._described.product), warning)

    def _is_valid(self) -> bool:
        return bool(int(self._node.read_known(od.FEEDBACK_STATUS) or 0) & od.StatusBit.VALID)

    def _warning(self) -> str:
        node, master = self._node, self._node.master
        began, first = master.now(), node.integer(*od.FEEDBACK_SAMPLES, "I")
        samples = 0
        while samples < RATE_SAMPLES and master.now() < began + WATCH_S:
            master.wait(LOOK_S)
            samples = (node.integer(*od.FEEDBACK_SAMPLES, "I") - first) % (1 << 32)
        if not self._is_valid():
            return f"this lost the position: canfb why {node.node_id:#04x} says what brings it back"
        limits = limit_settings(node.read_known)
        sync_hz = samples / (master.now() - began) / limits.samples_per_sync
        needed = limits.needed_cycles(sync_hz)
        if limits.widest_cycles >= needed:
            return ""
        return (
            f"warning: 2010:01 is {limits.widest_cycles:.3g} cycle, and the declared acceleration (2010:02) "
            f"and phase error (2010:0C) need {needed:.3g}: good samples may lose the position"
        )

    def _one(self, text: str) -> ObjectDescription:
        meant = self._described.meant(text)
        can_be = [one for one in meant if one.writable]
        if len(can_be) == 1:
            return can_be[0]
        if len(meant) > 1:
            several = ", ".join(f"{one.number} {one.name}" for one in can_be)
            raise ConfigError(f"{text!r} has several entries; which one: {several or 'none can be written'}")
        raise CommissioningError(f"{meant[0].number} {meant[0].title} is read only")

    def _encoded(self, entry: ObjectDescription, text: str, raw: bool) -> bytes:
        words = words_of(self._described.product, entry.place)
        value: Any = words.get(text.strip().lower().replace("_", " "))
        try:
            if value is None:
                number = text if raw else raw_text(entry.unit, text)
                value = parse_value(entry.data_type, number, entry.least, entry.most)
            return datatypes.encode(entry.data_type, value)
        except (ValueError, OverflowError) as error:
            reason = str(error)
            if words:
                reason += f"; or one of the words {', '.join(words)}"
            elif (part := _part(entry.unit)) and not raw:
                low, high = (end / part[0] for end in value_range(entry.data_type, entry.least, entry.most))
                reason = f"must be {low:.6g}..{high:.6g} {part[1]}, not {text!r} ({entry.unit} with --raw)"
            raise ConfigError(f"{entry.number} {entry.title} {reason}") from None

    def _read(self, entry: ObjectDescription) -> Reading:
        fetch = self._node.upload_domain if entry.data_type == DataType.DOMAIN else self._node.read_bytes
        try:
            return Reading(entry, fetch(*entry.place), self._described.product)
        except RefusedError as error:
            raise self._refused("reading", entry, error) from None

    def _refused(self, doing: str, entry: ObjectDescription, error: RefusedError) -> CommissioningError:
        said = abort_words(error.code, entry, self._described.product)
        return CommissioningError(
            f"{self._node.name}: {doing} {entry.number} {entry.title} is refused: {said}"
        )


_ERRORS = (0x1003, 0)
# Objects whose sub-index 0 is more than the number of entries.
_COUNTED = frozenset({_ERRORS[0], *range(0x1600, 0x1800), *range(0x1A00, 0x1C00)})


def described_by(node: NodeAccess, known: Iterable[Path], text: str) -> ObjectDescriptions:
    """The EDS of the node, selected from ``known`` by 1018h; or ConfigError."""
    vendor, product = (node.integer(*place, "I") for place in od.IDENTITY[:2])
    for described in (ObjectDescriptions(path, node.node_id) for path in known):
        if described.identity == (vendor, product):
            return described
    place = numbered(text)
    what = text if place is None else od.place_text((place[0], place[1] or 0))
    raise ConfigError(
        f"{node.name} is product {product} of vendor {vendor}, which is not of canfb: give its EDS with "
        f"--eds FILE, for the name and type of {what}"
    )


def is_lost(reading: Reading) -> bool:
    is_status = reading.product == MODULE and reading.entry.place == od.FEEDBACK_STATUS
    return is_status and isinstance(reading.value, int) and bool(reading.value & od.StatusBit.LOST)


def _octets(data: bytes) -> str:
    if len(data) > MOST_BYTES:
        return f"{len(data)} bytes; --out FILE writes them to a file"
    return data.hex(" ") or "empty"
