"""Saving and restoring of parameters: 1010h, 1011h and 1020h (CiA 301, 7.5.2.13, 7.5.2.14, 7.5.2.23).

A :class:`BackgroundStore` writes while the node runs; SDO or LSS is answered when the values are stored.
"""

from __future__ import annotations

import errno
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Protocol, runtime_checkable

from canfb.cia301.codes import AbortCode, SdoAbort
from canfb.device.core import NEVER, Core, Pending, Timed
from canfb.device.od.dictionary import refuse_if
from canfb.device.storage.kept import (
    Identity,
    ImageError,
    KeptEntries,
    ParameterGroup,
    Record,
    decode_image,
    encode_image,
    restore,
)

POLL_S = 0.002  # Interval of asking a background store what it has finished, seconds.
MOST_WAITING = 4  # Changes that may wait in a background store; further commands are refused.

Changes = Mapping[ParameterGroup, bytes | None]
Done = Callable[[OSError | None], None]  # Called when a change is stored (None) or has failed.


class Store(Protocol):
    """Non-volatile memory."""

    def load(self) -> Mapping[ParameterGroup, bytes | OSError]:
        """The stored images by group; OSError for an unreadable one."""

    def save(self, changes: Changes) -> None:
        """Store these groups (None: delete), all or none; OSError if none was stored."""


@runtime_checkable
class BackgroundStore(Store, Protocol):
    """A store that writes while the device runs."""

    def begin(self, changes: Changes) -> None:
        """Begin to store `changes`, after earlier ones."""

    def ended(self) -> Sequence[OSError | None]:
        """Changes ended since the last call, in order: None if stored, or why not."""


SAVE, LOAD, VERIFY = 0x1010, 0x1011, 0x1020
ALL_PARAMETERS = 1
SAVE_SIGNATURE = int.from_bytes(b"save", "little")
LOAD_SIGNATURE = int.from_bytes(b"load", "little")
SAVES_ON_COMMAND = RESTORES = 1

# The groups of 1010h and 1011h.
PARAMETERS = (ParameterGroup.COMMUNICATION, ParameterGroup.APPLICATION, ParameterGroup.MANUFACTURER)


class MemoryStore:
    """A store in memory, for tests and simulations."""

    def __init__(self) -> None:
        self.images: dict[ParameterGroup, bytes] = {}

    def load(self) -> Mapping[ParameterGroup, bytes | OSError]:
        return dict(self.images)

    def save(self, changes: Mapping[ParameterGroup, bytes | None]) -> None:
        keep(self.images, changes)


def keep(images: dict[ParameterGroup, bytes], changes: Mapping[ParameterGroup, bytes | None]) -> None:
    for group, image in changes.items():
        if image is None:
            images.pop(group, None)
        else:
            images[group] = image


