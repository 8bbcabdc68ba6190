"""SDO server parameters 1200h to 127Fh: which CAN-IDs a server has (CiA 301, 7.5.2.33)."""

from __future__ import annotations

from canfb.cia301 import cob
from canfb.cia301.codes import AbortCode, SdoAbort
from canfb.device.core import Core
from canfb.device.od.dictionary import Dictionary
from canfb.device.od.entry import Entry
from canfb.device.sdo.server import SdoServer

FIRST_INDEX = 0x1200
LAST_INDEX = 0x127F

_DYNAMIC = 1 << 30


class SdoChannel:
    """One SDO server with its two COB-IDs. It exists while both are valid.

    The first channel is always there: 600h and 580h plus node-ID.
    """

    def __init__(self, core: Core, index: int) -> None:
        self._core = core
        self._index = index
        self._request = core.dictionary.find(index, 1)
        self._response = core.dictionary.find(index, 2)
        self.server = SdoServer(core)
        if index != FIRST_INDEX:
            for entry in (self._request, self._response):
                if entry is not None:
                    self._install(entry)
            self.configure()

    @property
    def request_id(self) -> int | None:
        """The CAN-ID that the server listens to, None while the channel does not exist."""
        if self._index == FIRST_INDEX:
            return cob.SDO_REQUEST + self._core.node_id
        if self._request is None or self._response is None:
            return None
        if not (cob.is_valid(self._request.value) and cob.is_valid(self._response.value)):
            return None
        return int(self._request.value & cob.CAN_ID)

    @property
    def response_id(self) -> int | None:
        """The CAN-ID of the answers, None while the channel does not exist."""
        return None if self.request_id is None else self.server.response_id

    def configure(self) -> None:
        """Read the parameters again; a running transfer is given up."""
        self.server.drop()
        if self._index != FIRST_INDEX and self._response is not None:
            self.server.response_id = self._response.value & cob.CAN_ID

    def _install(self, entry: Entry) -> None:
        def check(value: int) -> None:
            if value & _DYNAMIC:
                raise SdoAbort(AbortCode.INVALID_VALUE)
            valid = cob.is_valid(value)
            cob.check(value, entry.value, uses_new=valid, uses_old=cob.is_valid(entry.value))

        def written() -> None:
            self.configure()
            self._core.reactions.routes_changed()

        entry.on_check = check
        entry.on_written = written


def channel_indices(dictionary: Dictionary) -> list[int]:
    """The channels of the device: the first, and those that the dictionary has."""
    further = range(FIRST_INDEX + 1, LAST_INDEX + 1)
    return [FIRST_INDEX, *(index for index in further if (index, 1) in dictionary)]
