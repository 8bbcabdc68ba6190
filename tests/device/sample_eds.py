"""A small EDS of a device with every service, written out by a table."""

from pathlib import Path

HEAD = """[FileInfo]
FileName=sample.eds
[DeviceInfo]
VendorName=canfb
[DummyUsage]
Dummy0001=1
Dummy0002=1
Dummy0003=1
Dummy0004=1
Dummy0005=1
Dummy0006=1
Dummy0007=1
"""

I8, I16, I32, U8, U16, U32, REAL32, STRING, OCTETS, DOMAIN = 2, 3, 4, 5, 6, 7, 8, 9, 10, 15
BOOLEAN, I64, U64, U24 = 1, 0x15, 0x1B, 0x16

# index, subindex (None: a VAR), data type, access, default, PDO mapping, extra lines
Row = tuple[int, int | None, int, str, str, int]


def rpdo(number: int, cob_id: str, kind: int, mapped: list[int]) -> list[Row]:
    return [
        *_parameter(0x1400 + number - 1, [(1, U32, cob_id), (2, U8, str(kind)), (5, U16, "0")]),
        *_mapping(0x1600 + number - 1, mapped),
    ]


def tpdo(number: int, cob_id: str, kind: int, mapped: list[int]) -> list[Row]:
    subs = [(1, U32, cob_id), (2, U8, str(kind)), (3, U16, "0"), (5, U16, "0"), (6, U8, "0")]
    return [*_parameter(0x1800 + number - 1, subs), *_mapping(0x1A00 + number - 1, mapped)]


def _parameter(index: int, subs: list[tuple[int, int, str]]) -> list[Row]:
    return [
        (index, 0, U8, "ro", str(subs[-1][0]), 0),
        *((index, sub, kind, "rw", default, 0) for sub, kind, default in subs),
    ]


def _mapping(index: int, mapped: list[int]) -> list[Row]:
    values = mapped + [0] * (8 - len(mapped))
    return [
        (index, 0, U8, "rw", str(len(mapped)), 0),
        *((index, sub, U32, "rw", f"0x{value:08X}", 0) for sub, value in enumerate(values, 1)),
    ]


ROWS: list[Row] = [
    (0x1000, None, U32, "ro", "0x00040191", 0), (0x1001, None, U8, "ro", "", 1),
    (0x1003, 0, U8, "rw", "0", 0), *((0x1003, sub, U32, "ro", "", 0) for sub in range(1, 5)),
    (0x1005, None, U32, "rw", "0x80", 0), *((index, None, U32, "rw", "0", 0) for index in (0x1006, 0x1007)),
    (0x1008, None, STRING, "const", "a sample device!", 0), (0x100C, None, U16, "rw", "0", 0),
    (0x100D, None, U8, "rw", "0", 0), (0x1012, None, U32, "rw", "0x100", 0),
    (0x1014, None, U32, "rw", "$NODEID+0x80", 0), (0x1015, None, U16, "rw", "0", 0),
    (0x1016, 0, U8, "ro", "2", 0), *((0x1016, sub, U32, "rw", "0", 0) for sub in (1, 2)),
    (0x1017, None, U16, "rw", "0", 0), (0x1018, 0, U8, "ro", "1", 0), (0x1018, 1, U32, "ro", "0", 0),
    (0x1019, None, U8, "rw", "0", 0), (0x1021, None, DOMAIN, "ro", "", 0),
    (0x1022, None, U16, "ro", "0", 0), (0x1029, 0, U8, "ro", "2", 0),
    *((0x1029, sub, U8, "rw", "0", 0) for sub in (1, 2)), (0x1200, 0, U8, "ro", "2", 0),
    (0x1200, 1, U32, "ro", "$NODEID+0x600", 0), (0x1200, 2, U32, "ro", "$NODEID+0x580", 0),
    (0x1201, 0, U8, "ro", "2", 0), *((0x1201, sub, U32, "rw", "0x80000000", 0) for sub in (1, 2)),
    *rpdo(1, "0x190", 255, [0x20000110, 0x20000210]), *rpdo(2, "$NODEID+0x80000300", 1, []),
    *tpdo(1, "$NODEID+0x40000180", 254, [0x20100120, 0x20100210, 0x20100310]),
    *tpdo(2, "$NODEID+0x280", 1, [0x20100120]), (0x1F80, None, U32, "rw", "4", 0),
    (0x2000, 0, U8, "ro", "7", 0),
    *((0x2000, sub, kind, "rww", "", 1) for sub, kind in enumerate((I16, I16, BOOLEAN, U8, U24, REAL32), 1)),
    (0x2000, 7, U32, "wo", "", 1), (0x2010, 0, U8, "ro", "7", 0),
    *((0x2010, sub, kind, "ro", "", 1) for sub, kind in enumerate((U32, U16, U16), 1)),
    (0x2010, 4, BOOLEAN, "rwr", "", 1), (0x2010, 5, U64, "ro", "", 1), (0x2010, 6, I8, "ro", "", 1),
    (0x2010, 7, I32, "rw", "-5", 1), (0x2020, None, DOMAIN, "rw", "", 0),
    (0x2021, None, STRING, "rw", "text", 0), (0x2022, None, U32, "wo", "", 0),
    (0x2023, None, REAL32, "rw", "1.5", 0), (0x2024, None, OCTETS, "rw", "", 0),
    (0x2025, None, U8, "rw", "", 0), (0x2026, None, U64, "rw", "", 0),
    (0x2027, None, I16, "rw", "0xFFFE", 0), (0x2028, None, BOOLEAN, "rw", "1", 0),
]  # fmt: skip

LIMITS = {0x2023: ("-2.5", "7.25"), 0x2025: ("3", "200"), 0x2027: ("-10", "0x0A")}


def write(path: Path, rows: list[Row] | None = None) -> Path:
    """The EDS of `rows` (default: all of the sample device) in the file `path`."""
    rows = ROWS if rows is None else rows
    lines = [HEAD]
    opened: set[int] = set()
    for index, sub, data_type, access, default, mappable in rows:
        if sub is None:
            section = f"{index:04X}"
        else:
            section = f"{index:04X}sub{sub:X}"
            if index not in opened:
                opened.add(index)
                lines += [f"[{index:04X}]", f"ParameterName=Object {index:04X}", "ObjectType=0x9"]
        kind = 0x2 if data_type == DOMAIN else 0x7
        lines += [
            f"[{section}]",
            f"ParameterName=Entry {index:04X}.{sub or 0}",
            f"ObjectType=0x{kind:X}",
            f"DataType=0x{data_type:04X}",
            f"AccessType={access}",
            f"DefaultValue={default}",
            f"PDOMapping={mappable}",
        ]
        if sub is None and index in LIMITS:
            lines += [f"LowLimit={LIMITS[index][0]}", f"HighLimit={LIMITS[index][1]}"]
    path.write_text("\n".join(lines) + "\n")
    return path
