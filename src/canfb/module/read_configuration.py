"""The configuration of another module, read from its objects."""

from __future__ import annotations

import struct
import zlib
from typing import Any, Protocol

from canfb import objects as od
from canfb.cia301 import datatypes
from canfb.device.od.dictionary import Dictionary, Entry
from canfb.eds_files import eds_path
from canfb.errors import CanfbError
from canfb.module.delivered import EDS
from canfb.module.device_configuration import DeviceConfiguration, configuration_read

IDENTITY = (od.DEVICE_TYPE, od.IDENTITY_VENDOR_ID, od.IDENTITY_PRODUCT_CODE)  # what a module is known by
ACTIVE_CONDITIONING = struct.Struct(f"<{len(od.CONDITIONING)}f")
CHANGED = "the table changed while it was read; try again"


class Objects(Protocol):
    """The objects of a node; CanfbError for what cannot be read."""

    @property
    def node_id(self) -> int:
        """1..127."""

    @property
    def name(self) -> str:
        """For messages."""

    def number(self, index: int, subindex: int, layout: str) -> int | float:
        """A number, ``layout`` as in struct."""

    def data(self, index: int, subindex: int) -> bytes:
        """The bytes of any object."""


def read_configuration(objects: Objects) -> DeviceConfiguration:
    """The active configuration of a module on a bus. CanfbError if it cannot be read, or is not of canfb.

    Table and conditioning are those in force, one set: between an upload and its activation 2002h and 2005h
    hold values of another table.
    """
    dictionary = Dictionary.load(eds_path(EDS), objects.node_id)
    for place in IDENTITY:
        entry = dictionary.entry(*place)
        found = _read(objects, entry)
        if found != entry.value:
            what = f"{place[0]:04X}:{place[1]:02X} is {found:X}h, not {entry.value:X}h"
            raise CanfbError(f"{objects.name} is not a feedback module of canfb: {what}")
    serial_number = int(_read(objects, dictionary.entry(*od.IDENTITY_SERIAL_NUMBER)))
    conditioning = objects.data(*od.TABLE_ACTIVE_CONDITIONING)
    table = _read_table(objects, dictionary)
    if objects.data(*od.TABLE_ACTIVE_CONDITIONING) != conditioning:
        raise CanfbError(f"{objects.name}: {CHANGED}")
    if len(conditioning) != ACTIVE_CONDITIONING.size:
        raise CanfbError(f"{objects.name}: 2020:07 has {len(conditioning)} bytes: another version of canfb")
    in_force = dict(zip(od.CONDITIONING, ACTIVE_CONDITIONING.unpack(conditioning), strict=True))

    def value(entry: Entry) -> Any:
        place = od.Multiplexer(entry.index, entry.subindex)
        return in_force[place] if place in in_force else _read(objects, entry)

    return configuration_read(objects.node_id, value, serial_number, table)


def _read(objects: Objects, entry: Entry) -> Any:
    letter = datatypes.FORMATS.get(entry.data_type)
    if letter is None:
        return entry.decode(objects.data(entry.index, entry.subindex))
    return objects.number(entry.index, entry.subindex, letter)


def _read_table(objects: Objects, dictionary: Dictionary) -> bytes:
    """The active table, empty for the identity."""
    crc32 = _read(objects, dictionary.entry(*od.TABLE_ACTIVE_CRC))
    if not crc32:
        return b""
    table = objects.data(*od.TABLE_STAGED)
    if zlib.crc32(table) != crc32:
        raise CanfbError(f"{objects.name}: {CHANGED}")
    return table
