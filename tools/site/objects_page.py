"""reference/objects.md: the object dictionaries, from the EDS files."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

from canfb.device.od import eds
from canfb.eds_files import eds_path
from canfb.sdo.object_description import ObjectDescription, ObjectDescriptions
from canfb.sdo.sdo_tasks import in_words, type_name, words_of
from tools.site.markdown import plain, table

DEVICES = (
    ("canfb-module", 0x20, "The feedback module"),
    ("encoder-interface", 0x10, "The simulated encoder interface"),
    ("drive", 0x30, "The simulated drive"),
)
AREAS = ((0x6000, "Device profile"), (0x2000, "Manufacturer objects"), (0x1000, "Communication (CiA 301)"))
HEAD = ("object", "name", "type", "access", "PDO", "unit", "default", "range")
INTRODUCTION = """# Object dictionary

All objects of the feedback module, and of the two devices that `canfb simulate` plays. The list is made
from the EDS files in `eds/`, which the programs load at run time. Numbers are hexadecimal where they end in
h. `rwr` and `rww` may be mapped into a TPDO or an RPDO. An empty range is that of the type. An empty
default is a live value, or belongs to the single device. Read and write them by name: [canfb
sdo](../monitor.md#one-object-of-a-node-canfb-sdo); services and error codes: [the CANopen
side](../canopen.md).
"""


def objects_page() -> str:
    return "\n".join([INTRODUCTION, *(line for device in DEVICES for line in _device(*device))]) + "\n"


def _device(name: str, node_id: int, title: str) -> Iterator[str]:
    path = eds_path(name)
    described = ObjectDescriptions(path, node_id)
    details = _Details(path)
    yield from (f"\n## {title}", "", f"`eds/{name}.eds`; defaults with $NODEID depend on the node-ID.", "")
    entries = sorted(described, key=lambda entry: entry.place)
    for area, of_area in groupby(entries, key=lambda entry: _area(entry.index)):
        yield from (f"### {title}: {area}", "")
        yield from table(HEAD, (details.row(entry) for entry in of_area))
        yield ""
    worded = [(entry, list(_words(described.product, entry))) for entry in entries]
    if any(words for _, words in worded):
        yield from (f"### {title}: values in words", "")
        rows = ((f"`{e.number}`", e.title, ", ".join(words)) for e, words in worded if words)
        yield from table(("object", "name", "values"), rows)
    if details.notes:
        yield from ("", f"### {title}: notes in the EDS", "", *(f"- {plain(note)}" for note in details.notes))


def _area(index: int) -> str:
    return next(name for first, name in AREAS if index >= first)


def _words(product: str, entry: ObjectDescription) -> Iterator[str]:
    for word, value in words_of(product, entry.place).items():
        is_bits = value and not value & (value - 1) and in_words(product, entry.place, 0) == "nothing set"
        if value > 0xFFFF:
            yield f"{word} ({value:08X}h)"
        else:
            yield f"bit {value.bit_length() - 1} {word}" if is_bits else f"{value} {word}"


class _Details:
    """What the file says and the descriptions do not hold: default, mapping, comments."""

    def __init__(self, path: Path) -> None:
        self._contents = eds.read(path)
        self._sections = eds.sections(self._contents)
        self.notes = [line for key, line in self._contents.get("Comments", {}).items() if key != "Lines"]

    def row(self, entry: ObjectDescription) -> tuple[str, ...]:
        section = self._contents[self._sections[entry.place]]
        default = section.get("DefaultValue", "").strip()
        limits = (section.get("LowLimit", "").strip(), section.get("HighLimit", "").strip())
        mapped = section.get("PDOMapping", "0").strip() == "1"
        return (
            f"`{entry.number}`",
            plain(entry.title),
            type_name(entry.data_type),
            entry.access,
            "yes" if mapped else "",
            plain(entry.unit),
            f"`{default}`" if default else "",
            "..".join(limits) if any(limits) else "",
        )
