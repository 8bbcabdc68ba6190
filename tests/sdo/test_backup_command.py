"""`canfb backup` and docs/storage.md: what is written is proven, or all is as it was before."""

import contextlib
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from canfb import Conditioning, Frame, eds_path
from canfb.cia301 import datatypes
from canfb.cia301.codes import NmtState
from canfb.cia301.datatypes import DataType
from canfb.cli import node_command
from canfb.device.storage.storage import MemoryStore
from canfb.master.access import CommissioningError
from canfb.master.all_or_nothing import put_in_force
from canfb.module.device_configuration import configuration_of
from canfb.sdo.backups import Backup, NodeIdentity, backup_text, read_backup
from canfb.sdo.object_description import ObjectDescriptions
from canfb.sdo.sdo_tasks import value_range
from canfb.signal.correction import Correction, CorrectionTable
from commissioning_kit import MODULE_ID, OTHER, TABLE, Bench, running
from documentation import blocks, commands, page
from drawing import examples
from folding import each
from node_commands import ANSWER, Commands, between, interrupt, is_write, place_of, refuse_once

NODE = hex(MODULE_ID)
SAVE = "backup", "save", NODE
CHANGED: dict[tuple[int, int], tuple[str, float]] = {
    (0x1017, 0): ("H", 500),
    (0x2010, 3): ("B", 9),
    (0x2010, 2): ("f", 12.5),
    (0x2001, 1): ("I", 1024),
    (0x2001, 5): ("f", 131072.0),
    (0x6310, 1): ("i", -77),
}
"""What makes the module another one than as delivered."""


def module(store: MemoryStore | None = None, **config: Any) -> Bench:
    return Bench(sync=False, operational=False, store=store, config=config)


def set_up(bench: Bench) -> Bench:
    """A module that somebody has set up: table, conditioning, parameters, another COB-ID and mapping."""
    for place, (layout, value) in CHANGED.items():
        bench.access.write(*place, layout, value)
    used = Conditioning(3.5, -2.0, 1.0, 1.03125, 0.0078125, cosine_delay_s=2.0**-20, delay_s=2.0**-19)
    put_in_force(bench.access, Correction(TABLE, used))
    access = bench.access
    access.write(0x1801, 1, "I", 0x80000000)
    access.write(0x1A01, 0, "B", 0)
    access.write(0x1A01, 1, "I", 0x20110420 + 0x20)
    access.write(0x1A01, 0, "B", 1)
    access.write(0x1801, 1, "I", 0x2F0)
    return bench


def values(bench: Bench) -> dict[tuple[int, int], Any]:
    return configuration_of(bench.module).values()


@pytest.fixture
def file(canfb: Commands, tmp_path: Path) -> Path:
    """The backup of such a module."""
    path = tmp_path / "backup.yaml"
    canfb(set_up(module()), "backup", "save", NODE, path)
    return path


def test_a_spare_module_becomes_the_one_of_the_backup(canfb: Commands, tmp_path: Path) -> None:
    first, path = set_up(module(serial_number=4711)), tmp_path / "backup.yaml"
    out, _ = canfb(first, "backup", "save", NODE, path)
    count = len(values(first)) - 2  # without the table and its activation
    assert f"serial number 4711, {count} parameters, table {TABLE.crc32:08X}h, 64 entries" in out
    spare = module(MemoryStore(), adc_bits=16, coast_samples=1, serial_number=4712)
    assert values(spare) != values(first)
    out, _ = canfb(spare, "backup", "restore", path, "--save")
    assert values(spare) == values(first)
    assert spare.module.chain.correction == first.module.chain.correction
    assert "2010:03 Supervision: Samples to coast: 1 -> 9 samples" in out
    assert f"correction table: none -> {TABLE.crc32:08X}h" in out
    assert "verified by reading all of them back\nsaved (1010:01)\n" in out
    assert "note: the backup is of serial number 4711, this module has 4712" in out
    spare.module.receive(Frame(0, b"\x81\x20"), 1.0)
    assert values(spare) == values(first), "after a reset"
    out, _ = canfb(spare, "backup", "restore", path)
    assert "all values are those of" in out