class Storage(Timed):
    """The parameters of one device in a `Store`.

    `entries` are the stored parameters. `faults` gives by group the reason why its image was refused: the
    defaults are used until the group is saved or its defaults are loaded. Without a store 1010h reads 0 and
    refuses with 08000020h.
    """

    def __init__(self, core: Core, store: Store | None) -> None:
        self._core = core
        self._dictionary = dictionary = core.dictionary
        self.entries = KeptEntries(dictionary, self.configuration_changed)
        self.faults: dict[ParameterGroup, str] = {}
        self._store = store
        self._background = store if isinstance(store, BackgroundStore) else None
        self._waiting: deque[Done] = deque()
        self._images: dict[ParameterGroup, bytes] = {}
        self._verify = [dictionary.assumed(VERIFY, subindex) for subindex in (1, 2)]
        self._install(SAVE, SAVES_ON_COMMAND if store is not None else 0, SAVE_SIGNATURE, self._save)
        self._install(LOAD, RESTORES, LOAD_SIGNATURE, self._load)
        for entry in self._verify:
            entry.on_download = None

    @property
    def is_there(self) -> bool:
        return self._store is not None

    def power_on(self) -> None:
        self._images, self.faults = {}, {}
        if self._store is None:
            return
        try:
            kept = self._store.load()
        except OSError as error:
            kept = dict.fromkeys(PARAMETERS, error)
        for group, image in kept.items():
            if isinstance(image, OSError):
                self.faults[group] = f"cannot be read: {image.strerror or image}"
            else:
                self._images[group] = image

    def restore(self, *, communication_only: bool = False) -> None:
        """Write the stored values into the dictionary, each group as a whole or not at all."""
        groups = (ParameterGroup.COMMUNICATION,) if communication_only else PARAMETERS
        for group in groups:
            records = self.records(group)
            if records is None:
                continue
            try:
                restore(self.entries, group, records, self._core.node_id)
            except ImageError as error:
                self.refuse(group, str(error))

    def records(self, group: ParameterGroup) -> list[Record] | None:
        """The stored records of a group, or None."""
        image = self._images.get(group)
        if image is None:
            return None
        try:
            return decode_image(image, group, self._identity())
        except ImageError as error:
            self.refuse(group, str(error))
            return None

    def save_records(self, group: ParameterGroup, records: list[Record], done: Done) -> None:
        """Store the records of the caller; `done` gets None, or the error."""
        self._keep({group: encode_image(group, self._identity(), records)}, done)

    def configuration_changed(self) -> None:
        """The configuration of the next power-on has changed: clear 1020h."""
        for entry in self._verify:
            entry.value = 0

    def refuse(self, group: ParameterGroup, reason: str) -> None:
        del self._images[group]
        self.faults[group] = reason

    def report_faults(self) -> None:
        self._core.application.parameters_refused(dict(self.faults), self._core.call.now)

    def _identity(self) -> Identity:
        return Identity(*(int(self._dictionary.assumed(0x1018, part).value) for part in (1, 2, 3)))

    def _install(self, index: int, ability: int, signature: int, command: Callable[[int], None]) -> None:
        for subindex in (ALL_PARAMETERS, *PARAMETERS):
            entry = self._dictionary.assumed(index, subindex)
            entry.on_read = lambda: ability
            entry.on_check = refuse_if(lambda value: value != signature or not ability, AbortCode.NOT_STORED)
            entry.on_written = partial(command, subindex)

    def _save(self, subindex: int) -> None:
        self._command({group: self._image(group) for group in _groups(subindex)}, lambda: None)

    def _load(self, subindex: int) -> None:
        self._command(dict.fromkeys(_groups(subindex)), self.configuration_changed)

    def _image(self, group: ParameterGroup) -> bytes | None:
        records = self.entries.records(group, self._core.node_id)
        return encode_image(group, self._identity(), records) if records else None

    def _command(self, changes: Changes, kept: Callable[[], None]) -> None:
        pending = Pending()

        def done(error: OSError | None) -> None:
            if error is None:
                kept()
                pending.end(None)
            else:
                busy = error.errno == errno.EBUSY
                pending.end(AbortCode.DEVICE_STATE if busy else AbortCode.HARDWARE)

        self._keep(changes, done)
        if not pending.ended:
            self._core.pending = pending
        elif pending.code is not None:
            raise SdoAbort(pending.code)

    def _keep(self, changes: Changes, done: Done) -> None:
        """Store `changes` and call `done`, now or in a later :meth:`tick`. EBUSY if too many wait."""
        # Without groups to delete that are not there; a change that is being written may be of any group.
        changes = {
            group: image
            for group, image in changes.items()
            if image is not None or self._waiting or group in self._images or group in self.faults
        }
        if not changes:
            done(None)
        elif self._background is not None:
            self._begin(self._background, changes, partial(self._written, changes, done))
        elif self._store is not None:  # without one, 1010h and LSS refused already
            try:
                self._store.save(changes)
            except OSError as error:
                self._written(changes, done, error)
            else:
                self._written(changes, done, None)

    def _begin(self, store: BackgroundStore, changes: Changes, written: Done) -> None:
        if len(self._waiting) >= MOST_WAITING:
            written(OSError(errno.EBUSY, "the store is still writing"))
            return
        store.begin(changes)
        self._waiting.append(written)
        self.deadline = self._core.call.now + POLL_S

    def tick(self, now: float) -> None:
        ended = () if self._background is None else self._background.ended()
        for error in ended:
            self._waiting.popleft()(error)
        self.deadline = now + POLL_S if self._waiting else NEVER

    def _written(self, changes: Changes, done: Done, error: OSError | None) -> None:
        now, application = self._core.call.now, self._core.application
        if error is not None:
            application.saving_failed(list(changes), error.strerror or str(error), now)
            done(error)
            return
        mended = [group for group in changes if self.faults.pop(group, None)]
        keep(self._images, changes)
        if mended:
            self.report_faults()
        forgotten = [group for group, image in changes.items() if image is None]
        saved = [group for group in changes if group not in forgotten]
        application.parameters_saved(saved, forgotten, now)
        done(None)


def _groups(subindex: int) -> tuple[ParameterGroup, ...]:
    return PARAMETERS if subindex == ALL_PARAMETERS else (ParameterGroup(subindex),)
