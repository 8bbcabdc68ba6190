import re
import tomllib
from pathlib import Path

import pytest

from canfb import CanfbError, eds_files
from canfb.device.od.dictionary import Dictionary
from canfb.eds_files import EdsNotFoundError, eds_path
from documentation import ROOT
from eds_text import DRIVE, INTERFACE, MODULE, NAMES, eds_of
from folding import each

FILES = {name: eds_of(name, 32) for name in NAMES}
TYPES = {"U8": 0x05, "U16": 0x06, "U32": 0x07, "U64": 0x1B, "I8": 0x02, "I16": 0x03, "I32": 0x04, "I64": 0x15}
TYPES |= {"REAL32": 0x08, "STRING": 0x09, "DOMAIN": 0x0F}

# The contract with users, restated, an object a line: a change here breaks their masters. Defaults of several
# sub-indices follow one another; one is that of all.
MODULE_CONTRACT = """
1000:00 U32 ro 0x00040196
1005:00 U32 rw 0x80
1014:00 U32 rw $NODEID+0x80
1017:00 U16 rw 0
1200:01-02 U32 ro $NODEID+0x600 $NODEID+0x580
1201:01-02 U32 rw 0x80000000
1400:01 U32 rw 0x190; 1400:02 U8 rw 255
1401:01 U32 rw $NODEID+0x80000300; 1401:02 U8 rw 255
1600:00 U8 rw 2; 1600:01-02 U32 rw 0x20000110 0x20000210
1601:00 U8 rw 0
1800:01 U32 rw $NODEID+0x40000180; 1800:02 U8 rw 254
1801:01 U32 rw $NODEID+0x280; 1801:02 U8 rw 1
1802:01 U32 rw $NODEID+0xC0000380
1803:01 U32 rw $NODEID+0xC0000480
1A00:00 U8 rw 3; 1A00:01-03 U32 rw 0x60040020 0x20110110 0x20110210
1A01:00 U8 rw 1; 1A01:01 U32 rw 0x60080040
1A02:00 U8 rw 0
1A03:00 U8 rw 0
2000:01-04 I16 rww pdo; 2000:05 U32 rww pdo; 2000:06 U8 rww pdo; 2000:07 U16 rww pdo; 2000:0E I32 rww pdo
2001:01 U32 rw 2500 1..1048576; 2001:02-04 U16 rw 2048 410 2560
2002:01-05 REAL32 rw 0 0 1 1 0
2010:01 U16 rw 21845; 2010:02 REAL32 rw 0; 2010:03 U8 rw 3
2011:01-02 U16 ro pdo; 2011:03 U32 ro pdo; 2011:04 I64 ro pdo; 2011:05-06 U16 ro pdo; 2011:07 REAL32 ro pdo
2011:08 U32 ro pdo
2012:01 U32 ro; 2012:08 U32 ro; 2012:0F U32 ro
2014:01-02 U32 rw 1048576 1; 2014:03 U8 rw 0; 2014:04 REAL32 rw 0; 2014:05 U8 rw 0; 2014:06 REAL32 ro pdo
2020:01 DOMAIN rw; 2020:02 U32 ro; 2020:03 U32 wo; 2020:04 U32 ro; 2020:05 U16 ro; 2020:06 U32 ro
2020:07 DOMAIN ro
6000:00 U16 rw 0
6001:00 U32 rw 20480000
6002:00 U32 rw 4280320000
6003:00 U32 rw 0
6004:00 U32 ro pdo
6008:00 U64 ro pdo
600C:00 U32 ro pdo
6500:00 U16 ro
6501:00 U32 ro 20480000
6502:00 U16 ro 209
6503:00 U16 ro pdo
6504:00 U16 ro 0x1001
6505:00 U16 ro pdo
6506:00 U16 ro 0x3023
6507:00 U32 ro 0x00030302
6508:00 U32 ro
6509:00 I32 ro
650A:01 I32 ro; 650A:03 I32 ro
650B:00 U32 ro
"""
INTERFACE_CONTRACT = """
1000:00 U32 ro 0x00040191
1800:01 U32 rw $NODEID+0x40000180; 1800:02 U8 rw 1
1801:01 U32 rw $NODEID+0x80000280
1A00:00 U8 rw 2; 1A00:01-02 U32 rw 0x64010110 0x64010210
1A01:00 U8 rw 4; 1A01:01-04 U32 rw 0x64010310 0x64010410 0x20000208 0x20000310
2000:01 U32 ro pdo; 2000:02 U8 ro pdo; 2000:03 U16 ro pdo
6401:01-04 I16 ro pdo
"""
DRIVE_CONTRACT = """
1000:00 U32 ro 0x00020192
1400:01 U32 rw $NODEID+0x200; 1400:02 U8 rw 255
1401:01 U32 rw $NODEID+0x300; 1401:02 U8 rw 1
1402:01 U32 rw $NODEID+0x80000400
1403:01 U32 rw $NODEID+0x80000500; 1403:02 U8 rw 255
1600:01-02 U32 rw 0x60400010 0x60600008
1601:01 U32 rw 0x607A0020
1602:00 U8 rw 0
1603:01-03 U32 rw 0x60E40120 0x21100110 0x21100410
1800:01 U32 rw $NODEID+0x40000180; 1800:02 U8 rw 255
1801:01 U32 rw $NODEID+0x40000280; 1801:02 U8 rw 1
1A00:01-03 U32 rw 0x60410010 0x60610008 0x603F0010
1A01:01-02 U32 rw 0x60640020 0x606C0020
6007:00 I16 rw 1 0..3
603F:00 U16 ro pdo
6040:00 U16 rww pdo 0
6041:00 U16 ro pdo
605E:00 I16 rw 2 0..2
6060:00 I8 rww pdo 0
6061:00 I8 ro pdo
6062:00 I32 ro pdo
6063:00 I32 ro pdo
6064:00 I32 ro pdo
6065:00 U32 rw 104858
6066:00 U16 rw 10
606C:00 I32 ro pdo
6072:00 U16 rww pdo 1000
6074:00 I16 ro pdo
6076:00 U32 rw 500
6077:00 I16 ro pdo
607A:00 I32 rww pdo 0
607D:01-02 I32 rw -2147483648 2147483647
6080:00 U32 rw 3000
6085:00 U32 rw 62914560
608F:01-02 U32 rw 1048576 1
60C2:01 U8 rw 1; 60C2:02 I8 rw -3 -6..0
60E4:01 I32 rww pdo
60E6:01 U32 rw 20480000
60EB:01 U32 rw 1
60F4:00 I32 ro pdo
6502:00 U32 ro 0x80
2100:05 U32 rw 10000
2110:01 U16 rww pdo; 2110:02-03 U16 rw 1; 2110:05 U32 rw 4280320000; 2110:06 U8 rw 2
"""


