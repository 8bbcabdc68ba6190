"""Check EDS files for what `dcfchk` (dcf-tools) and `eds-validate` (eds-utils) do not see.

    python -m tools.eds.check [-n NODE_ID] [FILE ...]

Those two know the form of the file: sections, keys, lists of objects that exist, counters, data types, values
in their range. This one adds lengths and order (CiA 306), and CiA 301: types and access of the objects below
2000h, PDO parameters and mappings, COB-IDs. Without FILE, all files of the eds folder are checked. One line
per finding, `file:section: text`; exit status 1 if there is any.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Iterator
from datetime import datetime
from pathlib import Path

from tools.eds.model import (
    ARRAY,
    BITS,
    DOMAIN,
    DOMAIN_TYPE,
    RECORD,
    UNSIZED_TYPES,
    VAR,
    Eds,
    Entry,
    Finding,
    Section,
    is_mapping,
    number_of_type,
    read,
)
from tools.eds.pdo import PDO_ACCESS, PDO_COUNT, check_cob_ids, check_pdos
from tools.eds.standard import check_companions, check_standard_entries, standard_kind, standard_type

FILE_VERSIONS = ("FileVersion", "FileRevision")
DEVICE_INFO_TEXTS = {"VendorName": 244, "ProductName": 243, "OrderCode": 245}
LONGEST_LINE = 255
LONGEST_NAME, LONGEST_COMMENT = 241, 249  # characters: with key and equals sign a line has 255
IDENTITY = ("VendorNumber", "ProductNumber", "RevisionNumber")  # in the order of 1018h
DEVICE_INFO_FLAGS = (
    "SimpleBootUpMaster",
    "SimpleBootUpSlave",
    "GroupMessaging",
    "LSS_Supported",
    "CompactPDO",
)
DEVICE_INFO_HIGHEST = (
    dict.fromkeys(IDENTITY, 0xFFFFFFFF)
    | {f"BaudRate_{rate}": 1 for rate in (10, 20, 50, 125, 250, 500, 800, 1000)}
    | dict.fromkeys(DEVICE_INFO_FLAGS, 1)
    | {"Granularity": 64, "DynamicChannelsSupported": 0xFF, "NrOfRXPDO": 512, "NrOfTXPDO": 512}
)
LISTS = ("MandatoryObjects", "OptionalObjects", "ManufacturerObjects")
SECTIONS = ("FileInfo", "DeviceInfo", "DummyUsage", "Comments")


def check_lines(eds: Eds) -> Iterator[Finding]:
    for count, line in enumerate(eds.text.splitlines(), start=1):
        if not line.isascii() or len(line) > LONGEST_LINE:
            yield Finding(f"line {count}", f"is not ASCII or longer than {LONGEST_LINE} characters")


def check_sections(eds: Eds) -> Iterator[Finding]:
    for name in SECTIONS:
        if name.lower() not in eds.sections:
            yield Finding(name, "section is missing")


def check_file_info(eds: Eds) -> Iterator[Finding]:
    info = eds.section("FileInfo")
    if info.text("FileName") != eds.file_name:
        yield Finding(info.name, f"FileName is not {eds.file_name}")
    for key in FILE_VERSIONS:
        if (info.number(key) or 0) > 0xFF:
            yield Finding(info.name, f"{key} is above 255")
    created, modified = (_time_of(info, event) for event in ("Creation", "Modification"))
    if created is not None and modified is not None and modified < created:
        yield Finding(info.name, "modified before it was created")


def _time_of(info: Section, event: str) -> datetime | None:
    """When the file was made or changed; None for what `eds-validate` refuses."""
    try:
        return datetime.strptime(
            f"{info.text(event + 'Date')} {info.text(event + 'Time')}", "%m-%d-%Y %I:%M%p"
        )
    except ValueError:
        return None


def check_device_info(eds: Eds) -> Iterator[Finding]:
    info = eds.section("DeviceInfo")
    for key, longest in DEVICE_INFO_TEXTS.items():
        if not 0 < len(info.text(key) or "") <= longest:
            yield Finding(info.name, f"{key} is missing or longer than {longest} characters")
    for key, highest in DEVICE_INFO_HIGHEST.items():
        value = info.number(key)
        if value is None or not 0 <= value <= highest:
            yield Finding(info.name, f"{key} is missing or not 0..{highest}")
    if not any(info.number(key) for key in DEVICE_INFO_HIGHEST if key.startswith("BaudRate_")):
        yield Finding(info.name, "no BaudRate is supported")


def check_dummy_usage(eds: Eds) -> Iterator[Finding]:
    usage = eds.section("DummyUsage")
    granularity = eds.section("DeviceInfo").number("Granularity") or 0
    keys = {f"Dummy{data_type:04X}": data_type for data_type in range(1, 8)}
    for key, data_type in keys.items():
        if usage.number(key) not in (0, 1):
            yield Finding(usage.name, f"{key} is missing or not 0 or 1")
        elif usage.number(key) == 1 and BITS[data_type] < granularity:
            yield Finding(usage.name, f"{key} is shorter than Granularity")


def check_comments(eds: Eds) -> Iterator[Finding]:
    comments = eds.section("Comments")
    lines = comments.number("Lines")
    if lines is None or {f"line{count}" for count in range(1, lines + 1)} != comments.values.keys() - {
        "lines"
    }:
        yield Finding(comments.name, "Lines is not the number of the lines, or a line is missing")
    for key, text in comments.values.items():
        if len(text) > LONGEST_COMMENT:
            yield Finding(comments.name, f"{key} is longer than {LONGEST_COMMENT} characters")


def check_lists(eds: Eds) -> Iterator[Finding]:
    for name in LISTS:
        section, last = eds.section(name), 0
        for key in sorted(section.values.keys() - {"supportedobjects"}, key=_place):
            index = section.number(key)
            if index is not None and index < last:
                yield Finding(name, f"{key}={section.text(key)} is not in ascending order")
            last = index or last


def _place(key: str) -> tuple[int, str]:
    """Sorts `10` behind `9`, and what is no number first."""
    return (int(key), key) if key.isdecimal() else (0, key)


def _check_name(section: Section) -> Iterator[Finding]:
    name = section.text("ParameterName")
    if name is None:
        yield Finding(section.name, "ParameterName is missing")
    elif len(name) > LONGEST_NAME:
        yield Finding(section.name, f"ParameterName is longer than {LONGEST_NAME} characters")


def check_objects(eds: Eds) -> Iterator[Finding]:
    for index, section in eds.objects.items():
        kind, subs = section.object_type, eds.subs(index)
        yield from _check_name(section)
        if kind in (ARRAY, RECORD):
            yield from _check_subs(index, subs)
        elif kind not in (VAR, DOMAIN):
            yield Finding(section.name, f"ObjectType={section.text('ObjectType')} is not one of ours")
        elif subs:
            yield Finding(section.name, "a VAR or DOMAIN has no sub-indices")
        if kind != standard_kind(index, kind):
            yield Finding(section.name, f"CiA 301 gives it ObjectType=0x{standard_kind(index, kind):X}")


def _check_subs(index: int, subs: dict[int, Entry]) -> Iterator[Finding]:
    # 1003h:00 counts errors, and :00 of a mapping counts what is mapped: neither is the highest sub-index.
    counts = index == 0x1003 or is_mapping(index)
    if 0 in subs and not counts and subs[0].section.number("DefaultValue") != max(subs):
        yield Finding(subs[0].section.name, f"DefaultValue is not {max(subs)}, the highest sub-index")


def check_entries(eds: Eds) -> Iterator[Finding]:
    for entry in eds.entries.values():
        section = entry.section
        if section is not eds.objects.get(entry.index):
            yield from _check_name(section)
        if section.text("ObjFlags") is not None and section.number("ObjFlags") not in range(4):
            yield Finding(section.name, "ObjFlags is not 0..3")
        if entry.data_type not in BITS and entry.data_type not in UNSIZED_TYPES:
            continue
        if section.object_type != (DOMAIN if entry.data_type == DOMAIN_TYPE else VAR):
            yield Finding(section.name, "ObjectType does not fit DataType")
        of_standard = standard_type(entry)
        if entry.data_type != of_standard:
            yield Finding(section.name, f"CiA 301 gives it DataType=0x{of_standard:04X}")
        yield from _check_direction(eds, entry)
        yield from _check_values(entry)


def _check_direction(eds: Eds, entry: Entry) -> Iterator[Finding]:
    section = entry.section
    if entry.data_type == DOMAIN_TYPE:
        if section.text("PDOMapping") is not None:  # npm canopen refuses an EDS in which a DOMAIN has it
            yield Finding(section.name, "PDOMapping is not for a DOMAIN")
    elif section.number("PDOMapping") not in (0, 1):
        yield Finding(section.name, "PDOMapping is missing or not 0 or 1")
    if not entry.mappable:
        if entry.access in ("rww", "rwr"):
            yield Finding(section.name, f"AccessType={entry.access} is for PDO mapping, but PDOMapping=0")
        return
    if entry.data_type not in BITS:
        yield Finding(section.name, f"{UNSIZED_TYPES[entry.data_type]} cannot be mapped into a PDO")
    if entry.access == "rw":
        yield Finding(section.name, "AccessType=rw gives no PDO direction: rww for RPDO, rwr for TPDO")
    key = PDO_COUNT["RPDO" if entry.access in PDO_ACCESS["RPDO"] else "TPDO"]
    if eds.section("DeviceInfo").number(key) == 0:
        yield Finding(section.name, f"PDOMapping=1 with AccessType={entry.access}, but {key}=0")


def _check_values(entry: Entry) -> Iterator[Finding]:
    section, default = entry.section, entry.section.text("DefaultValue")
    if entry.data_type not in BITS:
        octets = not UNSIZED_TYPES[entry.data_type].endswith(("VISIBLE_STRING", "UNICODE_STRING"))
        if octets and not re.fullmatch(r"([0-9A-Fa-f]{2})*", default or ""):
            yield Finding(section.name, "DefaultValue is not a row of hexadecimal bytes")
        return
    for key in ("LowLimit", "HighLimit"):
        text = section.text(key)
        if text is not None and number_of_type(text, entry.data_type) is None:
            yield Finding(section.name, f"{key}={text} is not a plain number of its data type")


CHECKS: tuple[Callable[[Eds], Iterator[Finding]], ...] = (
    *(check_lines, check_sections, check_file_info, check_device_info, check_dummy_usage, check_comments),
    *(check_lists, check_objects, check_entries, check_standard_entries, check_companions),
    *(check_pdos, check_cob_ids),
)


def check_text(text: str, file_name: str, node_id: int = 32) -> list[Finding]:
    """All findings of one EDS text. COB-IDs are compared as they are at `node_id` (1..127)."""
    try:
        eds = read(text, file_name, node_id)
    except ValueError as error:
        return [Finding(file_name, str(error))]
    return [finding for check in CHECKS for finding in check(eds)]


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tools.eds.check", description="Check EDS files against CiA 306 and CiA 301."
    )
    parser.add_argument("-n", "--node-id", type=int, default=32, choices=range(1, 128), metavar="1..127")
    parser.add_argument("files", nargs="*", type=Path, metavar="FILE", help="default: all of the eds folder")
    options = parser.parse_args(arguments)
    files = options.files or sorted((Path(__file__).parents[2] / "eds").glob("*.eds"))
    found = False
    for path in files:
        for finding in check_text(path.read_text(encoding="latin-1"), path.name, options.node_id):
            print(f"{path}:{finding.section}: {finding.text}")
            found = True
    return 1 if found or not files else 0


if __name__ == "__main__":
    sys.exit(main())
