"""Our EDS files against CiA 306 and CiA 301, where the checkers of others see nothing.

Each rule is a function that yields what is wrong, and finds the fault that is planted for it.
"""

import re
from collections.abc import Callable, Iterator
from datetime import datetime

import pytest

from canfb.eds_files import eds_path
from eds_text import MODULE, NAMES, EdsText, eds_of
from folding import each

LISTS = ("MandatoryObjects", "OptionalObjects", "ManufacturerObjects")
U8, U16, U32, STRING, DOMAIN = 0x05, 0x06, 0x07, 0x09, 0x0F
VAR, ARRAY, RECORD = 0x7, 0x8, 0x9
LONGEST_LINE = 255
TEXTS = {"VendorName": 244, "ProductName": 243, "OrderCode": 245}  # with key and equals sign 255
FLAGS = ("SimpleBootUpMaster", "SimpleBootUpSlave", "GroupMessaging", "LSS_Supported", "CompactPDO")

TYPES = (
    dict.fromkeys((0x1000, 0x1002, 0x1005, 0x1006, 0x1007, 0x1012, 0x1013, 0x1014, 0x1F80), (VAR, U32))
    | {0x1001: (VAR, U8), 0x100C: (VAR, U16), 0x100D: (VAR, U8), 0x1015: (VAR, U16), 0x1017: (VAR, U16)}
    | {0x1019: (VAR, U8), 0x1021: (2, DOMAIN), 0x1018: (RECORD, U32), 0x1029: (ARRAY, U8)}
    | dict.fromkeys((0x1008, 0x1009, 0x100A), (VAR, STRING))
    | dict.fromkeys((0x1003, 0x1010, 0x1011, 0x1016, 0x1020), (ARRAY, U32))
    | dict.fromkeys((*range(5632, 6144), *range(6656, 7168)), (RECORD, U32))
)
"""Object type and data type, for ARRAY and RECORD that of all entries but sub-index 0 (CiA 301)."""
PDO_TYPES = {0: U8, 1: U32, 2: U8, 3: U16, 5: U16, 6: U8}
READ_ONLY = {0x1000, 0x1001, 0x1002, 0x1008, 0x1009, 0x100A, 0x1018, 0x1021, 0x1022, 0x1200}
READ_WRITE = {0x1007, 0x100C, 0x100D, 0x1010, 0x1011, 0x1015, 0x1016, 0x1019, 0x1020, 0x1029, 0x1F80}
MAPPABLE = {0x1001, 0x1002, 0x1013}
NEEDS = {0x1006: 0x1005, 0x1007: 0x1005, 0x1019: 0x1005, 0x1015: 0x1014, 0x100C: 0x100D, 0x100D: 0x100C}
PDO_ACCESS = {"TPDO": ("ro", "const", "rw", "rwr"), "RPDO": ("wo", "rw", "rww")}
FIRST, COUNT = {"RPDO": 0x1400, "TPDO": 0x1800}, {"RPDO": "NrOfRXPDO", "TPDO": "NrOfTXPDO"}
PARAMETERS = {"TPDO": {0, 1, 2, 3, 5, 6}, "RPDO": {0, 1, 2, 3, 5}}
"""04h is reserved, 06h is the SYNC start value of a TPDO."""
RESTRICTED = (
    *(range(0x080), range(0x101, 0x181), range(0x581, 0x600)),
    *(range(0x601, 0x680), range(0x6E0, 0x700), range(0x701, 0x800)),
)
"""CAN-IDs that no configurable COB-ID may take (CiA 301, restricted CAN-IDs)."""


def form(eds: EdsText) -> Iterator[object]:
    """Lines, dates, and the lists and their objects in order."""
    yield from (line for line in eds.text.splitlines() if not line.isascii() or len(line) > LONGEST_LINE)
    yield from re.findall(r"[ \t]\n|\n\n\n|\r|[^\n]\Z", eds.text)
    info = eds.sections["FileInfo"]
    made, changed = (
        datetime.strptime(f"{info[event + 'Date']} {info[event + 'Time']}", "%m-%d-%Y %I:%M%p")
        for event in ("Creation", "Modification")
    )
    if made > changed:
        yield "modified before it was created"
    objects = [index for index, sub, _ in eds.listed() if sub is None]
    for name in LISTS:
        indices = [int(eds.sections[name][key], 0) for key in eds.sections[name] if key != "SupportedObjects"]
        if indices != sorted(indices) or indices != [index for index in objects if index in indices]:
            yield name, "is not in ascending order"
        objects = [index for index in objects if index not in indices]
    yield from objects


