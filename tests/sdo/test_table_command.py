"""`canfb table` and docs/storage.md: from a file to the module and back; what fails leaves it as it was."""

import os
import re
import signal
import tempfile
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given, strategies as st

from canfb.device.storage.storage import MemoryStore
from canfb.master.all_or_nothing import put_in_force, read_active
from canfb.sdo.tables import as_yaml, difference, read_table
from canfb.signal.conditioning import IDENTITY, Conditioning
from canfb.signal.correction import NO_CORRECTION, Correction, CorrectionTable
from commands import yaml_file
from commissioning_kit import MODULE_ID, OTHER, TABLE, Bench, bench_with, running
from documentation import blocks, commands, page
from ideal_tracks import wavy_table
from node_commands import Commands, interrupt, refuse_once

NODE = hex(MODULE_ID)
CONDITIONING = Conditioning(3.5, -2.0, 1.0, 1.03125, 0.0078125)
NEW = Correction(TABLE, CONDITIONING)
OLD = Correction(OTHER, Conditioning(sine_gain=1.25))
FULL = OSError(28, "No space left on device")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    text = as_yaml(NEW, {"date": "2026-03-01", "cycles_per_revolution": 2500})
    return yaml_file(tmp_path, text, "table.yaml")


def in_force(bench: Bench) -> Correction:
    """What the module computes with."""
    return bench.module.chain.correction


def test_upload_stages_and_activate_puts_in_force(canfb: Commands, file: Path) -> None:
    bench = bench_with(OLD, store=MemoryStore())
    out, _ = canfb(bench, "table", "write", NODE, file)
    assert "staged in module 32 (20h), not in force yet: canfb table activate 0x20" in out
    assert "positions move by at most 0.03 cycle (10.8° of the cycle; 16″ of the shaft)" in out
    assert in_force(bench) == OLD
    assert bench.value(0x2020, 2) == TABLE.crc32
    assert "phase +0.0078 rad; in force with the next activation" in canfb(bench, "table", "show", NODE)[0]
    out, _ = canfb(bench, "table", "activate", NODE, "--save")
    assert f"table {TABLE.crc32:08X}h in force in module 32 (20h); saved (1010:04)" in out
    assert in_force(bench) == NEW
    canfb(bench, "sdo", "write", NODE, "2010:0C", "0.005")  # as canfb calibrate does
    out, _ = canfb(bench, "table", "clear", NODE)
    assert bench.value(0x2010, 0xC) == 819, "without the table no phase is that good"
    assert "no table in force in module 32 (20h); not saved: --save keeps it" in out
    assert "the conditioning (2002h) stays" in out
    assert in_force(bench) == Correction(None, CONDITIONING)
    canfb(bench, "table", "clear", NODE, "--conditioning")
    assert in_force(bench) == NO_CORRECTION


@pytest.mark.parametrize("name", ["copy.yaml", "copy.bin"])
def test_down_and_up_again_is_the_same(canfb: Commands, tmp_path: Path, name: str) -> None:
    bench, path = bench_with(NEW), tmp_path / name
    out, _ = canfb(bench, "table", "read", NODE, path)
    assert f"the active table, {TABLE.crc32:08X}h, 64 entries" in out
    assert ("note: " in out) is (name == "copy.bin"), "which has no conditioning"
    canfb(bench, "table", "clear", NODE)
    canfb(bench, "table", "write", NODE, path, "--activate")
    assert in_force(bench) == NEW, "bytes alone leave the conditioning of the module"
    assert read_table(path).cycles_per_revolution == (2500 if name == "copy.yaml" else None)


def test_show_before_and_after_a_save(canfb: Commands, file: Path) -> None:
    bench = bench_with(store=MemoryStore())

    def saved() -> str:
        out, _ = canfb(bench, "table", "show", NODE)
        return next(line.removeprefix("saved").strip() for line in out.splitlines() if "saved" in line)

    assert saved() == "none is saved, none is active"
    canfb(bench, "table", "write", NODE, file, "--activate")
    assert saved() == "no: after a reset the table is none"
    canfb(bench, "table", "activate", NODE, "--save")
    assert saved() == "yes"
    canfb(bench, "table", "clear", NODE)
    assert saved() == f"no: after a reset the table is {TABLE.crc32:08X}h"


