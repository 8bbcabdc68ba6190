"""What the checkers of others say of our EDS files: nothing, but what stands in KNOWN."""

from pathlib import Path

import pytest

from canfb.eds_files import eds_path
from eds_text import NAMES
from processes import python

DCFCHK = ("-W", "always", "-c", "import sys; from dcf.cli import main; sys.exit(main())", "-n", "32")
EDS_VALIDATE = ("-c", "import sys; from eds_utils.eds_validate import eds_validate; sys.exit(eds_validate())")

# CiA 306 has the key that eds-validate calls unknown: not for a download.
NOT_FOR_A_DOWNLOAD = ("2020sub3 2030sub1 2040sub2 2040sub3 2050sub1 6003 6009", "2050sub1 2060", "")
KNOWN = {
    name: {f'AUTO-FIXED: Unknown entry "ObjFlags" in [{section}]' for section in sections.split()}
    for name, sections in zip(NAMES, NOT_FOR_A_DOWNLOAD, strict=True)
}

TRANSLATED = {"ObjectType=0x2\n": "ObjectType=0x7\n", "DataType=0x000F\n": "DataType=0x0009\n"}
"""eds-validate 0.3.1 ends with a traceback on an object of type DOMAIN (0x2, CiA 306): it reads the file
with a string in place of each."""


def complaints(command: tuple[str, ...], path: Path) -> set[str]:
    done = python(*command, str(path))
    lines = {line.strip() for line in (done.stdout + done.stderr).splitlines() if line.strip()}
    assert bool(done.returncode) <= bool(lines), "it failed without a word"
    return lines


@pytest.mark.parametrize("name", NAMES)
def test_dcfchk_has_nothing_new_to_say(name: str) -> None:
    assert complaints(DCFCHK, eds_path(name)) == set()


def test_dcfchk_would_say_it(tmp_path: Path) -> None:
    text = eds_path(NAMES[0]).read_text(encoding="ascii")
    path = tmp_path / NAMES[0]
    path.write_text(text.replace("SupportedObjects=3", "SupportedObjects=4"), encoding="ascii")
    assert any("entry 4 missing in [MandatoryObjects]" in message for message in complaints(DCFCHK, path))


def translated(name: str, folder: Path) -> Path:
    """A copy that eds-validate can read."""
    text = eds_path(name).read_text(encoding="ascii")
    for ours, theirs in TRANSLATED.items():
        text = text.replace(ours, theirs)
    (folder / name).write_text(text, encoding="ascii")
    return folder / name


@pytest.mark.parametrize("name", NAMES)
def test_eds_validate_has_nothing_new_to_say(name: str, tmp_path: Path) -> None:
    assert complaints(EDS_VALIDATE, translated(name, tmp_path)) == KNOWN[name]


def test_eds_validate_would_say_it(tmp_path: Path) -> None:
    path = translated(NAMES[0], tmp_path)
    path.write_text(path.read_text().replace("=0x1017\n", "=0x1777\n"), encoding="ascii")
    messages = complaints(EDS_VALIDATE, path)
    assert any("0x1777 was missing" in message for message in messages)
    assert any("0x1017 was in [OptionalObjects]" in message for message in messages)
