"""Logs in BLF: the usual objects without python-can's cost for each of them."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any

import can

from canfb.cia301.frame import Frame

# What python-can writes for a classic frame: object header, header of version 1, CAN_MESSAGE.
OBJECT = struct.Struct("<4sHHLLLHHQHBBL8s")
SIGNATURE, HEADER_BYTES, VERSION = b"LOBJ", 32, 1
CAN_MESSAGES = frozenset({1, 86})
REMOTE = 0x80
LARGEST_ID = 0x7FF
UNITS = {1: 1e5, 2: 1e9}  # flags: time stamps in 10 us, in ns
_new = tuple.__new__  # makes a named tuple in half the time that its own constructor takes


class BlfFrames(can.BLFReader):
    """Gives (channel, Frame) for the usual objects, and messages of python-can for all others.

    Containers, and what is not usual, are those of python-can: its ``_parse_data`` gets what is left of a
    container from there on. Were that not called any more, all would be messages.
    """

    def _parse_data(self, data: bytes) -> Iterator[Any]:
        unpack, size, last = OBJECT.unpack_from, OBJECT.size, len(data) - OBJECT.size
        start_s, place = self.start_timestamp, 0
        while place <= last:
            (
                signature,
                header,
                version,
                length,
                kind,
                flags,
                _,
                _,
                time,
                channel,
                how,
                dlc,
                can_id,
                content,
            ) = unpack(data, place)
            usual = kind in CAN_MESSAGES and length == size and header == HEADER_BYTES and version == VERSION
            unit = UNITS.get(flags)
            if not usual or signature != SIGNATURE or can_id > LARGEST_ID or dlc > 8 or unit is None:
                break
            remote = bool(how & REMOTE)
            frame = (can_id, b"" if remote else content[:dlc], remote, time / unit + start_s)
            yield channel - 1, _new(Frame, frame)
            place += size
        try:
            yield from super()._parse_data(data[place:])
        finally:
            self._pos += place