def test_show_has_the_figures_of_the_table(canfb: Commands, file: Path) -> None:
    bench = bench_with(NEW)
    of_module = canfb(bench, "table", "show", NODE, "--json").json
    rms = float(np.sqrt(np.mean((TABLE.entries - np.arange(64) / 64) ** 2)))
    assert of_module["deviation_rms_cycles"] == pytest.approx(rms)
    assert of_module["deviation_peak_degrees"] == pytest.approx(3.6, rel=1e-3)
    assert (of_module["crc32"], of_module["entries"]) == (f"{TABLE.crc32:08X}", 64)
    assert (of_module["saved"], of_module["saved_crc32"]) == (False, "00000000")
    of_file = canfb(bench, "table", "show", file, "--json").json
    same = ("crc32", "entries", "deviation_rms_cycles", "conditioning", "cycles_per_revolution")
    assert [of_file[key] for key in same] == [of_module[key] for key in same]
    assert of_file["saved"] is None
    out, _ = canfb(bench, "table", "show", file)
    assert out.splitlines()[0] == str(file)
    assert "deviation, rms   0.00707 cycle (2.55° of the cycle; 3.7″ of the shaft)" in out


def test_a_module_that_does_not_say_what_it_has_saved(canfb: Commands) -> None:
    bench = bench_with(NEW)
    del bench.module.dictionary._entries[0x2020, 6]
    out, _ = canfb(bench, "table", "show", NODE)
    assert "saved            not known: this module does not report it (2020:06)" in out


