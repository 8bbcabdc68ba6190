"""``canfb simulate CONFIG.yaml``: the encoder interface on a bus, with a motion, a recording or a drive."""

from __future__ import annotations

import argparse
import math
from dataclasses import replace

from canfb.bus.opening import check_device_bus, describe, open_bus
from canfb.bus.readiness import Readiness
from canfb.bus.realtime import apply_realtime
from canfb.bus.runner import Device, Runner, ending_on_signals
from canfb.cli.options import (
    Commands,
    add_bus_options,
    add_command,
    add_ready_file,
    bus_options,
    chosen_module,
    refuse_idle,
    whole_number,
)
from canfb.cli.printing import report, say
from canfb.cli.simulate_drive import simulated_axis
from canfb.cli.simulate_record import check_record, write_record
from canfb.configuration import Config, load_config
from canfb.errors import ConfigError
from canfb.simulation.demand import Demand, of_motion, of_recording
from canfb.simulation.encoder_interface import EncoderInterface
from canfb.simulation.hearing import SlowMotion
from canfb.simulation.sample_recorder import SampleRecorder
from canfb.simulation.scenario import PACES, MotionConfig
from canfb.simulation.shaft_encoder import ShaftEncoder
from canfb.simulation.sync_producer import SyncProducer
from canfb.simulation.sync_rate import IN_SLOW_MOTION, IN_TRUE_TIME, SyncRateWatch
from canfb.sources.motion_source import MotionSource
from canfb.sources.protocol import Source
from canfb.sources.recording_source import ArraySource, RecordingLayout, RecordingSource, open_recording

TIMES = ("time_column", "gap", "gap_samples")


def register(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "simulate",
        "simulate the encoder interface, with a motion, a recording or a drive, on a bus",
        simulate,
    )
    parser.add_argument("config", metavar="CONFIG.yaml")
    parser.add_argument(
        "--rate",
        type=float,
        metavar="HZ",
        help="produce the SYNC at this rate; without it, follow the SYNC of the bus",
    )
    parser.add_argument(
        "--pace",
        choices=PACES,
        help="the machine turns in true time (time), or by one interval with each SYNC, however late (sync)",
    )
    parser.add_argument(
        "--module", type=whole_number, metavar="ID", help="node id of the module it feeds (the first)"
    )
    parser.add_argument("--rpm", type=float, help="speed after the ramp, in place of the configuration's")
    parser.add_argument("--autostart", action="store_true", help="operational without a master")
    parser.add_argument(
        "--seconds", type=float, metavar="S", help="end when the machine has moved for so long"
    )
    parser.add_argument(
        "--record",
        metavar="FILE",
        help="write what was sampled to a CSV or NPZ file, to play it (--samples) or to calibrate with it",
    )
    add_ready_file(parser)
    play = parser.add_argument_group("playing a recording")
    play.add_argument(
        "--samples",
        metavar="FILE",
        help="CSV file with a header line, one row for each SYNC, or an NPZ file of canfb",
    )
    play.add_argument(
        "--columns",
        default="sine,cosine",
        metavar="SINE,COSINE",
        help="names or numbers (from 0) of the two columns",
    )
    play.add_argument(
        "--mid-scale", type=float, default=0.0, metavar="COUNTS", help="the reading that means zero"
    )
    play.add_argument(
        "--time-column", metavar="NAME", help="column with seconds; gaps in it become lost samples"
    )
    play.add_argument(
        "--gap", type=float, default=0.1, metavar="S", help="a longer step of time is a gap (0.1)"
    )
    play.add_argument(
        "--gap-samples", type=int, default=20, metavar="N", help="samples lost at each gap (20)"
    )
    add_bus_options(parser)


def simulate(options: argparse.Namespace) -> int:
    """Serve the encoder interface until Ctrl-C, SIGTERM, SIGHUP, --seconds or the end of the recording."""
    config = load_config(options.config)
    words = bus_options(options, config.bus)
    check_device_bus(words)
    module = chosen_module(options, config)
    _refuse_idle(options)
    _check(options)
    record = None if options.record is None else check_record(options.record)
    axis = simulated_axis(options, config)
    source = chosen_source(options, config) if axis is None else axis.source
    demand = demanded(options, config, source) if axis is None else axis.demand
    interface = EncoderInterface(
        module.encoder_interface,
        source,
        autostart=options.autostart or module.autostart,
        times=module.times,
        clock=config.simulation.sample_clock(),
    )
    node = f"{module.encoder_interface} ({module.encoder_interface:02X}h)"
    interface.node.on_duplicate = lambda can_id, now: report(
        f"encoder interface {node}: another node sends with this node-ID ({can_id:03X}h)"
    )
    # The machine first: it must have moved when the SYNC comes to the others.
    devices: list[Device] = [interface] if axis is None else [axis.plant, interface, axis.drive]
    rate_hz, advice = sync_rate(options, config), IN_TRUE_TIME
    if (options.pace or config.simulation.pace) == "sync":
        slow_motion, advice = SlowMotion(interface.dictionary, 1.0 / rate_hz), IN_SLOW_MOTION
        interface.hearing = slow_motion
        if axis is not None:
            axis.plant.hearing = axis.drive.hearing = slow_motion
        devices.insert(0, slow_motion)
    recorder = SampleRecorder(interface)
    if record is not None or options.seconds is not None:
        devices.append(recorder)
    if options.rate is not None:
        producer = SyncProducer(1.0 / options.rate, config.simulation, config.simulation.seed)
        devices += [SyncRateWatch(options.rate, report, advice), producer]
    intervals = math.inf if options.seconds is None else options.seconds * rate_hz
    with Readiness(options.ready_file, report) as readiness, open_bus(words) as bus:
        runner = Runner(bus, devices, report)
        apply_realtime(config.realtime, report)

        def ready() -> None:
            say(f"encoder interface: node {node} on {describe(words)}; end with Ctrl-C")
            if axis is not None:
                say(axis.describe())
            if demand is not None:
                _say_demand(demand)
            readiness.ready()

        with ending_on_signals(runner.stop):
            try:
                runner.run(lambda: interface.ended or len(recorder) >= intervals, ready)
            finally:
                if record is not None:
                    write_record(record, recorder, rate_hz)
    say(f"{interface.samples} samples sent{'; the recording is over' if interface.ended else ''}")
    if record is not None:
        say(f"written  {record}")
    if axis is not None:
        say(axis.summary())
    return 0


