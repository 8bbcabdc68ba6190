"""Object 6200h: the cyclic timer of CiA 406, another name for the event timer of TPDO1."""

from __future__ import annotations

from canfb.device.od.dictionary import Dictionary
from canfb.device.storage.storage import Storage

CYCLIC_TIMER = 0x6200
EVENT_TIMER = (0x1800, 5)


class CyclicTimer:
    """6200h reads and writes 1800:05, in ms (0 = off), and is saved with it, as a communication parameter."""

    def __init__(self, dictionary: Dictionary, storage: Storage) -> None:
        timer, alias = dictionary.entry(*EVENT_TIMER), dictionary.entry(CYCLIC_TIMER)
        alias.on_read = timer.current
        alias.on_check = timer.check
        alias.on_written = lambda: timer.store(alias.value)
        storage.entries.leave_out(CYCLIC_TIMER)  # one value, kept once
        alias.on_download = storage.configuration_changed