def test_a_person_reads_it(file: Path) -> None:
    lines = file.read_text().splitlines()
    for wanted in (
        "identity: {vendor: 0, product: 1, revision: 1, serial_number: 0}",
        '  "1801:01": 0x000002F0             # COB-ID used by TPDO',
        '  "2010:02": 12.5                   # Largest acceleration, rad/s^2',
        '  "1017:00": 500                    # Producer heartbeat time, ms',
        '  "6310:01": -77                    # Cam 1 low limit channel 1, measuring units',
        "  # Supervision",
    ):
        assert wanted in lines


def test_another_node_id_takes_its_own_can_ids(canfb: Commands, file: Path) -> None:
    bench = module()
    before = values(bench)
    other = Path(str(file).replace("backup", "other"))
    text = file.read_text().replace("node_id: 32\n", "node_id: 5\n")
    for ours, theirs in (
        ("0x400001A0", "0x40000185"),
        ("0x000000A0", "0x00000085"),
        ("0xC00003A0", "0xC0000385"),
    ):
        assert ours in text
        text = text.replace(ours, theirs)
    other.write_text(text)
    canfb(bench, "backup", "restore", other, NODE)
    after = values(bench)
    for place in ((0x1800, 1), (0x1014, 0), (0x1802, 1)):
        assert after[place] == before[place], "the default of the node"
    assert after[0x1801, 1] == 0x2F0, "chosen by somebody"


def test_dry_run_writes_nothing(canfb: Commands, file: Path) -> None:
    bench = module()
    before = values(bench)
    said = canfb(bench, "backup", "restore", file, "--dry-run", "--json").json
    assert said["changed"]["2010:03"] == [3, 9]
    assert (said["written"], said["saved_as"]) == (False, None)
    assert values(bench) == before
    out, _ = canfb(bench, "backup", "restore", file, "--dry-run")
    assert "nothing was written" in out


def swallow(bench: Bench) -> None:
    """A value is taken, and not kept."""

    def taken(frame: Frame) -> list[Frame] | None:
        is_meant = is_write(frame) and place_of(frame) == (0x2010, 3)
        return [Frame(ANSWER, b"\x60" + frame.data[1:4] + bytes(4))] if is_meant else None

    between(bench, taken)


@pytest.mark.parametrize(
    ("spoil", "code", "words"),
    [
        (swallow, 1, "not as written: 2010:03 is 3, not 9; the parameters"),
        (lambda bench: interrupt(bench, 600), 130, "canfb: interrupted; an unfinished change is undone\n"),
        (lambda bench: refuse_once(bench, (0x1801, 1)), 1, "writing 1801:01 is refused"),
    ],
)
def test_a_restore_that_fails_brings_back_what_was(
    canfb: Commands, file: Path, spoil: Callable[[Bench], object], code: int, words: str
) -> None:
    """And puts nothing in force that waited."""
    bench = module()
    put_in_force(bench.access, Correction(OTHER, Conditioning(sine_gain=1.25)))
    before, used = values(bench), bench.module.chain.correction
    bench.access.write(0x2002, 3, "f", 2.0)
    spoil(bench)
    assert words in canfb(bench, "backup", "restore", file, code=code)[1]
    assert (values(bench), bench.module.chain.correction) == (before, used)


def test_a_machine_that_runs_is_left_alone(canfb: Commands, file: Path) -> None:
    bench = running(0.2)
    before = values(bench)
    _, err = canfb(bench, "backup", "restore", file, code=1)
    assert "module 32 (20h) is in OPERATIONAL: a restore switches its PDOs off meanwhile" in err
    assert "give --preop (or canfb node preop 0x20)" in err
    bench.access.write(0x2040, 3, "I", 7)
    bench.access.write(0x2040, 1, "B", 2)
    assert "is locked (2040h)" in canfb(bench, "backup", "restore", file, "--preop", code=1)[1]
    assert (values(bench), bench.module.state) == (before, NmtState.OPERATIONAL)
    bench.access.write(0x2040, 2, "I", 7)
    said = "note: the node is in PRE-OPERATIONAL: canfb node start 0x20"
    assert said in canfb(bench, "backup", "restore", file, "--preop")[0]
    assert (bench.module.state, values(bench)[0x2010, 3]) == (NmtState.PRE_OPERATIONAL, 9)


