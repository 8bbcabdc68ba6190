"""Changes on their way into a store, which takes its time: some milliseconds on a flash or a disk.

A store that writes at once answers at once. A :class:`BackgroundStore` begins to write and is asked later
whether it is done: the node goes on meanwhile, and the answer to SDO or LSS follows when the values are kept.
Time is an argument here; the thread is that of the store (:mod:`canfb.hosting.state_files`).
"""

from __future__ import annotations

import errno
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol, runtime_checkable

from canfb.device.agenda import Timed
from canfb.device.moment import NEVER
from canfb.device.storage.image import ParameterGroup

POLL_S = 0.002  # from one question whether it is done to the next
MOST_WAITING = 4  # changes that a store may have before it; a peer that sends more is refused

Changes = Mapping[ParameterGroup, bytes | None]
Done = Callable[[OSError | None], None]
"""Called when a change is kept, or with the reason why it is not."""


class Store(Protocol):
    """Memory that outlives the power. What it keeps are bytes, which the device makes and checks."""

    def load(self) -> Mapping[ParameterGroup, bytes | OSError]:
        """What is kept, by group; an OSError for a group that is there and cannot be read."""

    def save(self, changes: Changes) -> None:
        """Keep these groups, or forget those that are None: all of them or, with an OSError, none."""


@runtime_checkable
class BackgroundStore(Store, Protocol):
    """A store that writes while the device goes on."""

    def begin(self, changes: Changes) -> None:
        """Begin to keep `changes`, as `save`, behind those that were begun before. It does not wait."""

    def ended(self) -> Sequence[OSError | None]:
        """What has ended since the last call, in order: None for kept, or why it was not."""


class Writing(Timed):
    """Gives changes to a store, one after the other, and says when each is kept.

    `now()` is the time of the running call, seconds.
    """

    def __init__(self, store: Store, now: Callable[[], float]) -> None:
        self.deadline = NEVER
        self._store = store
        self._background = store if isinstance(store, BackgroundStore) else None
        self._now = now
        self._waiting: deque[Done] = deque()

    @property
    def is_busy(self) -> bool:
        """Whether a change is on its way."""
        return bool(self._waiting)

    def write(self, changes: Changes, done: Done) -> None:
        """Keep `changes` and call `done`, in this call or in a later :meth:`tick`. EBUSY if too many wait."""
        if self._background is not None:
            if len(self._waiting) >= MOST_WAITING:
                done(OSError(errno.EBUSY, "the store is still writing"))
                return
            self._background.begin(changes)
            self._waiting.append(done)
            self.deadline = self._now() + POLL_S
            return
        try:
            self._store.save(changes)
        except OSError as error:
            done(error)
        else:
            done(None)

    def tick(self, now: float) -> None:
        """Ask the store whether it is done."""
        ended = () if self._background is None else self._background.ended()
        for error in ended:
            self._waiting.popleft()(error)
        self.deadline = now + POLL_S if self._waiting else NEVER
