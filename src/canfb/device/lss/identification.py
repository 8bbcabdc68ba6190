"""How an LSS master finds and selects a slave by its identity 1018h (CiA 305)."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

from canfb.device.od.dictionary import Dictionary

Address = tuple[int, int, int, int]
"""Vendor-ID, product code, revision number, serial number: the LSS address."""

SELECT = range(0x40, 0x44)
"""Switch state selective: one frame for each part of the address."""
IDENTIFY = range(0x46, 0x4C)
"""Identify remote slave: vendor-ID, product code, lowest and highest revision, and serial number."""
IDENTIFY_NON_CONFIGURED = 0x4C
FASTSCAN = 0x51

_CONFIRM = 128  # of the fastscan: is there any device without a node-ID?
_PARTS = 4


class LssResponse(IntEnum):
    """Command specifiers of the slave's answers."""

    SELECTED = 0x44
    IDENTIFIED = 0x4F
    NON_CONFIGURED = 0x50


class LssReply(NamedTuple):
    """What to send, and whether the slave is selected by it: it goes to the configuration state."""

    command: LssResponse
    selected: bool = False


class Identification:
    """The services that look for devices. What they ask over several frames is kept between them."""

    def __init__(self, dictionary: Dictionary) -> None:
        self._entries = [dictionary.find(0x1018, subindex) for subindex in range(1, _PARTS + 1)]
        self.reset()

    def reset(self) -> None:
        """Forget what was asked so far."""
        self._selection: list[int] = []
        self._range: list[int] = []
        self._scanned = 0  # the part of the address that the fastscan is at

    @property
    def address(self) -> Address:
        """The LSS address of the device; parts that 1018h does not have are 0."""
        vendor, product, revision, serial = (
            0 if entry is None else int(entry.value) for entry in self._entries
        )
        return vendor, product, revision, serial

    def handle(self, data: bytes, *, unconfigured: bool, waiting: bool) -> LssReply | None:
        """A frame of 8 bytes; what to answer, if anything.

        `unconfigured`: the device has no node-ID. `waiting`: it is in the waiting state.
        """
        command, number = data[0], int.from_bytes(data[1:5], "little")
        if command in SELECT:
            return self._select(command - SELECT.start, number) if waiting else None
        if command in IDENTIFY:
            return self._identify(command - IDENTIFY.start, number)
        if command == IDENTIFY_NON_CONFIGURED:
            return LssReply(LssResponse.NON_CONFIGURED) if unconfigured else None
        if command == FASTSCAN and unconfigured and waiting:
            return self._fastscan(number, *data[5:8])
        return None

    def _select(self, part: int, number: int) -> LssReply | None:
        self._selection = _collected(self._selection, part, number)
        if tuple(self._selection) != self.address:
            return None
        self._selection = []
        return LssReply(LssResponse.SELECTED, selected=True)

    def _identify(self, part: int, number: int) -> LssReply | None:
        self._range = _collected(self._range, part, number)
        if len(self._range) < len(IDENTIFY):
            return None
        vendor, product, revision_low, revision_high, serial_low, serial_high = self._range
        self._range = []
        own_vendor, own_product, revision, serial = self.address
        found = (
            (vendor, product) == (own_vendor, own_product)
            and revision_low <= revision <= revision_high
            and serial_low <= serial <= serial_high
        )
        return LssReply(LssResponse.IDENTIFIED) if found else None

    def _fastscan(self, number: int, bit: int, part: int, following: int) -> LssReply | None:
        """Compare the part down to `bit`; the master goes on with the part `following`."""
        if bit == _CONFIRM:
            self._scanned = 0
            return LssReply(LssResponse.IDENTIFIED)
        if bit > 31 or part >= _PARTS or following >= _PARTS or part != self._scanned:
            return None
        if (number ^ self.address[part]) >> bit:
            return None
        self._scanned = following
        complete = bit == 0 and following < part
        return LssReply(LssResponse.IDENTIFIED, selected=complete)


def _collected(parts: list[int], part: int, number: int) -> list[int]:
    """The parts so far and this one, if it is their next; the first one restarts."""
    if part == 0:
        return [number]
    return [*parts, number] if len(parts) == part else []
