"""What CiA 301 demands of the PDOs and COB-IDs of an EDS: counts, default mappings, CAN-IDs."""

from __future__ import annotations

from collections.abc import Iterator

from tools.eds.model import BITS, Eds, Entry, Finding, is_communication

PDO_ACCESS = {"TPDO": ("ro", "const", "rw", "rwr"), "RPDO": ("wo", "rw", "rww")}
TRANSMISSION_TYPES = {"TPDO": [*range(241), 252, 253, 254, 255], "RPDO": [*range(241), 254, 255]}
PARAMETERS = {"TPDO": {0, 1, 2, 3, 5, 6}, "RPDO": {0, 1, 2, 3, 5}}
"""Sub-indices of the communication parameter: 04h is reserved, 06h is the SYNC start value of a TPDO."""
PDO_COUNT = {"TPDO": "NrOfTXPDO", "RPDO": "NrOfRXPDO"}
RESTRICTED_CAN_IDS = (
    *(range(0x080), range(0x101, 0x181), range(0x581, 0x600)),
    *(range(0x601, 0x680), range(0x6E0, 0x700), range(0x701, 0x800)),
)
"""CAN-IDs that no configurable COB-ID may take (CiA 301, restricted CAN-IDs)."""


def check_pdos(eds: Eds) -> Iterator[Finding]:
    for kind, first in (("RPDO", 0x1400), ("TPDO", 0x1800)):
        pdos = [index for index in eds.objects if first <= index < first + 0x200]
        mappings = [index for index in eds.objects if first + 0x200 <= index < first + 0x400]
        if eds.section("DeviceInfo").number(PDO_COUNT[kind]) != len(pdos):
            yield Finding("DeviceInfo", f"{PDO_COUNT[kind]} is not {len(pdos)}, the number of {kind} objects")
        for index in sorted({pdo + 0x200 for pdo in pdos} ^ set(mappings)):
            yield Finding(f"{index:04X}", f"{kind} has only one of communication and mapping object")
        for index in pdos:
            yield from _check_communication(eds, kind, index)
        for index in mappings:
            yield from _check_mapping(eds, kind, index)


def _check_communication(eds: Eds, kind: str, index: int) -> Iterator[Finding]:
    for sub in sorted(eds.subs(index).keys() - PARAMETERS[kind]):
        yield Finding(f"{index:04X}", f"a {kind} has no communication parameter {sub:02X}h")
    if (index, 1) not in eds.entries or (index, 2) not in eds.entries:
        yield Finding(f"{index:04X}", "sub-index 1 or 2 is missing")
    elif eds.entries[index, 2].default(eds.node_id) not in TRANSMISSION_TYPES[kind]:
        yield Finding(eds.entries[index, 2].section.name, f"DefaultValue is no transmission type of a {kind}")


def _check_mapping(eds: Eds, kind: str, index: int) -> Iterator[Finding]:
    slots = eds.subs(index)
    head = slots.pop(0, None)
    count = head.default(eds.node_id) if head else None
    if head is None or count is None or not 0 <= count <= min(len(slots), 64):
        yield Finding(f"{index:04X}", f"sub-index 0 does not count 0..{len(slots)} mapped objects")
        return
    variable = head.access == "rw"
    if any((slot.access == "rw") != variable for slot in slots.values()):
        yield Finding(head.section.name, "it and the mapped objects differ: writable or not")
    if (eds.section("DeviceInfo").number("Granularity") == 0) == variable:
        yield Finding("DeviceInfo", f"Granularity is 0 where mapping is fixed, else not: see [{index:04X}]")
    values = {sub: slot.default(eds.node_id) or 0 for sub, slot in slots.items()}
    for sub, slot in slots.items():
        if sub <= count or values[sub]:
            yield from _check_mapped(eds, kind, slot, values[sub])
    total = sum(value & 0xFF for sub, value in values.items() if sub <= count)
    if total > 64:
        yield Finding(f"{index:04X}", f"{total} bits are mapped, a PDO has 64")


def _check_mapped(eds: Eds, kind: str, slot: Entry, value: int) -> Iterator[Finding]:
    index, sub, bits = value >> 16, value >> 8 & 0xFF, value & 0xFF
    name = f"{index:04X}h:{sub:02X}"
    entry = eds.entries.get((index, sub))
    if index < 0x20:
        used = eds.section("DummyUsage").number(f"Dummy{index:04X}") == 1
        if kind == "TPDO" or not used or sub or bits != BITS.get(index):
            yield Finding(slot.section.name, f"{name} is not a dummy that this {kind} may map")
    elif entry is None:
        yield Finding(slot.section.name, f"mapped object {name} does not exist")
    else:
        if not entry.mappable or entry.access not in PDO_ACCESS[kind]:
            yield Finding(slot.section.name, f"{name} must not be mapped into a {kind}")
        if bits < (eds.section("DeviceInfo").number("Granularity") or 0):
            yield Finding(slot.section.name, f"{name} is shorter than Granularity")


def check_cob_ids(eds: Eds) -> Iterator[Finding]:
    """Legal, and at this node-ID distinct among the communication objects that are valid by default."""
    users: dict[int, str] = {}
    for (index, sub), entry in sorted(eds.entries.items(), key=lambda item: item[0]):
        if not _holds_cob_id(index, sub):
            continue
        value, section = entry.default(eds.node_id), entry.section
        if value is None:
            yield Finding(section.name, "the COB-ID has no DefaultValue")
            continue
        can_id, valid = value & 0x7FF, index in (0x1005, 0x1012) or value < 0x80000000
        if index == 0x1200:
            if value != (0x600, 0x580)[sub - 1] + eds.node_id:
                yield Finding(section.name, "the default SDO has 600h and 580h plus node-ID")
        elif value & 0x3FFFF800 or ((valid or can_id) and any(can_id in ids for ids in RESTRICTED_CAN_IDS)):
            yield Finding(section.name, f"COB-ID {value:08X}h is restricted or has reserved bits set")
        if valid and can_id in users:
            yield Finding(section.name, f"CAN-ID {can_id:03X}h is also that of [{users[can_id]}]")
        elif valid:
            users[can_id] = section.name


def _holds_cob_id(index: int, sub: int) -> bool:
    if index in (0x1005, 0x1012, 0x1014):
        return True
    if 0x1200 <= index < 0x1300:
        return sub in (1, 2)
    return sub == 1 and is_communication(index)
