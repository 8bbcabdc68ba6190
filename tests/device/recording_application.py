"""An application that keeps what its node tells it, and reacts as a test wants it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from canfb.device.application import Application, ProcessData

METHODS = [name for one in (ProcessData, Application) for name in vars(one) if not name.startswith("_")]


class RecordingApplication(Application):
    """Keeps each call in ``calls``: (name of the method, arguments)."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, tuple[Any, ...]]] = []
        self._reactions: dict[str, Callable[..., Any]] = {
            name: partial(getattr(Application, name), self) for name in METHODS
        }
        for name in METHODS:
            setattr(self, name, partial(self._called, name))

    def told(self, method: str) -> list[Any]:
        """The arguments of each call of this method; of a single one the argument itself."""
        assert method in METHODS
        found = [arguments for name, arguments in self.calls if name == method]
        return [one[0] if len(one) == 1 else one for one in found]

    def react(self, **reactions: Callable[..., Any]) -> None:
        """Call these functions, by the names of the methods."""
        assert reactions.keys() <= set(METHODS)
        self._reactions |= reactions

    def _called(self, name: str, *arguments: Any) -> Any:
        self.calls.append((name, arguments))
        return self._reactions[name](*arguments)
