"""The YAML of a backup: any values come back, and any text is a backup or one clear line."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from canfb.cia301 import datatypes
from canfb.cia301.datatypes import DataType
from canfb.master.access import CommissioningError
from canfb.sdo.backups import Backup, NodeIdentity, backup_text, read_backup
from canfb.sdo.object_description import ObjectDescriptions
from canfb.sdo.sdo_tasks import value_range
from canfb.signal.correction import CorrectionTable
from drawing import examples

TYPES = sorted(datatypes.KNOWN)
EDS = "[DeviceInfo]\nProductName=any\nVendorNumber=0\nProductNumber=1\n[ManufacturerObjects]\n" + "".join(
    f";Unit=apples\n[{0x2100 + code:04X}]\nParameterName=Of type {code}\nObjectType=0x7\n"
    f"DataType=0x{code:04X}\nAccessType=rw\nPDOMapping=0\n"
    for code in TYPES
)


def described() -> ObjectDescriptions:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "any.eds"
        path.write_text(EDS)
        return ObjectDescriptions(path, 1)


DESCRIBED = described()
LATIN = st.text(st.characters(max_codepoint=0xFF))


def of_type(code: int) -> st.SearchStrategy[Any]:
    if code in datatypes.FLOATS:
        return st.floats(width=32 if code == DataType.REAL32 else 64, allow_nan=False)
    if code == DataType.BOOLEAN:
        return st.booleans()
    if code in datatypes.STRINGS:
        return LATIN if code == DataType.VISIBLE_STRING else st.text(st.characters(exclude_categories=["Cs"]))
    if code in datatypes.BYTES:
        return st.binary(max_size=40)
    return st.integers(*value_range(code))


VALUES = st.fixed_dictionaries({}, optional={(0x2100 + code, 0): of_type(code) for code in TYPES})


def round_trip(text: str) -> Backup:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "backup.yaml"
        path.write_text(text, encoding="utf-8", newline="\n")
        return read_backup(path, DESCRIBED)


U32 = st.integers(0, 0xFFFFFFFF)


@examples(60)
@given(VALUES, VALUES, st.builds(NodeIdentity, U32, U32, U32, U32), st.integers(1, 127), LATIN, st.booleans())
def test_any_values_come_back(
    values: dict[tuple[int, int], Any],
    others: dict[tuple[int, int], Any],
    identity: NodeIdentity,
    node_id: int,
    name: str,
    with_table: bool,
) -> None:
    raw = np.arange(20) / 20
    table = CorrectionTable(raw + 0.003 * np.sin(raw)).to_bytes() if with_table else b""
    made = Backup(node_id, identity, "2026-11-22", "0.2.0", name, values, table, others)
    assert round_trip(backup_text(made, DESCRIBED)) == made


GOOD = backup_text(Backup(32, NodeIdentity(0, 1, 1, 2), "d", "v", "n", {(0x2105, 0): 7}), DESCRIBED)


@examples(80)
@given(st.integers(0, len(GOOD) - 1), st.integers(0, 12), st.text(max_size=8))
def test_a_damaged_file_is_read_or_refused_in_one_line(at: int, length: int, put: str) -> None:
    for text in (GOOD[:at] + put + GOOD[at + length :], put):
        said = refusal(text.encode("utf-8", "replace").decode())
        assert "\n" not in said


def refusal(text: str) -> str:
    """What is said of it, nothing if it is a backup."""
    try:
        round_trip(text)
    except CommissioningError as error:
        return str(error)
    return ""
