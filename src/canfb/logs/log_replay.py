"""A bus log through the modules that it was recorded with, or through others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from canfb.cia301.frame import Frame
from canfb.device.storage.storage import MemoryStore
from canfb.errors import CanfbError, ConfigError
from canfb.hosting.state_files import SavedParameters
from canfb.logs.log_reader import BusLogFile, LogError
from canfb.module.module_config import ModuleConfig
from canfb.replay.drift_of_log import DriftTracks, LogDrift
from canfb.replay.module_replay import ModuleReplay
from canfb.replay.sample_columns import Block
from canfb.replay.start_rule import Begin
from canfb.signal.correction import Correction


@dataclass(frozen=True)
class ReplayOptions:
    """How a log is replayed.

    modules      the modules; none with a source of its own
    correction   table and conditioning in place of what is saved
    state_dir    where `save` (1010h) has kept parameters of the module, read and never written
    begin        the NMT state at the beginning of the log
    channel      of the log; None: all of them, as one bus
    drift        whether to measure how far the encoders have moved away from their tables: takes seconds
    """

    modules: tuple[ModuleConfig, ...]
    correction: Correction | None = None
    state_dir: Path | None = None
    begin: Begin = Begin.AUTO
    channel: str | None = None
    drift: bool = False

    def __post_init__(self) -> None:
        for module in self.modules:
            if module.source is not None:
                raise ConfigError(
                    f"module {module.node_id} has a source of its own: its samples are not on the bus"
                )
        if self.state_dir is not None and len(self.modules) != 1:
            raise ConfigError("--state: is for one module; choose it by --module")
        if self.state_dir is not None and not self.state_dir.is_dir():
            raise ConfigError(f"--state {self.state_dir}: there is no such folder")


@dataclass(frozen=True)
class LogReplayed:
    """The modules of a log, with what the log was like, and the drift of each encoder."""

    log: BusLogFile
    replays: list[ModuleReplay]
    drifts: list[LogDrift | None]

    def left_out(self, replay: ModuleReplay) -> int:
        """Frames with CAN-IDs of this module, without those that all nodes hear, on channels not taken."""
        mine = replay.own_can_ids
        counted = self.log.counters.left_out.values()
        return sum(number for one in counted for can_id, number in one.items() if can_id in mine)


def replay_log(
    path: Path,
    settings: ReplayOptions,
    takers: Sequence[Callable[[Block], None]] = (),
    sent: Callable[[Frame], None] | None = None,
    heard: Callable[[float], None] = lambda part: None,
) -> LogReplayed:
    """Read it once, for all modules. ``heard`` gets the part that is done, 0..1.

    ``takers`` and ``sent`` get the samples and the frames of the modules, see ModuleReplay. LogError for
    a log without a frame, or that cannot be read.
    """
    log = BusLogFile(path, settings.channel)
    tracks = [DriftTracks() for _ in settings.modules]
    replays = [
        ModuleReplay(
            module,
            _store(module, settings.state_dir),
            correction=settings.correction,
            begin=settings.begin,
            takers=[*([track.take] if settings.drift else []), *takers],
            sent=sent,
        )
        for module, track in zip(settings.modules, tracks, strict=True)
    ]
    _feed(log, replays, heard)
    for replay in replays:
        replay.close()
    drifts = [
        track.drift(replay.module.chain.correction, module.adc_bits) if settings.drift else None
        for module, replay, track in zip(settings.modules, replays, tracks, strict=True)
    ]
    return LogReplayed(log, replays, drifts)


def _feed(log: BusLogFile, replays: list[ModuleReplay], heard: Callable[[float], None]) -> None:
    fed = 0
    for batch in log.batches():
        for replay in replays:
            replay.feed(batch)
        fed += len(batch)
        heard(log.part_read)
    if not fed:
        counters = log.counters
        if counters.left_out:
            there = ", ".join(sorted(counters.left_out))
            raise LogError(f"{log.path}: there is no frame of channel {log.channel}; there are {there}")
        damaged = f"; {counters.damaged_lines} damaged lines" if counters.damaged_lines else ""
        raise LogError(f"{log.path}: there is no frame with an 11-bit identifier in it{damaged}")


def _store(module: ModuleConfig, state_dir: Path | None) -> MemoryStore | None:
    """What was saved, in the memory: the log may hold a `save`, and the folder stays as it is."""
    if state_dir is None and module.state_dir is None:
        return None
    store = MemoryStore()
    if state_dir is not None:
        for group, image in SavedParameters(state_dir).load().items():
            if isinstance(image, OSError):
                raise CanfbError(f"--state {state_dir}: {group.name.lower()} parameters: {image.strerror}")
            store.images[group] = image
    return store
