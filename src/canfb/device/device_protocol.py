"""What a host asks of a device: :class:`Device`, and protocols that it may have beside it.

:class:`NodeDevice` has all of them but `Computing`: a node that is its own application.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any, Protocol, runtime_checkable

from canfb.cia301.codes import EmergencyCode, ErrorRegister
from canfb.cia301.frame import Frame
from canfb.cia301.nmt import NmtState
from canfb.device.application import Application, Expiry, Groups
from canfb.device.core import CanIds
from canfb.device.node import Node
from canfb.device.od.dictionary import Dictionary
from canfb.device.storage.image import ParameterGroup
from canfb.device.storage.storage import Store


class Device(Protocol):
    """A sans-I/O device. Times in seconds, monotonic."""

    def start(self, now: float) -> list[Frame]:
        """Power-on at ``now``."""

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        """Take a frame of another device."""

    def tick(self, now: float) -> list[Frame]:
        """Do what is due."""

    def deadline(self) -> float | None:
        """When tick is due."""


@runtime_checkable
class Selective(Protocol):
    """It says what it listens to."""

    def can_ids(self) -> CanIds:
        """The CAN-IDs that it listens to."""

    def follow_can_ids(self, moved: Callable[[], None]) -> None:
        """``moved`` is called when that changes."""


@runtime_checkable
class Ending(Protocol):
    """It has something to do when the program ends."""

    def end(self, now: float) -> None:
        """The program ends."""


@runtime_checkable
class Inhibited(Protocol):
    """Its inhibit times count from when its frames leave."""

    inhibited: Mapping[int | None, object]  # By CAN-ID: the frames for which ``sent`` is called.

    def sent(self, can_id: int, now: float) -> None:
        """A frame of its own has left."""


@runtime_checkable
class BusWatching(Protocol):
    """It is notified when the bus fails and is back."""

    def bus_off(self, now: float) -> list[Frame]:
        """The bus is gone."""

    def bus_back(self, now: float) -> list[Frame]:
        """The bus is back."""


@runtime_checkable
class Computing(Protocol):
    """It has something to compute now and then."""

    def pending_job(self) -> Any:
        """The pending computation, or None."""

    def finish_job(self, job: Any, result: Any, now: float) -> list[Frame]:
        """What came out, or an Exception."""

    def job_progress(self, job: Any, part: float) -> None:
        """How far it is, 0..1."""


class NodeDevice(Node, Application):
    """A node that is its own application, as FeedbackModule and EncoderInterface are.

    The program that runs it may set ``on_parameter_faults`` (groups of stored parameters that were refused,
    and why), ``on_duplicate`` (can_id, now) and ``on_bit_rate`` (kbit_s, delay_s, now), see
    :meth:`Application.bit_rate_activated`.
    """

    register_bits = ErrorRegister.GENERIC  # Bits of 1001h while stored parameters are refused.

    def __init__(
        self,
        dictionary: Dictionary,
        node_id: int,
        *,
        autostart: bool,
        store: Store | None,
        bit_rates_kbit_s: Collection[int],
        expiry: Expiry | None = None,
    ) -> None:
        super().__init__(
            dictionary,
            node_id,
            self,
            expiry=expiry,
            autostart=autostart,
            store=store,
            bit_rates_kbit_s=bit_rates_kbit_s,
        )
        self.observer = Application()  # Gets the NMT state, EMCY and saved parameters as well.
        self.on_parameter_faults: Callable[[Mapping[ParameterGroup, str]], None] = lambda faults: None
        self.on_duplicate: Callable[[int, float], None] = lambda can_id, now: None
        self.on_bit_rate: Callable[[int, float, float], None] = lambda kbit_s, delay_s, now: None

    @property
    def node(self) -> Node:
        return self

    # Application: called by the node.

    def state_changed(self, old: NmtState, new: NmtState, now: float, why: str) -> None:
        self.observer.state_changed(old, new, now, why)

    def emergency_sent(self, code: int, register: int, detail: bytes, now: float) -> None:
        self.observer.emergency_sent(code, register, detail, now)

    def parameters_saved(self, saved: Groups, forgotten: Groups, now: float) -> None:
        self.observer.parameters_saved(saved, forgotten, now)

    def saving_failed(self, groups: Groups, reason: str, now: float) -> None:
        self.observer.saving_failed(groups, reason, now)

    def parameters_refused(self, faults: Mapping[ParameterGroup, str], now: float) -> None:
        """EMCY 6310h, with the groups; and to the program."""
        if faults:
            groups = bytes(sorted(faults))[:5]
            self.emergency(EmergencyCode.DATA_SET, self.register_bits, groups, now)
        else:
            self.clear_emergency(EmergencyCode.DATA_SET, now)
        self.on_parameter_faults(faults)

    def duplicate_received(self, can_id: int, now: float) -> None:
        self.on_duplicate(can_id, now)

    def bit_rate_activated(self, kbit_s: int, delay_s: float, now: float) -> None:
        self.on_bit_rate(kbit_s, delay_s, now)
