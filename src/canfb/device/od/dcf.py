"""A device configuration file (DCF, CiA 306): an EDS with the values, node-ID and bit rate of one device.

Also the order of the SDO writes that set these values, and the concise DCF (CiA 302-3, 1F22h).
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from canfb.cia301 import cob, datatypes
from canfb.device.od import eds
from canfb.device.od.dictionary import Entry

_CYCLE_PERIOD, _SYNC, _TIME, _CONSUMERS, _VERIFY = 0x1006, 0x1005, 0x1012, 0x1016, 0x1020
_MAPPINGS = (range(0x1600, 0x1800), range(0x1A00, 0x1C00))
_COMMUNICATIONS = (range(0x1400, 0x1600), range(0x1800, 0x1A00))
_SDO_CHANNELS = range(0x1200, 0x1300)
_EMCY = 0x1014

# Results of `turn`, the order of writing: most parameters, numbers of mapped objects, 1006h, COB-IDs, 1020h.
TURNS = range(5)


def turn(entry: Entry) -> int:
    if _is_mapping_count(entry):
        return 1
    if entry.index == _CYCLE_PERIOD:
        return 2
    if entry.index == _VERIFY:
        return 4
    return 3 if _is_cob_id(entry) else 0


def switched_off(entry: Entry, value: Any) -> Any:
    """The value that an entry needs so that the others can be written; `value` is its final one. None: it
    blocks no other.

    PDOs, EMCY, further SDO servers, SYNC, TIME and heartbeat consumers are off, and nothing is mapped.
    """
    if _is_mapping_count(entry) or entry.index in (_CYCLE_PERIOD, _CONSUMERS):
        return 0
    if not _is_cob_id(entry):
        return None
    if entry.index == _SYNC:
        return value & ~cob.GENERATE
    # Bit 31 of 1012h: TIME is consumed. Bit 31 of all other COB-IDs: the object is not valid.
    return value & cob.CAN_ID if entry.index == _TIME else cob.NOT_VALID


def _is_cob_id(entry: Entry) -> bool:
    if entry.index in (_SYNC, _TIME, _EMCY):
        return True
    if entry.index in _SDO_CHANNELS:
        return entry.subindex in (1, 2)
    return entry.subindex == 1 and any(entry.index in indices for indices in _COMMUNICATIONS)


def _is_mapping_count(entry: Entry) -> bool:
    return entry.subindex == 0 and any(entry.index in indices for indices in _MAPPINGS)


_COUNT = struct.Struct("<I")
_HEADER = struct.Struct("<HBI")  # index, sub-index, bytes of data


@dataclass(frozen=True, slots=True)
class Write:
    """One SDO write, little-endian."""

    index: int
    subindex: int
    data: bytes


def encode_concise(writes: Iterable[Write]) -> bytes:
    """The concise DCF: the number of writes, then index, sub-index, size and data of each."""
    parts = [_HEADER.pack(one.index, one.subindex, len(one.data)) + one.data for one in writes]
    return _COUNT.pack(len(parts)) + b"".join(parts)


def decode_concise(data: bytes) -> list[Write]:
    if len(data) < _COUNT.size:
        raise ValueError("a concise DCF begins with the number of its entries, 4 bytes")
    writes: list[Write] = []
    offset = _COUNT.size
    for number in range(1, _COUNT.unpack_from(data)[0] + 1):
        if offset + _HEADER.size > len(data):
            raise ValueError(f"entry {number} of the concise DCF is truncated")
        index, subindex, size = _HEADER.unpack_from(data, offset)
        offset += _HEADER.size
        if offset + size > len(data):
            raise ValueError(f"entry {number} of the concise DCF, {index:04X}h:{subindex:02X}, is truncated")
        writes.append(Write(index, subindex, data[offset : offset + size]))
        offset += size
    if offset != len(data):
        raise ValueError(f"{len(data) - offset} bytes follow the last entry of the concise DCF")
    return writes


COMMISSIONING = "DeviceComissioning"  # The section as CiA 306 spells it.
LINE_END = "\r\n"
_PLAIN = 1e9
REFUSE_ON_DOWNLOAD = 0x1  # Bit 0 of ObjFlags: a configuration tool must not write the entry.

Place = tuple[int, int]


class Reals(Enum):
    """Notation of reals, which CiA 306 leaves open."""

    DECIMAL = "decimal"
    IEEE754 = "ieee754"  # The bits of the number, in hexadecimal.


def dcf_text(
    path: Path,
    values: Mapping[Place, Any],
    *,
    file_name: str,
    description: str,
    date: str,
    time: str,
    node_id: int,
    node_name: str,
    bit_rate_kbit_s: int | None,
    network_name: str,
    serial_number: int,
    reals: Reals = Reals.DECIMAL,
    files: Mapping[Place, str] | None = None,
) -> str:
    """The DCF from the EDS at `path`, with `values` by index and sub-index as its ParameterValue.

    Numbers, without $NODEID, follow the notation of the EDS. `files` are file names for DownloadFile.
    `date` is mm-dd-yyyy, `time` hh:mm with AM or PM; `bit_rate_kbit_s` None: unknown, left out. ValueError
    for an entry that the EDS does not have.
    """
    contents = eds.read(path)
    sections = eds.sections(contents)
    files = files or {}
    for place in [*values, *files]:
        if place not in sections:
            raise ValueError(f"{place[0]:04X}h:{place[1]:02X} is not in the EDS")
        options = contents[sections[place]]
        if place in values:
            options["ParameterValue"] = _written(options, values[place], reals)
        if place in files:
            options["DownloadFile"] = files[place]
        flags = eds.whole(options.get("ObjFlags") or "0")
        if flags & REFUSE_ON_DOWNLOAD:
            options["ObjFlags"] = f"0x{flags & ~REFUSE_ON_DOWNLOAD:X}"
    info = contents.setdefault("FileInfo", {})
    info |= {
        "FileName": file_name,
        "FileVersion": "1",
        "FileRevision": "1",
        "EDSVersion": info.get("EDSVersion", "4.0"),
        "Description": description,
        "CreationTime": time,
        "CreationDate": date,
        "CreatedBy": "canfb",
        "ModificationTime": time,
        "ModificationDate": date,
        "ModifiedBy": "canfb",
        "LastEDS": path.name,
    }
    commissioning = {
        "NodeID": f"0x{node_id:02X}",
        "NodeName": node_name,
        **({} if bit_rate_kbit_s is None else {"Baudrate": str(bit_rate_kbit_s)}),
        "NetNumber": "0",
        "NetworkName": network_name,
        "CANopenManager": "0",
        "LSS_SerialNumber": str(serial_number),
    }
    return _as_text(contents, commissioning)


def real_as_text(data_type: int, value: float, reals: Reals) -> str:
    """The shortest decimal number that reads back as `value`, or its bits."""
    data = datatypes.encode(data_type, value)
    if reals is Reals.IEEE754:
        return f"0x{data[::-1].hex().upper()}"
    plain = [str(int(value))] if abs(value) < _PLAIN else []  # some tools read no exponents
    texts = [*plain, *(f"{value:.{digits}g}" for digits in range(1, 18))]
    return next((text for text in texts if _is_text_of(text, data_type, data)), repr(float(value)))


def _is_text_of(text: str, data_type: int, data: bytes) -> bool:
    try:
        return datatypes.encode(data_type, float(text)) == data
    except ValueError:  # rounding gave more than the largest number of the type
        return False


def _written(options: Mapping[str, str], value: Any, reals: Reals) -> str:
    data_type = eds.whole(options["DataType"])
    if data_type in datatypes.FLOATS:
        return real_as_text(data_type, value, reals)
    if data_type in datatypes.STRINGS:
        return str(value)
    if data_type in datatypes.BYTES:
        return bytes(value).hex().upper()
    default = options.get("DefaultValue", "").lower()
    if "0x" not in default or value < 0:
        return str(int(value))
    return f"0x{int(value):0{2 * datatypes.byte_length(data_type)}X}"


def _as_text(contents: eds.Contents, commissioning: Mapping[str, str]) -> str:
    blocks = []
    for section, options in contents.items():
        blocks.append(_block(section, options))
        if section == "DeviceInfo":
            blocks.append(_block(COMMISSIONING, commissioning))
    return LINE_END.join(blocks)


def _block(section: str, options: Mapping[str, str]) -> str:
    lines = [f"[{section}]", *(f"{option}={text}" for option, text in options.items())]
    return "".join(f"{line}{LINE_END}" for line in lines)
