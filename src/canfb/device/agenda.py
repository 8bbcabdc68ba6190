"""When each service is due: the services with a timer, and the earliest of their deadlines."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable

from canfb.device.moment import NEVER


class Agenda:
    """The services with a timer, in the order in which they are called when several are due.

    A host asks for the deadline at every frame, and few frames move one: so the earliest is kept
    until a service says that its own has moved.
    """

    __slots__ = ("_services", "earliest", "moved")

    def __init__(self) -> None:
        self._services: tuple[Timed, ...] = ()
        self.earliest = NEVER
        """The earliest deadline, seconds, unless one has :attr:`moved` since."""
        self.moved = True

    def fill(self, services: Iterable[Timed]) -> None:
        """The services from now on."""
        self._services = tuple(services)
        for service in self._services:
            service.agenda = self
        self.moved = True

    def due(self) -> float:
        """The earliest deadline, seconds; NEVER if none waits."""
        if self.moved:
            self.earliest = min([service.deadline for service in self._services], default=NEVER)
            self.moved = False
        return self.earliest

    def tick(self, now: float) -> None:
        """Call the services that are due at `now` (seconds, monotonic)."""
        if self.due() <= now:
            for service in self._services:
                if service.deadline <= now:
                    service.tick(now)


class Timed(ABC):
    """A service with a timer: `deadline` is when it wants `tick`, seconds, NEVER for not at all."""

    agenda = Agenda()
    """Where the service is listed; as long as it is nowhere, one that is never asked."""
    _deadline = NEVER

    @property
    def deadline(self) -> float:
        """Time of the next `tick`, seconds; NEVER: none."""
        return self._deadline

    @deadline.setter
    def deadline(self, due: float) -> None:
        if due != self._deadline:
            self._deadline = due
            self.agenda.moved = True

    @abstractmethod
    def tick(self, now: float) -> None:
        """Do what is due at `now` (seconds, monotonic) and move the deadline on."""