def device_info(eds: EdsText) -> Iterator[object]:
    """[DeviceInfo] and [DummyUsage] against each other and the objects."""
    info = eds.sections["DeviceInfo"]
    yield from (key for key, longest in TEXTS.items() if not 0 < len(info.get(key, "")) <= longest)
    rates = [f"BaudRate_{rate}" for rate in (10, 20, 50, 125, 250, 500, 800, 1000)]
    yield from (key for key in (*FLAGS, *rates) if info.get(key) not in ("0", "1"))
    yield from (
        key for key in ("GroupMessaging", "CompactPDO", "DynamicChannelsSupported") if info[key] != "0"
    )
    if not any(info[key] == "1" for key in rates):
        yield "no BaudRate"
    for kind, first in FIRST.items():
        if eds.number("DeviceInfo", COUNT[kind]) != sum(
            first <= index < first + 0x200 for index in eds.objects
        ):
            yield COUNT[kind]
    granularity = int(info["Granularity"])
    dummies = {f"Dummy{kind:04X}": bits for kind, bits in enumerate((1, 8, 16, 32, 8, 16, 32), start=1)}
    for key, bits in dummies.items():
        used = eds.sections["DummyUsage"].get(key)
        if used not in ("0", "1") or (used == "1" and bits < granularity):
            yield key
    startup = eds.entries.get((0x1F80, 0))
    if bool(eds.number("DeviceInfo", "SimpleBootUpMaster")) != bool(startup and (startup.default or 0) & 1):
        yield "SimpleBootUpMaster"


def types(eds: EdsText) -> Iterator[object]:
    """Object types and data types that CiA 301 gives."""
    for index, sub, name in eds.listed():
        kind, data_type = TYPES.get(index, (None, None))
        if 0x1400 <= index < 0x1600 or 0x1800 <= index < 0x1A00:
            kind, data_type = RECORD, PDO_TYPES.get(sub or 0)
        elif sub == 0:
            data_type = U8
        if sub is None and kind not in (None, eds.number(name, "ObjectType")):
            yield name, "ObjectType"
        if (sub is not None or kind in (VAR, 2)) and data_type not in (None, eds.number(name, "DataType")):
            yield name, "DataType"


def access(eds: EdsText) -> Iterator[object]:
    for (index, sub), entry in eds.entries.items():
        mapping = 0x1600 <= index < 0x1800 or 0x1A00 <= index < 0x1C00
        allowed = {"ro", "const", "rw"} if index < 0x2000 else {"ro", "const", "rw", "wo", "rww", "rwr"}
        if index == 0x1003:
            allowed = {"ro"} if sub else {"rw"}
        elif index in READ_ONLY or (eds.subs(index) and sub == 0 and not mapping):
            allowed = {"ro", "const"}
        elif index in READ_WRITE:
            allowed = {"rw"}
        if entry.access_type not in allowed:
            yield f"{index:04X}:{sub:02X}", entry.access_type
        if entry.pdo_mappable and (
            entry.access_type == "rw"
            or (index < 0x2000 and index not in MAPPABLE)
            or entry.data_type in (STRING, DOMAIN)
        ):
            yield f"{index:04X}:{sub:02X}", "mappable"
        if entry.access_type in ("rww", "rwr") and not entry.pdo_mappable:
            yield f"{index:04X}:{sub:02X}", "for PDO mapping, but PDOMapping=0"


def companions(eds: EdsText) -> Iterator[object]:
    """Objects that mean nothing without another one, and what :00 counts."""
    yield from (
        needed for index, needed in NEEDS.items() if index in eds.objects and needed not in eds.objects
    )
    if not {0x1017, 0x100C} & eds.objects.keys():
        yield "neither heartbeat nor node guarding"
    for index in eds.objects:
        subs = eds.subs(index)
        counts = index == 0x1003 or 0x1600 <= index < 0x1800 or 0x1A00 <= index < 0x1C00
        if subs and not counts and subs[0].default != max(subs):
            yield f"{index:04X}", "highest sub-index"


def pdos(eds: EdsText) -> Iterator[object]:
    """Communication and mapping parameters."""
    for kind, first in FIRST.items():
        found = {index for index in eds.objects if first <= index < first + 0x200}
        if {index + 0x200 for index in found} != {
            i for i in eds.objects if first + 0x200 <= i < first + 0x400
        }:
            yield kind, "only one of communication and mapping"
        for index in found:
            subs = eds.subs(index)
            if subs.keys() - PARAMETERS[kind] or {1, 2} - subs.keys():
                yield f"{index:04X}", "parameters"
            elif subs[2].default not in {*range(241), 254, 255, *((252, 253) if kind == "TPDO" else ())}:
                yield f"{index:04X}", "transmission type"
            yield from _mapping(eds, kind, index + 0x200)


