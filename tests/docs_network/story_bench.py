"""The drive network of docs/drive-network in simulated time, with the master of the example."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import network_file

import master
from canfb import FeedbackModule, Frame, load_config
from canfb.cia301.codes import NmtState
from canfb.demo.story import EmbeddedNetwork
from canfb.interface.encoder_interface import EncoderInterface
from canfb.simulation.cia402.state_machine import State
from canfb.simulation.embedded_bus import REGULAR, BackgroundTraffic, EmbeddedBus, SyncProducer, SyncTiming
from canfb.simulation.set_up import simulated_axis

BIT_RATE = 1_000_000
SYNC_TIMING = SyncTiming(sync_jitter_us=100.0, sync_drift_ppm=-50.0)
FOLDER = Path(__file__).parents[2] / "docs" / "drive-network"


class Periodic(SyncProducer):
    """A frame sent again and again by the master; may be stopped."""

    def __init__(self, frame: Frame, period_s: float) -> None:
        super().__init__(period_s, SYNC_TIMING if frame.can_id == 0x80 else REGULAR)
        self._frame = frame

    def _due(self, due_s: float, now: float) -> Frame:
        super()._due(due_s, now)
        return self._frame

    def stop(self) -> None:
        self._next_s = None


class StoryNetwork(EmbeddedNetwork):
    """canopen's network with periodic frames in simulated time."""

    def __init__(self, bus: EmbeddedBus) -> None:
        super().__init__(bus)
        self._bus = bus
        self._tasks: list[Periodic] = []
        self._dead = False

    def die(self) -> None:
        """The computer of the master is off: nothing comes from it any more."""
        self._dead = True
        for task in self._tasks:
            task.stop()

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        if not self._dead:
            super().send_message(can_id, data, remote)

    def send_periodic(  # type: ignore[override]
        self, can_id: int, data: bytes, period: float, remote: bool = False
    ) -> Periodic:
        task = Periodic(Frame(can_id, bytes(data)), period)
        self._bus.attach(task)
        self._tasks.append(task)
        return task


class DriveNetwork:
    """All nodes, powered on; on a bus where frames take their time, and others send as well."""

    def __init__(self, **drive: float) -> None:
        """``drive``: keys of the drive in feedback.yaml that differ."""
        self.bus = EmbeddedBus(BIT_RATE)
        config = load_config(FOLDER / "feedback.yaml")
        assert config.simulation.drive is not None
        changed = dataclasses.replace(config.simulation.drive, **drive)  # type: ignore[arg-type]
        config = dataclasses.replace(config, played=dataclasses.replace(config.simulation, drive=changed))
        simulated = simulated_axis(config.simulation, config.modules[0])
        assert simulated is not None
        self.drive, source = simulated
        self.plant = self.drive.plant
        module, clock = config.modules[0], config.simulation.sample_clock()
        self.interface = EncoderInterface(module.encoder_interface, source, times=module.times, clock=clock)
        self.module = FeedbackModule(module)
        others = BackgroundTraffic(0.2, BIT_RATE)
        for device in (self.plant, self.interface, self.module, self.drive, others):
            self.bus.attach(device)
        self.bus.run_until(0.01)  # all have said that they are there
        self.network = StoryNetwork(self.bus)
        self.at: dict[float, Callable[[], None]] = {}

    def wait(self, seconds: float) -> None:
        """Let time pass, and do what is planned for it."""
        self.bus.run_until(self.bus.now + seconds)
        for time in [time for time in self.at if time <= self.bus.now]:
            self.at.pop(time)()

    def run(self, *arguments: str, file: Path | None = None) -> int:
        """The master of the example."""
        options: Any = master.parse([str(file or FOLDER / "network.yaml"), *arguments])
        return master.run(
            self.network,
            network_file.load(options.file),
            options,
            lambda: self.bus.now,
            self.wait,
            lambda network, file: network.send_periodic(0x80, b"", file.sync_period_us / 1e6),
        )


def assert_all_quiet(network: DriveNetwork) -> None:
    """PRE-OPERATIONAL, no power, and no SYNC any more."""
    assert network.module.state is NmtState.PRE_OPERATIONAL
    assert network.interface.state is NmtState.PRE_OPERATIONAL
    assert network.drive.state is NmtState.PRE_OPERATIONAL
    assert network.drive.power in (State.SWITCH_ON_DISABLED, State.FAULT)
    syncs = network.plant.syncs
    network.wait(1.0)
    assert network.plant.syncs == syncs
    network.plant.go_on_to(network.bus.now)  # time passes without a SYNC, too
    assert network.plant.motor.braked
    assert (network.plant.motor.command_nm, network.plant.motor.speed_rad_s) == (0.0, 0.0)
