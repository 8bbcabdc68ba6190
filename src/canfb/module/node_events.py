"""What happens in any node of ours becomes events: its NMT state, its errors, what it saves."""

from __future__ import annotations

from collections.abc import Callable

from canfb import objects as od
from canfb.cia301.codes import emergency_text
from canfb.cia301.nmt import NmtState
from canfb.device.application import Application, Groups
from canfb.device.storage.image import ParameterGroup
from canfb.module.event import Event, EventKind


class NodeEvents(Application):
    """Calls ``on_event`` with each :class:`.Event`; without it nothing is made.

    ``detailed``: each EMCY, too.
    """

    def __init__(self) -> None:
        self.on_event: Callable[[Event], None] | None = None
        self.detailed = False

    def state_changed(self, old: NmtState, new: NmtState, now: float, why: str) -> None:
        """A change of the NMT state, and ``why`` if it was not commanded."""
        boot_up = "boot-up, " if old is NmtState.INITIALISING else ""
        name = new.name.replace("_", "-")
        text = f"{boot_up}{name}{': ' if why else ''}{why}"
        self._tell(EventKind.NMT, now, text, state=name, boot_up=bool(boot_up), reason=why or None)

    def emergency_sent(self, code: int, register: int, detail: bytes, now: float) -> None:
        """An EMCY goes out."""
        if self.detailed:
            words = emergency_text(code, od.EMERGENCY_TEXTS)
            text = f"EMCY {code:04X}h sent ({words}), 1001h {register:02X}h, detail {detail.hex(' ')}"
            self._tell(EventKind.EMCY, now, text, code=code, register=register, detail=detail.hex())

    def parameters_saved(self, saved: Groups, forgotten: Groups, now: float) -> None:
        """Parameters were saved, or their defaults loaded."""
        for groups, what in ((saved, "saved"), (forgotten, "dropped, the defaults come with the next reset")):
            names = [group.name.lower() for group in groups if group is not ParameterGroup.OPERATING_TIME]
            if names:
                text = f"parameters {what}: {', '.join(names)}"
                self._tell(EventKind.SAVED, now, text, groups=names, dropped=groups is forgotten)

    def saving_failed(self, groups: Groups, reason: str, now: float) -> None:
        """Parameters could not be saved, or their defaults not loaded: the store has what it had."""
        names = [group.name.lower() for group in groups if group is not ParameterGroup.OPERATING_TIME]
        if names:
            text = f"parameters not saved ({reason}): {', '.join(names)}"
            self._tell(EventKind.SAVE_FAILED, now, text, groups=names, reason=reason)

    def _tell(
        self, kind: EventKind, now: float, text: str, **values: bool | float | int | str | list[str] | None
    ) -> None:
        if self.on_event is not None:
            self.on_event(Event(kind, now, text, values))
