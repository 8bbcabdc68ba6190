"""Files that a fuzzer made: each is refused in one line, or read without what is damaged."""

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest

from canfb import CanfbError, Conditioning, ConfigError, ModuleConfig, eds_path
from canfb.configuration import changed_module, parse_config
from canfb.device.od.dictionary import Dictionary
from canfb.master.samples import read_npz
from canfb.sdo.backups import read_backup
from canfb.sdo.object_description import ObjectDescriptions
from canfb.sdo.tables import as_yaml, read_table
from canfb.signal.correction import Correction, CorrectionTable
from canfb.sources import sample_files
from canfb.sources.recording_source import RecordingLayout, open_recording
from commands import yaml_file
from folding import each

LISTS = [f"&b{n} [{', '.join([f'*b{n - 1}' if n else '0.5'] * 9)}]" for n in range(9)]
BOMB = "x:\n" + "".join(f"- {one}\n" for one in LISTS)
HUGE = "9" * 400


@pytest.mark.parametrize("begin", [BOMB, "x: &b8 [*b8]\n"], ids=["billion", "itself"])
def test_aliases_that_stand_for_any_number_of_values(tmp_path: Path, begin: str) -> None:
    path = yaml_file(tmp_path, f"{begin}entries: *b8\n")
    with pytest.raises(CanfbError, match="more than 100000 values"):
        read_table(path)
    path.write_text(f"{begin}canfb_backup: *b8\n")
    with pytest.raises(CanfbError, match="more than 100000 values"):
        read_backup(path, ObjectDescriptions(eds_path("canfb-module"), 1))
    with pytest.raises(ConfigError, match="more than 100000 values"):
        parse_config(f"{begin}bus: {{channel: *b8}}\nmodules: [{{node_id: 1}}]\n")
    with pytest.raises(ConfigError):
        changed_module(ModuleConfig(node_id=1), [f"residual_limit=[{', '.join(LISTS)}]"])


def test_a_whole_number_that_is_no_float() -> None:
    with pytest.raises(ValueError, match="delay_s must be a finite number"):
        Conditioning(delay_s=int(HUGE))
    source = f"{{kind: recording, file: a.csv, mid_scale: {HUGE}}}"
    with pytest.raises(ConfigError, match=r":3: source: mid_scale must be a finite number"):
        parse_config(f"modules:\n- node_id: 1\n  source: {source}\n")


@each("setting", [
    *("conditioning={sine_offset_counts: " + "9" * 5000 + "}", "node\nid=1", "x" * 5000),
    *("residual_limit='" + "1" * 5000 + "'", "times=!!bool 7", f"adapt=[{'[' * 3000}"),
    *("node_id=!!int ''", "write_lock=\udcff"),
])  # fmt: skip
def test_a_setting_that_cannot_be_is_one_line(setting: str) -> None:
    with pytest.raises(ConfigError) as raised:
        changed_module(ModuleConfig(node_id=1), [setting])
    assert len(str(raised.value).splitlines()) == 1
    assert len(str(raised.value)) < 400


def packed(**arrays: bytes) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in arrays.items():
            archive.writestr(f"{name}.npy", data)
    return file.getvalue()


def array(*values: float) -> bytes:
    file = io.BytesIO()
    np.save(file, np.array(values))
    return file.getvalue()


GOOD = packed(sine=array(*range(500)), cosine=array(*range(500)))
NEWER = GOOD.replace(b"PK\x03\x04\x14", b"PK\x03\x04\x65").replace(
    b"PK\x01\x02\x14\x03\x14", b"PK\x01\x02\x14\x03\x65"
)


@each("data", [
    *(GOOD[:300] + bytes(8) + GOOD[308:], NEWER),
    packed(sine=array(1).replace(b"}", b"("), cosine=array(1)),
    packed(sine=array(1).replace(b"(1,)", b"(10000000000000,)"), cosine=array(1)),
    packed(**{"co\nsine": array(1), "sine": array(1)}),
    packed(sine=array(1), cosine=array(1), rate_hz=array(1, 2)),
    packed(sine=array(1), cosine=array(1), rate_hz=array(np.nan).replace(b"(1,)", b"()  ")),
    array(1),
])  # fmt: skip
def test_a_recording_that_is_none(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "a.npz"
    path.write_bytes(data)
    for read in (read_npz, sample_files.read_tracks):
        with pytest.raises(CanfbError, match=r"this is not a file of samples: .") as raised:
            read(path)
        assert len(str(raised.value).splitlines()) == 1


def test_a_recording_that_unpacks_to_any_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.npz"
    path.write_bytes(GOOD)
    assert len(read_npz(path).sine) == 500
    monkeypatch.setattr(sample_files, "LARGEST_UNPACKED", 8000)
    with pytest.raises(CanfbError, match=r"its arrays have 8256 bytes; at most 8000"):
        read_npz(path)


def test_an_eds_with_many_bad_lines(tmp_path: Path) -> None:
    path = tmp_path / "a.eds"
    path.write_text("[1000]\nParameterName=x\n" + "bad\n" * 500)
    with pytest.raises(ValueError, match="not an EDS: ") as raised:
        Dictionary.load(path, 1)
    assert len(str(raised.value).splitlines()) == 1
    assert len(str(raised.value)) < 400


def test_an_object_with_a_long_name_is_refused_in_a_short_line() -> None:
    described = ObjectDescriptions(eds_path("canfb-module"), 1)
    for name in ("2012:" + HUGE, HUGE):
        with pytest.raises(ConfigError) as raised:
            described.meant(name)
        assert len(str(raised.value)) < 300


@pytest.mark.parametrize("value", ["1e308", "-1e300", "inf", "nan", "0.5"])
def test_a_recording_with_a_time_beyond_any_or_one_that_goes_back(tmp_path: Path, value: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(f"t,s,c\n{value},1,2\n1e-320,3,4\n")
    with pytest.raises(CanfbError, match=":3: .* back" if value == "0.5" else "is not a time in seconds"):
        open_recording(path, RecordingLayout(("s", "c"), 0.0, "t", time_stamps=True, paced=True))


def test_a_recording_with_hardly_a_step_of_time(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("t,s,c\n0,1,2\n1e-320,3,4\n2e-320,3,4\n")
    source = open_recording(path, RecordingLayout(("s", "c"), 0.0, "t", time_stamps=True, paced=True))
    assert [source.next().time_100ns for _ in range(3)] == [0, 0, 0]  # type: ignore[union-attr]


def test_an_entry_of_a_table_that_is_no_float(tmp_path: Path) -> None:
    path = yaml_file(tmp_path, f"entries: [0.0, {HUGE}]\n")
    with pytest.raises(CanfbError, match=r"line 1: .*entries must be less"):
        read_table(path)


@pytest.mark.parametrize("value", ["!!bool 7", "!!int ''", "2023-02-30", "0x_", "9" * 5000])
def test_a_value_of_a_table_that_is_none(tmp_path: Path, value: str) -> None:
    path = yaml_file(tmp_path, f"canfb_table: 1\nmeasured: {value}\n")
    with pytest.raises(CanfbError, match=r"line 2: .*quote text values"):
        read_table(path)


def test_a_long_offset_is_that_of_the_file_that_is_written(tmp_path: Path) -> None:
    text = as_yaml(Correction(CorrectionTable.identity(16)), {})
    path = yaml_file(tmp_path, text.replace("offset_counts: 0.0", f"offset_counts: {2**53 + 1}"))
    used = read_table(path).used
    path.write_text(as_yaml(used, {}))
    assert read_table(path).used == used
