"""Values of objects as people write and read them, by the data type of the EDS."""

from __future__ import annotations

import math
import struct
from typing import Any

from canfb.cia301 import datatypes
from canfb.cia301.datatypes import DataType

OCTETS = frozenset({DataType.OCTET_STRING, DataType.DOMAIN, *datatypes.FIXED_BYTES})
"""Types whose values are bytes, written in hexadecimal."""
_TRUE, _FALSE = ("1", "true", "on"), ("0", "false", "off")


def type_name(data_type: int) -> str:
    """UNSIGNED16."""
    return DataType(data_type).name if data_type in datatypes.KNOWN else f"type {data_type:04X}h"


def value_range(data_type: int) -> tuple[int, int]:
    """Lowest and highest value of an integer type."""
    bits = datatypes.bit_length(data_type)
    if data_type in datatypes.SIGNED_BITS:
        return -(1 << bits - 1), (1 << bits - 1) - 1
    return 0, (1 << bits) - 1


def check_value(data_type: int, value: Any, low: float | None = None, high: float | None = None) -> Any:
    """``value`` as its type has it, a REAL32 rounded to one. ValueError for one of another type or size."""
    if data_type in datatypes.FLOATS:
        checked: Any = _real(data_type, value)
    elif data_type in datatypes.STRINGS:
        checked = value
        if not isinstance(value, str):
            raise ValueError(f"must be a text, not {value!r}")
    elif data_type in OCTETS or data_type not in datatypes.KNOWN:
        checked = value
        if not isinstance(value, bytes):
            raise ValueError(f"must be bytes, not {value!r}")
    elif data_type == DataType.BOOLEAN:
        if value not in (0, 1):
            raise ValueError(f"must be true or false, not {value!r}")
        checked = bool(value)
    else:
        checked = _integer(data_type, value, low, high)
    datatypes.encode(data_type, checked)  # says what the type cannot hold: a text beyond Latin-1
    return checked


def _integer(data_type: int, value: Any, low: float | None, high: float | None) -> int:
    lowest, highest = value_range(data_type)
    lowest = lowest if low is None else max(lowest, int(low))
    highest = highest if high is None else min(highest, int(high))
    if not isinstance(value, int) or isinstance(value, bool) or not lowest <= value <= highest:
        raise ValueError(f"must be a whole number {lowest}..{highest}, not {value!r}")
    return value


def _real(data_type: int, value: Any) -> float:
    if not isinstance(value, (int, float)) or isinstance(value, bool):
        raise ValueError(f"must be a number, not {value!r}")
    try:
        return float(datatypes.decode(data_type, datatypes.encode(data_type, float(value))))
    except (ValueError, OverflowError):
        raise ValueError(f"{value!r} is beyond what a {type_name(data_type)} holds") from None


def parse_value(data_type: int, text: str, low: float | None = None, high: float | None = None) -> Any:
    """The value of a text: 12, 0x1F, -3.5, on, DE AD BE EF. ValueError for what the type cannot hold."""
    if data_type in datatypes.STRINGS:
        return check_value(data_type, text)
    if data_type in OCTETS or data_type not in datatypes.KNOWN:
        try:
            return bytes.fromhex(text)
        except ValueError:
            raise ValueError(f"must be bytes in hexadecimal such as 01FF, not {text!r}") from None
    if data_type == DataType.BOOLEAN:
        if text.lower() not in _TRUE + _FALSE:
            raise ValueError(f"must be 1 or 0, not {text!r}")
        return text.lower() in _TRUE
    try:
        value = float(text) if data_type in datatypes.FLOATS else int(text, 0)
    except ValueError:
        what = "a number" if data_type in datatypes.FLOATS else "a whole number"
        raise ValueError(f"must be {what}, not {text!r}") from None
    return check_value(data_type, value, low, high)


def short_real(value: float, data_type: int = DataType.REAL32) -> float:
    """The float with the fewest digits that is the same REAL32: 0.1 in place of 0.10000000149011612."""
    if data_type != DataType.REAL32 or not math.isfinite(value):
        return value
    data = struct.pack("<f", value)
    short = (float(f"{value:.{digits}g}") for digits in range(1, 10))
    return next((one for one in short if _packed(one) == data), value)


def _packed(value: float) -> bytes | None:
    try:
        return struct.pack("<f", value)
    except OverflowError:  # rounded up beyond the largest number
        return None