@each("spoil, code, words", [
    (swallow, 1, "before are in module 32 (20h) again"),
    (lambda bench: interrupt(bench, 600), 130, "canfb: interrupted; an unfinished change is undone"),
])  # fmt: skip
def test_a_machine_that_was_stopped_in_vain_is_said(
    canfb: Commands, file: Path, spoil: Callable[[Bench], object], code: int, words: str
) -> None:
    bench = running(0.2)
    spoil(bench)
    assert canfb(bench, "backup", "restore", file, "--preop", code=code)[1].endswith(
        f"{words}; canfb node start ends the PRE-OPERATIONAL of --preop\n"
    )
    assert bench.module.state is NmtState.PRE_OPERATIONAL


def edit(file: Path, old: str, new: str) -> int:
    """Change the file; the number of the line."""
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))
    return text[: text.index(old)].count("\n") + 1


COAST = "parameters.2010:03: Supervision: Samples to coast must be a whole number 0..255, not"
BAD = {
    "another value": ('"2010:03": 9  ', '"2010:03": 900', f"{COAST} 900"),
    "a type": ('"2010:03": 9  ', '"2010:03": nine', f"{COAST} 'nine'"),
    "a limit": ('"2010:06": 2 ', '"2010:06": 1 ', "SYNC or sample must be a whole number 2..255, not 1"),
    "a real": ('"2010:02": 12.5', '"2010:02": fast', "Largest acceleration must be a number, not 'fast'"),
    "an object": ('"2010:03"', '"2010:63"', "parameters.2010:63: this version has no such parameter"),
    "no object": ('"2010:03"', '"coast"', "parameters.coast: unknown key: an object such as"),
    "a double": ('"2010:03"', "2010:02", "key '2010:02' is already in line"),
    "a key": ("device_name:", "device_nam:", "device_nam: unknown key; known are"),
    "missing": ("device_name:", "# device_name:", "'device_name' is missing"),
    "identity": ("{vendor: 0, ", "{", "identity: 'vendor' is missing"),
    "identity type": ("{vendor: 0, ", "{vendor: x, ", "identity.vendor: must be a whole number 0.."),
    "format": ("canfb_backup: 1", "canfb_backup: 2", "this version reads backups of the format 1, not 2"),
    "table": ("  entries: [", "  entries: [5.0, ", "table.entries: "),
    "crc": ("  crc32: ", "  crc32: 1", "an entry was changed"),
    "no YAML": ("parameters:", "parameters: [", "expected"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_file_names_line_and_key(case: str, canfb: Commands, file: Path) -> None:
    bench = module()
    before = values(bench)
    old, new, words = BAD[case]
    line = edit(file, old, new)
    _, err = canfb(bench, "backup", "restore", file, code=1)
    assert words in err
    assert f"{file}: line " in err
    if case not in ("missing", "no YAML"):
        assert f": line {line}: " in err
    assert values(bench) == before
    assert [frame for frame in bench.master.sent if frame.can_id] == [], "the bus is not asked"


def test_backups_of_other_devices(canfb: Commands, file: Path) -> None:
    edit(file, "product: 1", "product: 3")
    _, err = canfb(module(), "backup", "restore", file, "--force", code=1)
    assert "is product 1 of vendor 0, the backup is of product 3 of vendor 0: it is for another device" in err
    edit(file, "product: 3", "product: 1")
    edit(file, "revision: 1", "revision: 65537")
    bench = module()
    _, err = canfb(bench, "backup", "restore", file, code=1)
    assert (
        "has the major revision 0 (1018:03), the backup is of 1: its objects may mean something else" in err
    )
    edit(file, '"2010:03"', '"2010:63"')
    out, _ = canfb(bench, "backup", "restore", file, "--force")
    assert "note: left out, as this version does not know them: 2010:63" in out
    assert "note: not in the backup, unchanged: 2010:03" in out
    assert (values(bench)[0x2010, 3], values(bench)[0x2010, 2]) == (3, 12.5)


def test_preset_and_offset_are_noted_and_not_restored(canfb: Commands, tmp_path: Path) -> None:
    bench, path = module(), tmp_path / "backup.yaml"
    bench.module.dictionary.entry(0x6509).value = -12
    out, _ = canfb(bench, "backup", "save", NODE, path)
    assert "note: 6509:00 (preset, offset) are in it, but not restored: set the preset again" in out
    assert '  "6509:00": -12 ' in path.read_text()
    spare = module()
    out, _ = canfb(spare, "backup", "restore", path)
    assert "all values are those of" in out
    assert spare.value(0x6509, 0) == 0
    spare.access.write(0x2010, 3, "B", 4)
    canfb(spare, "backup", "restore", path)
    assert (0x2020, 3) not in {place_of(one) for one in spare.master.sent if is_write(one)}, "drift goes on"
    edit(path, "parameters:", 'parameters:\n  "6200:00": 10')
    assert "6200:00: no parameter that a restore writes" in canfb(spare, "backup", "restore", path, code=1)[1]


def test_a_backup_between_upload_and_activation_has_the_set_in_force(canfb: Commands, tmp_path: Path) -> None:
    """2002h and 2005h hold the conditioning of the table that waits: the pair would be one that never was."""
    bench, path = set_up(module()), tmp_path / "backup.yaml"
    before = bench.module.chain.correction
    bench.access.write(0x2002, 1, "f", -100.0)
    bench.access.write(0x2005, 3, "f", 0.25)
    bench.access.download_domain(0x2020, 1, OTHER.to_bytes())
    canfb(bench, "backup", "save", NODE, path)
    assert bench.module.chain.correction == before
    assert bench.access.read(0x2002, 1, "f") == -100.0, "it still waits"
    spare = module()
    canfb(spare, "backup", "restore", path)
    assert spare.module.chain.correction == before
    assert spare.access.read(0x2002, 1, "f") == before.conditioning.sine_offset_counts


def test_an_activation_or_a_restart_while_the_backup_is_read(canfb: Commands, tmp_path: Path) -> None:
    bench, path = set_up(module()), tmp_path / "backup.yaml"

    def activated(frame: Frame) -> list[Frame] | None:
        if place_of(frame) == (0x2020, 1) and not is_write(frame):
            bench.module.chain.activate(Correction(TABLE, Conditioning(sine_gain=1.5)))
        return None

    between(bench, activated)
    assert "the table changed while it was read; try again" in canfb(bench, *SAVE, path, code=1)[1]
    bench = set_up(module())
    between(
        bench, lambda frame: bench.bus.send(Frame(0, b"\x81\x20")) if place_of(frame)[0] == 0x1017 else None
    )
    assert "module 32 (20h) was restarted meanwhile" in canfb(bench, *SAVE, path, code=1)[1]
    assert not path.exists()


PAGE = page("storage").partition("\n## Backup")[2].partition("\n## A file for")[0]


def test_the_commands_of_the_page(canfb: Commands, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("feedback.yaml").write_text("modules: [{node_id: 0x20}]\n")
    bench, given = Bench(store=MemoryStore()), commands(PAGE)
    monkeypatch.setattr(node_command, "open_bus", lambda words: None)
    monkeypatch.setattr(node_command, "BusMaster", lambda bus: contextlib.nullcontext(bench.master))
    assert [words[1] for words in given] == ["save", "restore", "restore", "start"]
    canfb(bench, *given[0])
    bench.access.write(0x2010, 3, "B", 77)
    assert "2010:03 Supervision: Samples to coast: 77 -> 3 samples" in canfb(bench, *given[1])[0]
    assert "saved (1010:01)" in canfb(bench, *given[2])[0]
    assert bench.value(0x2010, 3) == 3
    assert bench.module.state is NmtState.PRE_OPERATIONAL
    canfb(bench, *given[3])
    assert bench.module.state is NmtState.OPERATIONAL


def test_the_file_of_the_page_is_one(tmp_path: Path) -> None:
    path = tmp_path / "backup.yaml"
    (example,) = blocks(PAGE, "yaml")
    path.write_text(example)
    backup = read_backup(path, ObjectDescriptions(eds_path("canfb-module"), 1))
    assert backup.values == {(0x2010, 1): 21845, (0x2010, 2): 12.5, (0x2010, 3): 9}
    assert backup.table == b""


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
    return st.integers(*map(int, value_range(code)))


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
