"""The object dictionary: entries by index and sub-index, loaded from an EDS file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from canfb.cia301.codes import AbortCode, SdoAbort
from canfb.cia301.datatypes import DataType
from canfb.device.od.entry import Entry
from canfb.device.od.object_info import ObjectInfo, ObjectKind

STORE_EDS = 0x1021
"""The EDS of the device, in the format that 1022h names (CiA 301, 7.5.2.24)."""

__all__ = ["Dictionary", "Entry", "ObjectInfo", "ObjectKind"]


class Dictionary:
    """The objects of one device (CiA 301, 7.4), in the order of their indices.

    `dummies` are the data types that may fill gaps in an RPDO (CiA 301, 7.4.7).
    """

    def __init__(
        self,
        entries: Iterable[Entry],
        objects: Iterable[ObjectInfo] | None = None,
        dummies: Iterable[int] = (),
    ) -> None:
        self._entries = {
            (entry.index, entry.subindex): entry
            for entry in sorted(entries, key=lambda entry: (entry.index, entry.subindex))
        }
        described = _guess_objects(self._entries) if objects is None else objects
        self._objects = {info.index: info for info in described}
        self.dummies = frozenset(dummies)

    @classmethod
    def load(cls, path: str | Path, node_id: int) -> Dictionary:
        """The objects of an EDS file for node `node_id` (1..127; 255 for none yet), all at their defaults.

        Raises OSError when the file cannot be read, and ValueError that names the section when it
        describes something impossible. ParameterValue of a DCF is not used. The value of 1021h, where
        the file has it, is the file itself. A content is parsed once in a process; each dictionary has
        entries of its own.
        """
        from canfb.device.od import template  # with canopen: loaded by the first dictionary, no sooner

        if not (1 <= node_id <= 127 or node_id == 255):
            raise ValueError(f"node-ID {node_id} is out of range; use 1 to 127, or 255 for none yet")
        described = template.load(Path(path), node_id)
        dictionary = cls(described.fresh_entries(), described.objects, described.dummies)
        stored = dictionary.find(STORE_EDS)
        if stored is not None and stored.data_type == DataType.DOMAIN:
            stored.default = stored.value = described.content
        return dictionary

    def entry(self, index: int, subindex: int = 0) -> Entry:
        """The entry, for code that knows its device. KeyError when there is none."""
        try:
            return self._entries[index, subindex]
        except KeyError:
            raise KeyError(
                f"{index:04X}h:{subindex:02X} is not in this object dictionary; add it to the EDS"
            ) from None

    def find(self, index: int, subindex: int = 0) -> Entry | None:
        """The entry, or None when the device does not have it."""
        return self._entries.get((index, subindex))

    def lookup(self, index: int, subindex: int) -> Entry:
        """The entry, for a request from the bus. SdoAbort when there is none."""
        found = self._entries.get((index, subindex))
        if found is None:
            raise SdoAbort(AbortCode.NO_SUBINDEX if index in self._objects else AbortCode.NO_OBJECT)
        return found

    def __contains__(self, key: tuple[int, int]) -> bool:
        return key in self._entries

    def __iter__(self) -> Iterator[Entry]:
        return iter(self._entries.values())

    def __len__(self) -> int:
        return len(self._entries)

    def objects(self) -> Iterator[ObjectInfo]:
        """What each index holds, ascending."""
        return iter(self._objects.values())

    def change_node_id(self, old: int, new: int) -> None:
        """Make the defaults that have the node-ID in them, and the values that are such defaults, new."""
        for entry in self._entries.values():
            if entry.follows_node_id and isinstance(entry.default, int):
                is_default = entry.value == entry.default
                entry.default += new - old
                if is_default:
                    entry.value = entry.default

    def reset(self, first: int = 0x1000, last: int = 0xFFFF) -> None:
        """Values of the indices `first` to `last`, both included, back to their defaults.

        No hook runs: the services read their parameters again after it.
        """
        for entry in self._entries.values():
            if first <= entry.index <= last:
                entry.reset()


def _guess_objects(entries: Iterable[tuple[int, int]]) -> list[ObjectInfo]:
    """For a dictionary made of entries alone: one sub-index 0 is a VAR, more are a RECORD."""
    subindices: dict[int, list[int]] = {}
    for index, subindex in entries:
        subindices.setdefault(index, []).append(subindex)
    return [
        ObjectInfo(index, "", ObjectKind.VAR if subs == [0] else ObjectKind.RECORD, tuple(subs))
        for index, subs in subindices.items()
    ]