def _mapping(eds: EdsText, kind: str, index: int) -> Iterator[object]:
    slots = {sub: slot for sub, slot in eds.subs(index).items() if sub}
    head = eds.entries.get((index, 0))
    count = -1 if head is None or head.default is None else int(head.default)
    if not 0 <= count <= len(slots):
        yield f"{index:04X}", "count"
        return
    bits = 0
    for sub, slot in slots.items():
        value = slot.default or 0
        if sub > count and not value:
            continue
        bits += value & 0xFF if sub <= count else 0
        mapped = eds.entries.get((value >> 16, value >> 8 & 0xFF))
        if value >> 16 < 0x20:
            usable = kind == "RPDO" and eds.sections["DummyUsage"].get(f"Dummy{value >> 16:04X}") == "1"
        else:
            usable = mapped is not None and mapped.pdo_mappable and mapped.access_type in PDO_ACCESS[kind]
        if not usable or (value & 0xFF) < int(eds.sections["DeviceInfo"]["Granularity"]):
            yield f"{index:04X}:{sub:02X}", f"{value:08X}h"
    if bits > 64:
        yield f"{index:04X}", bits


def cob_ids(eds: EdsText) -> Iterator[object]:
    """Legal, those that CiA 301 gives, and distinct among the communication objects valid by default."""
    fixed = {(0x1005, 0): 0x80, (0x1012, 0): 0x100, (0x1014, 0): 0x80 + eds.node_id}
    fixed |= {(0x1200, 1): 0x600 + eds.node_id, (0x1200, 2): 0x580 + eds.node_id}
    users: set[int] = set()
    for (index, sub), entry in eds.entries.items():
        pdo = sub == 1 and (0x1400 <= index < 0x1600 or 0x1800 <= index < 0x1A00)
        if not pdo and (index, sub) not in fixed:
            continue
        value, place = entry.default, f"{index:04X}:{sub:02X}"
        if value is None:
            yield place, "no default"
            continue
        can_id, valid = value & 0x7FF, index in (0x1005, 0x1012) or value < 0x80000000
        if can_id != fixed.get((index, sub), can_id) or value & 0x3FFFF800:
            yield place, f"{value:08X}h"
        if index != 0x1200 and (valid or can_id) and any(can_id in ids for ids in RESTRICTED):
            yield place, "restricted"
        if valid and can_id in users:
            yield place, "also that of another"
        users |= {can_id} if valid else set()


Rule = Callable[[EdsText], Iterator[object]]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("node_id", [1, 32, 127])
@pytest.mark.parametrize("rule", [form, device_info, types, access, companions, pdos, cob_ids])
def test_our_files_keep_the_rule(name: str, node_id: int, rule: Rule) -> None:
    eds = eds_of(name, node_id)
    assert list(rule(eds)) == []
    assert eds.sections["FileInfo"]["FileName"] == name


def changed(section: str, key: str, value: str) -> str:
    """The EDS of the module with another value."""
    head, start, rest = eds_path(MODULE).read_text(encoding="ascii").partition(f"[{section}]\n")
    body, gap, tail = rest.partition("\n\n")
    lines = [line for line in body.splitlines() if not line.startswith(f"{key}=")]
    return head + start + "\n".join([*lines, f"{key}={value}"]) + gap + tail


@each("rule, section, key, value", [
    (form, "OptionalObjects", "2", "0x1F80"),
    (device_info, "DeviceInfo", "NrOfRXPDO", "7"),
    (types, "1006", "DataType", "0x0006"),
    (access, "6000", "AccessType", "rww"),
    (companions, "2011sub0", "DefaultValue", "9"),
    (pdos, "1A00sub1", "DefaultValue", "0x20000520"),
    (cob_ids, "1801sub1", "DefaultValue", "$NODEID+0x180"),
])  # fmt: skip
def test_each_rule_finds_its_fault(rule: Rule, section: str, key: str, value: str) -> None:
    assert list(rule(EdsText(changed(section, key, value), 32)))


def test_a_module_must_not_share_the_node_id_of_its_encoder_interface() -> None:
    assert list(cob_ids(eds_of(MODULE, 16))) == [("1800:01", "also that of another")]
