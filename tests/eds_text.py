"""An EDS file as text and, for its objects, as python canopen reads it."""

import configparser
import io
import re
from collections.abc import Iterator
from functools import cache
from typing import Any

from canopen.objectdictionary import ODVariable
from canopen.objectdictionary.eds import import_eds

from canfb.eds_files import eds_path

NAMES = MODULE, INTERFACE, DRIVE = "canfb-module.eds", "encoder-interface.eds", "drive.eds"
_OBJECT = re.compile(r"(?P<index>[0-9A-F]{4})(?:sub(?P<sub>[0-9A-F]{1,2}))?")


class EdsText:
    """``sections`` by name; ``objects`` of canopen by index; ``entries`` by index and sub-index."""

    def __init__(self, text: str, node_id: int) -> None:
        self.text, self.node_id = text, node_id
        self.sections = configparser.RawConfigParser(delimiters=("=",), comment_prefixes=(";",))
        self.sections.optionxform = str  # type: ignore[assignment, method-assign]
        self.sections.read_string(text)
        dictionary = import_eds(io.StringIO(text), node_id)
        self.objects: dict[int, Any] = {index: dictionary[index] for index in dictionary if index >= 0x1000}
        self.entries: dict[tuple[int, int], ODVariable] = {
            (one.index, one.subindex): one for whole in self.objects.values() for one in _variables(whole)
        }

    def number(self, section: str, key: str) -> int | None:
        """Value of a key; None if it is missing or empty."""
        text = self.sections[section].get(key, "")
        return int(text, 0) if text else None

    def listed(self) -> Iterator[tuple[int, int | None, str]]:
        """Index, sub-index and name of each section of an object."""
        for name in self.sections.sections():
            match = _OBJECT.fullmatch(name)
            if match:
                sub = match["sub"]
                yield int(match["index"], 16), None if sub is None else int(sub, 16), name

    def subs(self, index: int) -> dict[int, ODVariable]:
        """The entries of an ARRAY or RECORD; nothing for a VAR."""
        whole = self.objects.get(index)
        return (
            {}
            if whole is None or isinstance(whole, ODVariable)
            else {one.subindex: one for one in _variables(whole)}
        )


@cache
def eds_of(name: str, node_id: int) -> EdsText:
    """One of our files, parsed once."""
    return EdsText(eds_path(name).read_text(encoding="ascii"), node_id)


def _variables(whole: Any) -> list[ODVariable]:
    return [whole] if isinstance(whole, ODVariable) else [whole[sub] for sub in whole]
