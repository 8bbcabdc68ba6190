"""Abort and EMCY codes, error register bits, NMT states and commands of CiA 301, each defined once."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from enum import IntEnum, IntFlag
from typing import Self

EMERGENCY = struct.Struct("<HB5s")  # code, 1001h and the field of the manufacturer (CiA 301, 7.2.7.3.1)


class CodeWithText(IntEnum):
    """An integer code; `.text` is its meaning. A member is NUMBER, TEXT."""

    text: str

    def __new__(cls, value: int, text: str) -> Self:
        member = int.__new__(cls, value)
        member._value_ = value
        member.text = text
        return member


class AbortCode(CodeWithText):
    """SDO abort codes (CiA 301, 7.2.4.3.17); `.text` is the meaning."""

    TOGGLE = 0x05030000, "toggle bit not alternated"
    TIMEOUT = 0x05040000, "SDO protocol timed out"
    COMMAND = 0x05040001, "command specifier not valid or unknown"
    BLOCK_SIZE = 0x05040002, "invalid block size"
    SEQUENCE_NUMBER = 0x05040003, "invalid sequence number"
    CRC = 0x05040004, "CRC error"
    OUT_OF_MEMORY = 0x05040005, "out of memory"
    UNSUPPORTED_ACCESS = 0x06010000, "unsupported access to an object"
    WRITE_ONLY = 0x06010001, "attempt to read a write only object"
    READ_ONLY = 0x06010002, "attempt to write a read only object"
    NO_OBJECT = 0x06020000, "object does not exist in the object dictionary"
    NOT_MAPPABLE = 0x06040041, "object cannot be mapped to the PDO"
    PDO_LENGTH = 0x06040042, "number and length of the objects to be mapped exceed the PDO length"
    PARAMETER_INCOMPATIBLE = 0x06040043, "general parameter incompatibility"
    INTERNAL_INCOMPATIBLE = 0x06040047, "general internal incompatibility in the device"
    HARDWARE = 0x06060000, "access failed due to a hardware error"
    LENGTH = 0x06070010, "data type does not match, length of service parameter does not match"
    TOO_LONG = 0x06070012, "data type does not match, length of service parameter too high"
    TOO_SHORT = 0x06070013, "data type does not match, length of service parameter too low"
    NO_SUBINDEX = 0x06090011, "sub-index does not exist"
    INVALID_VALUE = 0x06090030, "invalid value for parameter"
    VALUE_TOO_HIGH = 0x06090031, "value of parameter written too high"
    VALUE_TOO_LOW = 0x06090032, "value of parameter written too low"
    MAXIMUM_BELOW_MINIMUM = 0x06090036, "maximum value is less than minimum value"
    NO_CONNECTION = 0x060A0023, "resource not available: SDO connection"
    GENERAL = 0x08000000, "general error"
    NOT_STORED = 0x08000020, "data cannot be transferred or stored to the application"
    LOCAL_CONTROL = 0x08000021, "data cannot be transferred or stored because of local control"
    DEVICE_STATE = 0x08000022, "data cannot be transferred or stored because of the present device state"
    NO_DICTIONARY = 0x08000023, "object dictionary dynamic generation fails or none is present"
    NO_DATA = 0x08000024, "no data available"


class EmergencyCode(CodeWithText):
    """Emergency error codes (CiA 301, 7.2.7.1); `.text` is the meaning."""

    NO_ERROR = 0x0000, "error reset, or no error"
    GENERIC = 0x1000, "generic error"
    CURRENT = 0x2000, "current"
    VOLTAGE = 0x3000, "voltage"
    TEMPERATURE = 0x4000, "temperature"
    HARDWARE = 0x5000, "device hardware"
    SOFTWARE = 0x6000, "device software"
    INTERNAL_SOFTWARE = 0x6100, "internal software"
    USER_SOFTWARE = 0x6200, "user software"
    DATA_SET = 0x6310, "saved parameters refused"
    ADDITIONAL_MODULES = 0x7000, "additional modules"
    SENSOR = 0x7300, "sensor: position not valid"
    MONITORING = 0x8000, "monitoring"
    COMMUNICATION = 0x8100, "communication"
    CAN_OVERRUN = 0x8110, "CAN overrun, frames lost"
    CAN_ERROR_PASSIVE = 0x8120, "CAN in error passive mode"
    HEARTBEAT = 0x8130, "heartbeat or life guard error"
    BUS_OFF_RECOVERED = 0x8140, "recovered from bus-off"
    CAN_ID_COLLISION = 0x8150, "CAN-ID collision"
    PROTOCOL = 0x8200, "protocol error"
    RPDO_LENGTH = 0x8210, "PDO not processed, too short"
    RPDO_LENGTH_EXCEEDED = 0x8220, "PDO too long"
    SYNC_LENGTH = 0x8240, "unexpected length of SYNC"
    RPDO_TIMEOUT = 0x8250, "RPDO timed out"
    EXTERNAL = 0x9000, "external error"
    ADDITIONAL_FUNCTIONS = 0xF000, "additional functions"
    DEVICE_SPECIFIC = 0xFF00, "device specific"


def emergency_text(code: int, own: Mapping[int, str]) -> str:
    """Meaning of an emergency error code (0..FFFFh), from the ``own`` codes of the device or CiA 301."""
    texts = {int(known): known.text for known in EmergencyCode} | dict(own)
    nearest = (code, code & 0xFF00, code & 0xF000)
    return next((texts[known] for known in nearest if known in texts), "unknown error")


class ErrorRegister(IntFlag):
    """Bits of the error register 1001h."""

    GENERIC = 0x01
    CURRENT = 0x02
    VOLTAGE = 0x04
    TEMPERATURE = 0x08
    COMMUNICATION = 0x10
    DEVICE_PROFILE = 0x20
    MANUFACTURER = 0x80


class SdoAbort(Exception):
    """An SDO access is refused, for the reason in `code`. The device handles it internally."""

    def __init__(self, code: AbortCode) -> None:
        super().__init__(f"{code:08X}h {code.text}")
        self.code = code


class NmtState(IntEnum):
    """NMT state, with its value in a heartbeat."""

    INITIALISING = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


class NmtCommand(IntEnum):
    """Command specifier of the NMT node control protocol (CiA 301, 7.2.8.3.1)."""

    START = 1
    STOP = 2
    ENTER_PRE_OPERATIONAL = 128
    RESET_NODE = 129
    RESET_COMMUNICATION = 130


# The state that a command leads to, from any state but INITIALISING.
COMMANDED: dict[int, NmtState] = {
    NmtCommand.START: NmtState.OPERATIONAL,
    NmtCommand.STOP: NmtState.STOPPED,
    NmtCommand.ENTER_PRE_OPERATIONAL: NmtState.PRE_OPERATIONAL,
    NmtCommand.RESET_NODE: NmtState.INITIALISING,
    NmtCommand.RESET_COMMUNICATION: NmtState.INITIALISING,
}