@pytest.mark.parametrize(
    ("first", "words"),
    [
        (FULL, "module 32 (20h) cannot save: no space left for its parameters"),
        (KeyboardInterrupt, "interrupted; the table and the conditioning from before are in force"),
    ],
)
def test_a_full_disk_is_named_and_the_old_table_is_in_force(
    first: BaseException, words: str, canfb: Commands, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = MemoryStore()
    bench = bench_with(OLD, store=store)
    canfb(bench, "table", "clear", NODE, "--save")
    put_in_force(bench.access, OLD)

    monkeypatch.setattr(store, "save", Mock(side_effect=[first, FULL]))
    _, err = canfb(bench, "table", "write", NODE, file, "--activate", "--save", code=1)
    assert err.startswith(f"canfb: {words}")
    assert "; the table and the conditioning from before are in force in module 32 (20h), and what is" in err
    assert in_force(bench) == read_active(bench.access) == OLD


def test_the_table_of_another_encoder_is_refused(canfb: Commands, tmp_path: Path) -> None:
    bench = running()
    before = in_force(bench)
    path = yaml_file(tmp_path, as_yaml(Correction(TABLE, Conditioning(sine_gain=3.0, cosine_gain=3.0)), {}))
    _, err = canfb(bench, "table", "write", NODE, path, "--activate", code=1)
    assert re.search(r"the amplitude is \d{4} counts, outside 410\.\.2560 .* --force activates it", err)
    assert in_force(bench) == before
    canfb(bench, "table", "write", NODE, path)
    assert "of another encoder" in canfb(bench, "table", "activate", NODE, code=1)[1]
    canfb(bench, "table", "activate", NODE, "--force")
    assert in_force(bench) != before


def test_save_is_refused_before_anything_is_written(canfb: Commands, file: Path) -> None:
    bench = bench_with(OLD)
    _, err = canfb(bench, "table", "write", NODE, file, "--activate", "--save", code=1)
    assert "--save: module 32 (20h) cannot save (1010h; canfb run needs a state_dir for it)" in err
    assert (in_force(bench), bench.value(0x2020, 2)) == (OLD, OTHER.crc32), "as it was put in force here"


def test_nothing_staged(canfb: Commands) -> None:
    _, err = canfb(Bench(sync=False), "table", "activate", NODE, code=1)
    assert "nothing is staged; canfb table write stages" in err


BAD = {
    "a key": ("sine_gain:", "sine_gian:", "line {line}: conditioning.sine_gian: unknown key; known"),
    "a type": ("sine_gain: 1.0", "sine_gain: one",
               "line {line}: sine_gain must be a finite number, not 'one'"),
    "a size": ("sine_offset_counts: 3.5", "sine_offset_counts: 3.5e+38",
               "line {line}: sine_offset_counts must be a finite number, not inf"),
    "a double": ("sine_gain: 1.0", "sine_gain: 1.0\n  sine_gain: 2.0",
                 "line {next}: key 'sine_gain' is already in line {line}"),
    "a number": ("crc32: ", "crc32: 1", "an entry was changed"),
    "entries": ("entries:", "entries: [one]\nothers:", "line {line}: entries: a correction table is a"),
    "no YAML": ("conditioning:", "conditioning: [", "line "),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_a_bad_file_is_one_line_with_key_and_line(case: str, canfb: Commands, file: Path) -> None:
    old, new, words = BAD[case]
    text = file.read_text()
    assert old in text
    line = text[: text.index(old)].count("\n") + 1
    file.write_text(text.replace(old, new, 1))
    bench = bench_with(OLD)
    _, err = canfb(bench, "table", "write", NODE, file, code=1)
    assert f"{file}: this is not a correction table: " in err
    assert words.format(line=line, next=line + 1) in err
    assert read_active(bench.access) == OLD


def test_a_disk_that_is_full_leaves_the_old_file(
    canfb: Commands, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench, path = bench_with(NEW), tmp_path / "table.yaml"
    path.write_text("what was there before")

    monkeypatch.setattr(os, "fsync", Mock(side_effect=FULL))
    _, err = canfb(bench, "table", "read", NODE, path, code=1)
    assert err == f"canfb: {path}: cannot be written: No space left on device\n"
    assert path.read_text() == "what was there before"
    assert [one.name for one in tmp_path.iterdir()] == ["table.yaml"]
    _, err = canfb(bench, "table", "read", NODE, tmp_path / "no" / "table.yaml", code=2)
    assert "there is no folder" in err


def test_an_interruption_puts_back_what_was(canfb: Commands, file: Path) -> None:
    bench = bench_with(OLD)
    interrupt(bench, 30)
    _, err = canfb(bench, "table", "write", NODE, file, "--activate", code=130)
    assert err == "canfb: interrupted; an unfinished change is undone\n"
    assert in_force(bench) == OLD
    canfb.at_end = lambda: signal.raise_signal(signal.SIGTERM)
    assert "in force in module 32" in canfb(bench, "table", "write", NODE, file, "--activate")[0], (
        "it is done"
    )


bumps = st.floats(-0.1875, 0.1875, width=32)


@given(st.integers(16, 200), bumps, st.floats(0.5, 2.0, width=32), bumps)
def test_any_table_file_comes_back(n: int, bump: float, gain: float, offset: float) -> None:
    used = Correction(wavy_table(n, bump / 7), Conditioning(sine_offset_counts=offset, sine_gain=gain))
    text = as_yaml(used, {"cycles_per_revolution": n})
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "table.yaml"
        path.write_text(text)
        found = read_table(path)
    assert (found.used, found.with_conditioning, found.cycles_per_revolution) == (used, True, n)


@given(st.integers(16, 300), bumps)
def test_the_deviation_of_a_table(n: int, bump: float) -> None:
    table = wavy_table(n, bump / 7)
    rms, peak = difference(table, None)
    assert rms == pytest.approx(abs(bump) / 7 / np.sqrt(2), abs=1e-6)
    assert rms <= peak + 1e-12
    assert difference(table, table) == (0.0, 0.0)
    assert difference(None, table) == pytest.approx((rms, peak))
    assert IDENTITY.is_identity


def test_what_waits_is_not_taken_for_what_is_in_force(canfb: Commands, file: Path, tmp_path: Path) -> None:
    """Between upload and activation 2002h and 2005h belong to the next table: 2020:07 is the one in force."""
    bench = bench_with(OLD)
    harmonics = Conditioning(harmonic_2_forward_real=0.0078125)
    path = yaml_file(tmp_path, as_yaml(Correction(TABLE, harmonics), {}), "harmonics.yaml")
    canfb(bench, "table", "write", NODE, path)
    assert bench.access.read(0x2005, 3, "f") == harmonics.harmonic_2_forward_real, "2005h is written, too"
    assert in_force(bench) == read_active(bench.access) == OLD
    shown = canfb(bench, "table", "show", NODE, "--json").json
    assert shown["conditioning"]["sine_gain"] == OLD.conditioning.sine_gain
    assert shown["conditioning_waiting"]["harmonic_2_forward_real"] == harmonics.harmonic_2_forward_real
    refuse_once(bench, (0x2020, 3), 1)
    _, err = canfb(bench, "table", "write", NODE, file, "--activate", code=1)
    assert "are in force in module 32 (20h)" in err
    assert in_force(bench) == OLD, "and not the old table with the conditioning that waited"
    canfb(bench, "table", "write", NODE, path)
    canfb(bench, "table", "clear", NODE)
    assert in_force(bench) == Correction(None, OLD.conditioning)


def test_an_activation_that_fails_leaves_what_waits(canfb: Commands, file: Path) -> None:
    bench = bench_with(OLD, store=MemoryStore())
    canfb(bench, "table", "write", NODE, file)
    refuse_once(bench, (0x2020, 3), 1)
    canfb(bench, "table", "activate", NODE, code=1)
    assert in_force(bench) == OLD
    assert canfb(bench, "table", "show", NODE, "--json").json["conditioning_waiting"] is not None
    refuse_once(bench, (0x1010, 4), 1)
    canfb(bench, "table", "activate", NODE, "--save", code=1)
    assert in_force(bench) == OLD
    assert bench.value(0x2020, 2) == OTHER.crc32, "the old one went the same way back"
    assert canfb(bench, "table", "show", NODE, "--json").json["conditioning_waiting"] is None


def test_settings_with_which_a_table_was_measured_are_compared_and_left(
    canfb: Commands, tmp_path: Path
) -> None:
    """2001h is no part of a table: it acts at once, and on the limits of the amplitude as well."""
    path, bench = tmp_path / "table.yaml", bench_with()
    bench.access.write(0x2001, 5, "f", 20e3)
    noted = {"cycles_per_revolution": 2500, "corner_hz": 159154.94, "cosine_corner_hz": "unknown"}
    path.write_text(as_yaml(NEW, noted))
    out, _ = canfb(bench, "table", "write", NODE, path)
    assert out.count("note: it was measured with") == 1
    assert "2001:05 = 159154.94, module 32 (20h) has 20000: canfb sdo write 0x20 2001:05 159154.94" in out
    assert bench.access.read(0x2001, 5, "f") == 20e3
    bench.access.write(0x2001, 5, "f", 159154.94)
    assert "note:" not in canfb(bench, "table", "write", NODE, path, "--activate")[0]
    canfb(bench_with(), "table", "read", NODE, tmp_path / "other.yaml")
    assert "2001:05 = 0, module" in canfb(bench, "table", "write", NODE, tmp_path / "other.yaml")[0]


PAGE = page("storage").partition("\n## Tables")[2].partition("\n## Backup")[0]


def test_the_commands_of_the_page(canfb: Commands, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    used = Correction(CorrectionTable.identity(64), Conditioning(sine_gain=1.5))
    Path("measured").mkdir()
    Path("measured/table.yaml").write_text(as_yaml(used, {}))
    bench = Bench(sync=False, store=MemoryStore())
    said = [canfb(bench, *words)[0] for words in commands(PAGE)]
    assert in_force(bench) == used
    assert "saved (1010:04)" in said[-1]
    shown = canfb(bench, "table", "show", NODE)[0]
    (example,) = blocks(PAGE, "text")
    assert [line[:17] for line in example.splitlines()[1:]] == [line[:17] for line in shown.splitlines()[1:]]