def sync_rate(options: argparse.Namespace, config: Config) -> float:
    """The nominal rate of the SYNC, Hz: of ``--rate``, else of the configuration."""
    return float(options.rate or 1e6 / config.simulation.sync_period_us)


def _check(options: argparse.Namespace) -> None:
    """ConfigError for options that cannot be."""
    if options.rate is not None and not 0.1 <= options.rate <= 100_000:
        raise ConfigError(f"--rate {options.rate:g}: must be 0.1 to 100000 Hz")
    if options.seconds is not None and not 0.0 < options.seconds <= 1e6:
        raise ConfigError(f"--seconds {options.seconds:g}: must be more than 0, at most 1e6")


def _say_demand(demand: Demand) -> None:
    """What the motion asks of the module, and that it is too much where it is."""
    say(demand.describe())
    warning = demand.warning()
    if warning is not None:
        report(warning)


def chosen_motion(options: argparse.Namespace, config: Config) -> MotionConfig:
    """The motion of the configuration, with the speed of ``--rpm``. ConfigError for a bad one."""
    motion = config.simulation.motion
    if options.rpm is None:
        return motion
    try:
        return replace(motion, rpm=options.rpm)
    except ValueError as error:
        raise ConfigError(f"--rpm {options.rpm:g}: {error}") from None


def chosen_source(options: argparse.Namespace, config: Config) -> Source:
    """The recording of ``--samples``, else the motion of the configuration. CanfbError for a bad one."""
    module = chosen_module(options, config)
    if options.samples is not None:
        return open_recording(options.samples, _layout(options, module.times, sync_rate(options, config)))
    return MotionSource(
        ShaftEncoder(
            config.simulation.encoder.encoder(module.adc_bits),
            module.cycles_per_revolution,
            config.simulation.seed,
            config.simulation.aperture_jitter_s,
        ),
        chosen_motion(options, config).motion(),
        1.0 / sync_rate(options, config),
    )


def _refuse_idle(options: argparse.Namespace) -> None:
    if options.samples is None:
        refuse_idle(options, ("columns", "mid_scale", *TIMES), "only with --samples, which it describes")
    else:
        refuse_idle(options, ("rpm",), "not with --samples: a recording has its own motion")


def demanded(options: argparse.Namespace, config: Config, source: Source) -> Demand:
    """What the motion, or the recording, asks of the module."""
    module, rate_hz = chosen_module(options, config), sync_rate(options, config)
    if isinstance(source, (RecordingSource, ArraySource)):
        return of_recording(*source.tracks(), module, rate_hz, options.samples)
    return of_motion(chosen_motion(options, config), module, rate_hz)


def _layout(options: argparse.Namespace, times: bool, rate_hz: float) -> RecordingLayout:
    columns = [name.strip() for name in options.columns.split(",")]
    if len(columns) != 2:
        raise ConfigError(f"--columns {options.columns}: two columns, sine,cosine, are wanted")
    if not math.isfinite(options.mid_scale):
        raise ConfigError(f"--mid-scale {options.mid_scale:g}: must be a number of counts")
    if not 0.0 < options.gap < math.inf:
        raise ConfigError(f"--gap {options.gap:g}: must be more than 0 seconds")
    if options.gap_samples < 1:
        raise ConfigError(f"--gap-samples {options.gap_samples}: must be 1 or more")
    if options.time_column is None:
        refuse_idle(options, TIMES, "only with --time-column, in which the gaps are")
    # The samples of a recording are as regular as they were, however the SYNC jitters that asks for them.
    return RecordingLayout(
        (columns[0], columns[1]),
        options.mid_scale,
        options.time_column,
        options.gap,
        options.gap_samples,
        time_stamps=times and (options.time_column is not None or options.rate is not None),
        interval_s=1.0 / rate_hz,
        paced=options.rate is not None,
    )
