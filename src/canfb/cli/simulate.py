"""``canfb simulate CONFIG.yaml``: the encoder interface on a bus, with a motion, a recording or a drive."""

from __future__ import annotations

import argparse
from dataclasses import replace
from math import inf
from pathlib import Path

from canfb.bus.runner import ending_on_signals
from canfb.cli.options import (
    COLUMNS,
    JITTER,
    READY_FILE,
    Commands,
    add_bus_options,
    add_command,
    between,
    bus_options,
    chosen_module,
    group,
    jittered,
    nodes,
    option,
    positive,
    refuse_idle,
)
from canfb.cli.printing import printed_without_waiting, say
from canfb.configuration import Config, load_config
from canfb.errors import ConfigError, saying
from canfb.files import check_writable, writing
from canfb.hosting.readiness import Readiness
from canfb.hosting.simulating import Simulating
from canfb.master.samples import TrackSamples, write_csv, write_npz
from canfb.module.module_config import ModuleConfig
from canfb.simulation.scenario import PACES, SimulationConfig
from canfb.simulation.set_up import Play, SampleRecorder
from canfb.sources.recording_source import chosen_layout

TIMES = ("time_column", "gap", "gap_samples")
OF_CSV = ("columns", "mid_scale", "scale", *TIMES)
WRITERS = {".csv": write_csv, ".npz": write_npz}


def register(commands: Commands) -> None:
    add_command(
        commands,
        "simulate",
        simulate,
        nodes("CONFIG.yaml, and the node-ID of the module to serve (the first)", most=1),
        option(
            "--rate",
            type=float,
            within=between(0.1, 100_000, " Hz"),
            metavar="HZ",
            help="produce the SYNC at this rate; without it, follow the SYNC of the bus",
        ),
        JITTER,
        option(
            "--pace",
            choices=PACES,
            help="the machine turns in real time (time), or by one interval per SYNC, however late (sync)",
        ),
        option("--rpm", type=float, help="speed after the ramp, instead of the configuration's"),
        option("--autostart", action="store_true", help="enter OPERATIONAL without a master"),
        option(
            "--seconds",
            type=positive,
            metavar="S",
            help="end after this machine time, from the first sample on",
        ),
        option(
            "--record",
            metavar="FILE",
            help="write the samples to a CSV or NPZ file, to play them back (--samples) or to calibrate",
        ),
        READY_FILE,
        group(
            "playing a recording",
            option(
                "--samples",
                metavar="FILE",
                help="CSV file with a header line, one row for each SYNC, or an NPZ file of canfb",
            ),
            *COLUMNS,
            option(
                "--gap", type=positive, default=0.1, metavar="S", help="a longer time step is a gap (0.1)"
            ),
            option(
                "--gap-samples",
                type=int,
                within=(1, inf, "1 or more"),
                default=20,
                metavar="N",
                help="samples lost at each gap (20)",
            ),
        ),
        add_bus_options,
        idle=(
            (
                OF_CSV,
                "samples",
                True,
                "only with --samples",
            ),
            (["rpm"], "samples", False, "not with --samples: a recording has its own motion"),
            (TIMES, "time_column", True, "only with --time-column, which contains the gaps"),
            (["jitter"], "rate", True, "only with --rate: the SYNC is that of the bus"),
        ),
    )


def simulate(options: argparse.Namespace) -> int:
    if options.config is None:
        raise ConfigError("CONFIG.yaml is required: its module and its simulation")
    config = load_config(options.config)
    words = bus_options(options, config.bus)
    record = None if options.record is None else check_record(options.record, options.samples)
    simulating = Simulating(*chosen(options, config), words, config.realtime, options.seconds)
    network = simulating.network
    with (
        printed_without_waiting(),
        Readiness(options.ready_file) as readiness,
        simulating,
        ending_on_signals(simulating.stop),
    ):
        try:
            simulating.run(readiness.ready)
        finally:
            if record is not None:
                write_record(record, network.recorder, network.rate_hz)
    say(f"{network.interface.samples} samples sent{'; end of the recording' * network.interface.ended}")
    if record is not None:
        say(f"written  {record}")
    if network.drive is not None:
        say(network.drive.summary())
    return 0


def chosen(options: argparse.Namespace, config: Config) -> tuple[SimulationConfig, ModuleConfig, Play]:
    module = chosen_module(options, config)
    simulation = jittered(config, options).simulation
    for name in ("samples", "rpm") if simulation.drive is not None else ():
        if getattr(options, name) is not None:
            raise ConfigError(
                f"--{name}: the drive of the configuration moves the encoder; omit one of the two"
            )
    if options.rpm is not None:
        with saying(ConfigError, f"--rpm {options.rpm:g}", ValueError):
            simulation = replace(simulation, motion=replace(simulation.motion, rpm=options.rpm))
    if options.samples is not None and options.samples.lower().endswith(".npz"):
        refuse_idle(options, OF_CSV, f"only for CSV, not for {options.samples}")
    layout = chosen_layout(options.columns, options.mid_scale, options.scale, options.time_column)
    play = Play(
        rate_hz=options.rate,
        autostart=options.autostart,
        recorded=options.record is not None or options.seconds is not None,
        file=options.samples,
        layout=replace(layout, gap_s=options.gap, gap_samples=options.gap_samples),
    )
    return replace(simulation, pace=options.pace or simulation.pace), module, play


def check_record(name: str, samples: str | None = None) -> Path:
    path = Path(name)
    if path.suffix not in WRITERS:
        raise ConfigError(f"--record {name}: the name must end with {' or '.join(WRITERS)}")
    if samples is not None and path.resolve() == Path(samples).resolve():
        raise ConfigError(f"--record {name}: is the recording that is played")
    check_writable(path, "--record")
    return path


def write_record(path: Path, recorder: SampleRecorder, rate_hz: float) -> None:
    with writing(path, "--record"):
        WRITERS[path.suffix](path, TrackSamples.of(*recorder.tracks(), rate_hz, "canfb simulate --record"))
