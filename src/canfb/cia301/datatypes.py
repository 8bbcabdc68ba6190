"""The data types of CiA 301 (7.4.7): conversion of values to bytes and back."""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import Any


class DataType(IntEnum):
    """Index of the data type in the object dictionary (CiA 301, 7.4.7)."""

    BOOLEAN = 0x01
    INTEGER8 = 0x02
    INTEGER16 = 0x03
    INTEGER32 = 0x04
    UNSIGNED8 = 0x05
    UNSIGNED16 = 0x06
    UNSIGNED32 = 0x07
    REAL32 = 0x08
    VISIBLE_STRING = 0x09
    OCTET_STRING = 0x0A
    UNICODE_STRING = 0x0B
    TIME_OF_DAY = 0x0C
    TIME_DIFFERENCE = 0x0D
    DOMAIN = 0x0F
    INTEGER24 = 0x10
    REAL64 = 0x11
    INTEGER40 = 0x12
    INTEGER48 = 0x13
    INTEGER56 = 0x14
    INTEGER64 = 0x15
    UNSIGNED24 = 0x16
    UNSIGNED40 = 0x18
    UNSIGNED48 = 0x19
    UNSIGNED56 = 0x1A
    UNSIGNED64 = 0x1B


# Formats of `struct` for the types it supports; always little-endian ("<").
FORMATS: dict[int, str] = {
    DataType.BOOLEAN: "?",
    DataType.INTEGER8: "b",
    DataType.INTEGER16: "h",
    DataType.INTEGER32: "i",
    DataType.INTEGER64: "q",
    DataType.UNSIGNED8: "B",
    DataType.UNSIGNED16: "H",
    DataType.UNSIGNED32: "I",
    DataType.UNSIGNED64: "Q",
    DataType.REAL32: "f",
    DataType.REAL64: "d",
}

_ODD_BITS: dict[int, int] = {
    DataType.INTEGER24: 24,
    DataType.INTEGER40: 40,
    DataType.INTEGER48: 48,
    DataType.INTEGER56: 56,
    DataType.UNSIGNED24: 24,
    DataType.UNSIGNED40: 40,
    DataType.UNSIGNED48: 48,
    DataType.UNSIGNED56: 56,
}
_FIXED_BYTES: dict[int, int] = {DataType.TIME_OF_DAY: 48, DataType.TIME_DIFFERENCE: 48}
_STRUCTS = {code: struct.Struct("<" + letter) for code, letter in FORMATS.items()}

# Width of the signed integers, bits.
SIGNED_BITS: dict[int, int] = {
    DataType.INTEGER8: 8,
    DataType.INTEGER16: 16,
    DataType.INTEGER32: 32,
    DataType.INTEGER24: 24,
    DataType.INTEGER40: 40,
    DataType.INTEGER48: 48,
    DataType.INTEGER56: 56,
    DataType.INTEGER64: 64,
}

FLOATS = frozenset({DataType.REAL32, DataType.REAL64})
STRINGS = frozenset({DataType.VISIBLE_STRING, DataType.UNICODE_STRING})
BYTES = frozenset({DataType.OCTET_STRING, DataType.DOMAIN, *_FIXED_BYTES})
KNOWN = frozenset(int(code) for code in DataType)


_BITS: dict[int, int] = {
    **{code: 8 * packer.size for code, packer in _STRUCTS.items()},
    **_ODD_BITS,
    **_FIXED_BYTES,
    DataType.BOOLEAN: 1,
}


def bit_length(data_type: int) -> int:
    """Length of a value in a PDO, bits; 0 for a type without a fixed length (strings, DOMAIN)."""
    return _BITS.get(data_type, 0)


def byte_length(data_type: int) -> int:
    return (bit_length(data_type) + 7) // 8


def zero(data_type: int) -> Any:
    """The value of an object that has no default: 0, 0.0, False or empty."""
    return decode(data_type, bytes(byte_length(data_type)))


def encode(data_type: int, value: Any) -> bytes:
    """Bytes of a value, little-endian.

    ValueError if the value does not fit the type: an error of the code that set it.
    """
    try:
        packer = _STRUCTS.get(data_type)
        if packer is not None:
            return packer.pack(value)
        if data_type in _ODD_BITS:
            return int(value).to_bytes(byte_length(data_type), "little", signed=data_type in SIGNED_BITS)
        if data_type == DataType.VISIBLE_STRING:
            return str(value).encode("latin-1")
        if data_type == DataType.UNICODE_STRING:
            return str(value).encode("utf-16-le")
        return bytes(value)
    except (struct.error, OverflowError, TypeError, UnicodeError) as error:
        raise ValueError(f"{value!r} is not a {DataType(data_type).name}: {error}") from error


def decode(data_type: int, data: bytes) -> Any:
    """Value of `data`, whose length must be that of the type (else ValueError)."""
    size = byte_length(data_type)
    if size and len(data) != size:
        raise ValueError(f"{DataType(data_type).name} has {size} bytes, not {len(data)}")
    unpacker = _STRUCTS.get(data_type)
    if unpacker is not None:
        return unpacker.unpack(data)[0]
    if data_type in _ODD_BITS:
        return int.from_bytes(data, "little", signed=data_type in SIGNED_BITS)
    if data_type == DataType.VISIBLE_STRING:
        return data.decode("latin-1")
    if data_type == DataType.UNICODE_STRING:
        return data.decode("utf-16-le", errors="replace")
    return bytes(data)