@each("name, line", [
    (name, line)
    for name, table in ((MODULE, MODULE_CONTRACT), (INTERFACE, INTERFACE_CONTRACT), (DRIVE, DRIVE_CONTRACT))
    for line in re.split(r"[;\n] *", table.strip())
])  # fmt: skip
def test_the_contract_is_kept(name: str, line: str) -> None:
    place, data_type, access, *rest = line.split()
    index, _, subs = place.partition(":")
    first, _, last = subs.partition("-")
    limits = [word for word in rest if ".." in word]
    defaults = [word for word in rest if word not in ("pdo", *limits)]
    for count, sub in enumerate(range(int(first, 16), int(last or first, 16) + 1)):
        entry = FILES[name].entries[int(index, 16), sub]
        assert entry.data_type == TYPES[data_type]
        assert entry.access_type == access
        assert entry.pdo_mappable == ("pdo" in rest)
        if defaults or entry.default is not None:
            parts = defaults[min(count, len(defaults) - 1)].split("+")
            assert entry.default == sum(32 if part == "$NODEID" else int(part, 0) for part in parts)
        for limit in limits:
            assert f"{entry.min}..{entry.max}" == limit


def test_the_counters_are_in_the_order_of_the_contract_and_ours_follow() -> None:
    counters = FILES[MODULE].subs(0x2012)
    assert [counters[sub].name for sub in sorted(counters)[1:]] == [
        *("Missed samples", "Residual faults", "Amplitude faults", "Coasted samples"),
        *("Position lost", "Recovered by coarse track", "Zero pulses", "Bad frames"),
        *("Clipped samples", "Frozen samples", "Coarse track disagreements", "Set right by zero pulse"),
        *("Duplicate SYNCs", "SYNCs not heard", "Second position disagreements"),
        *("Last loss cause", "Last loss age", "Last loss bad samples"),
        *("Last loss residual", "Last loss residual limit", "Last loss speed"),
        "Last loss faults",
    ]


def test_versions_agree_with_the_package() -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    major, minor, _ = version.split(".")
    for name in NAMES:
        assert FILES[name].entries[0x100A, 0].default == version
    software_and_profile = FILES[MODULE].entries[0x6507, 0].default
    assert software_and_profile == int(major) << 24 | int(minor) << 16 | 0x0302


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("node_id", [1, 32, 127])
def test_canopen_and_the_device_read_the_same(
    name: str, node_id: int, caplog: pytest.LogCaptureFixture
) -> None:
    theirs, ours = eds_of(name, node_id), Dictionary.load(eds_path(name), node_id)
    assert caplog.text == ""
    assert theirs.entries.keys() == {(entry.index, entry.subindex) for entry in ours}
    for entry in ours:
        variable = theirs.entries[entry.index, entry.subindex]
        assert (variable.name, variable.data_type) == (entry.name, entry.data_type)
        assert variable.access_type == entry.access
        assert variable.pdo_mappable == entry.pdo_mappable
        if variable.default is not None and variable.data_type not in (0x09, 0x0F):
            assert variable.default == entry.default


def test_an_unknown_file_is_refused_with_the_names_there_are() -> None:
    with pytest.raises(
        EdsNotFoundError, match=r"no EDS file motor\.eds in .*canfb-module\.eds, drive\.eds, enc"
    ):
        eds_path("motor")
    assert issubclass(EdsNotFoundError, CanfbError)
    assert issubclass(EdsNotFoundError, FileNotFoundError)


@pytest.mark.parametrize("name", ["", "eds/canfb-module.eds", "../canfb-module", "/canfb-module.eds"])
def test_a_path_is_no_name(name: str) -> None:
    with pytest.raises(ValueError, match="without folders"):
        eds_path(name)


def test_an_installed_package_uses_its_own_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "site-packages" / "canfb"
    (package / "eds").mkdir(parents=True)
    (tmp_path / "eds").mkdir()
    (tmp_path / "eds" / MODULE).touch()
    monkeypatch.setattr(eds_files, "_PACKAGE", package)
    with pytest.raises(EdsNotFoundError, match="there is none at all, so reinstall canfb"):
        eds_path(MODULE)
    (package / "eds" / MODULE).touch()
    assert eds_path(MODULE) == package / "eds" / MODULE
