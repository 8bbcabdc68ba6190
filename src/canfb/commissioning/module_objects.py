"""The objects of a module of this version, read for its configuration."""

from __future__ import annotations

from canfb.commissioning.access import Master, NodeAccess, ObjectAbsentError
from canfb.errors import CanfbError


class ModuleObjects:
    """The node ``node_id``, by SDO (:class:`canfb.module.read_configuration.Objects`)."""

    def __init__(self, master: Master, node_id: int) -> None:
        self._node = NodeAccess(master, node_id, "node")
        self.node_id = node_id
        self.name = self._node.name

    def number(self, index: int, subindex: int, layout: str) -> int | float:
        """A number, ``layout`` as in struct. CanfbError where the node has no such object."""
        try:
            return self._node.read(index, subindex, layout)
        except ObjectAbsentError as error:
            raise self._other_version(error) from None

    def data(self, index: int, subindex: int) -> bytes:
        """The bytes of any object. CanfbError where the node has no such object."""
        try:
            return self._node.upload_domain(index, subindex)
        except ObjectAbsentError as error:
            raise self._other_version(error) from None

    def _other_version(self, error: ObjectAbsentError) -> CanfbError:
        return CanfbError(f"{error}: the module runs another version of canfb")
