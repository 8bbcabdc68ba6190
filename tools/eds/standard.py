"""What CiA 301 demands of the objects 1000h to 1FFFh of an EDS: types, access, and what goes together."""

from __future__ import annotations

from collections.abc import Iterator

from tools.eds.model import (
    ARRAY,
    DOMAIN,
    DOMAIN_TYPE,
    RECORD,
    U8,
    U16,
    U32,
    VAR,
    VISIBLE_STRING,
    Eds,
    Entry,
    Finding,
    is_communication,
    is_mapping,
)

STANDARD_TYPES = (
    dict.fromkeys((0x1000, 0x1002, 0x1005, 0x1006, 0x1007, 0x1012, 0x1013, 0x1014, 0x1F80), (VAR, U32))
    | {0x1001: (VAR, U8), 0x100C: (VAR, U16), 0x100D: (VAR, U8), 0x1015: (VAR, U16), 0x1017: (VAR, U16)}
    | {0x1019: (VAR, U8), 0x1021: (DOMAIN, DOMAIN_TYPE)}
    | dict.fromkeys((0x1008, 0x1009, 0x100A), (VAR, VISIBLE_STRING))
    | dict.fromkeys((0x1003, 0x1010, 0x1011, 0x1016, 0x1020), (ARRAY, U32))
    | {0x1018: (RECORD, U32), 0x1029: (ARRAY, U8)}
)
"""Object type and data type, for ARRAY and RECORD that of all entries but sub-index 0 (CiA 301)."""
PDO_TYPES = {1: U32, 2: U8, 3: U16, 5: U16, 6: U8}
SDO_TYPES = {1: U32, 2: U32, 3: U8}

READ_ONLY = {0x1000, 0x1001, 0x1002, 0x1008, 0x1009, 0x100A, 0x1018, 0x1021, 0x1022, 0x1200}
READ_WRITE = {0x1007, 0x100C, 0x100D, 0x1010, 0x1011, 0x1015, 0x1016, 0x1019, 0x1020, 0x1029, 0x1F80}
MAPPABLE = {0x1001, 0x1002, 0x1013}
"""The objects below 2000h that a PDO may carry."""
DEFAULT_CAN_IDS = {0x1005: "80h", 0x1012: "100h", 0x1014: "$NODEID+80h"}

NEEDS = {
    0x1006: 0x1005,
    0x1007: 0x1005,
    0x1019: 0x1005,
    0x1015: 0x1014,
    0x100C: 0x100D,
    0x100D: 0x100C,
}
"""Objects that mean nothing without another one."""
NMT_STARTUP, NMT_MASTER = 0x1F80, 0x01
MULTIPLEXED_PDOS = range(0x1FA0, 0x2000)  # object scanner and object dispatching lists
MULTIPLEXED_COUNTS = (0xFE, 0xFF)  # what sub-index 0 of their mapping holds


def standard_kind(index: int, otherwise: int) -> int:
    """Object type that CiA 301 gives an object; `otherwise` where it gives none."""
    if 0x1200 <= index < 0x1300 or 0x1400 <= index < 0x1C00:
        return RECORD
    return STANDARD_TYPES.get(index, (otherwise, 0))[0]


def standard_type(entry: Entry) -> int:
    """Data type that CiA 301 gives an entry; its own where CiA 301 gives none."""
    index, sub = entry.index, entry.sub
    if is_communication(index):
        return PDO_TYPES.get(sub, entry.data_type)
    if 0x1200 <= index < 0x1300:
        return SDO_TYPES.get(sub, entry.data_type)
    kind, data_type = STANDARD_TYPES.get(index, (RECORD, U32 if is_mapping(index) else entry.data_type))
    return entry.data_type if kind in (ARRAY, RECORD) and sub == 0 else data_type


def check_standard_entries(eds: Eds) -> Iterator[Finding]:
    """Access and PDO mapping of each entry below 2000h, and of every sub-index 0."""
    for (index, sub), entry in eds.entries.items():
        allowed = _allowed_access(eds, index, sub)
        if allowed and entry.access not in allowed:
            yield Finding(entry.section.name, f"AccessType={entry.access} is not {' or '.join(allowed)}")
        if entry.mappable and index < 0x2000 and index not in MAPPABLE:
            yield Finding(entry.section.name, "PDOMapping=1, but CiA 301 lets no PDO carry it")
        if index in DEFAULT_CAN_IDS:
            yield from _check_default_can_id(eds, entry)


def _allowed_access(eds: Eds, index: int, sub: int) -> tuple[str, ...]:
    """Nothing where CiA 301 leaves it to the device."""
    has_subs = eds.objects.get(index) is not None and eds.objects[index].object_type in (ARRAY, RECORD)
    if index == 0x1003:
        return ("rw",) if sub == 0 else ("ro",)
    if is_mapping(index):
        return ("ro", "const", "rw")
    if index in READ_ONLY or (has_subs and sub == 0):
        return ("ro", "const")
    if index in READ_WRITE:
        return ("rw",)
    return ("ro", "const", "rw") if index < 0x2000 else ()


def _check_default_can_id(eds: Eds, entry: Entry) -> Iterator[Finding]:
    written = DEFAULT_CAN_IDS[entry.index]
    wanted = int(written.removeprefix("$NODEID+").removesuffix("h"), 16)
    if written.startswith("$NODEID"):
        wanted += eds.node_id
    value = entry.default(eds.node_id)
    if value is not None and value & 0x7FF != wanted:
        yield Finding(entry.section.name, f"CiA 301 gives it the CAN-ID {written}")


def check_companions(eds: Eds) -> Iterator[Finding]:
    """Objects that need each other, and [DeviceInfo] against the objects."""
    for index, needed in NEEDS.items():
        if index in eds.objects and needed not in eds.objects:
            yield Finding(f"{index:04X}", f"means nothing without {needed:04X}h")
    if not {0x1017, 0x100C} & eds.objects.keys():
        yield Finding("OptionalObjects", "neither heartbeat (1017h) nor node guarding (100Ch)")
    info = eds.section("DeviceInfo")
    startup = eds.entries.get((NMT_STARTUP, 0))
    value = startup.default(eds.node_id) if startup else None
    if info.number("SimpleBootUpMaster") == 1 and value is None:
        yield Finding("DeviceInfo", "SimpleBootUpMaster=1, but there is no 1F80h")
    elif info.number("SimpleBootUpMaster") == 0 and (value or 0) & NMT_MASTER:
        yield Finding("1F80", "DefaultValue makes it the NMT master, but SimpleBootUpMaster=0")
    multiplexed = _has_multiplexed_pdos(eds)
    if info.number("GroupMessaging") != int(multiplexed):
        objects = "are" if multiplexed else "are no"
        yield Finding("DeviceInfo", f"GroupMessaging is wrong: there {objects} multiplexed PDOs")
    for key in ("DynamicChannelsSupported", "CompactPDO"):
        if info.number(key):
            yield Finding("DeviceInfo", f"{key} is not 0, but the file describes every object itself")


def _has_multiplexed_pdos(eds: Eds) -> bool:
    lists = any(index in MULTIPLEXED_PDOS for index in eds.objects)
    counts = [
        entry.default(eds.node_id)
        for (index, sub), entry in eds.entries.items()
        if is_mapping(index) and not sub
    ]
    return lists or any(count in MULTIPLEXED_COUNTS for count in counts)
