"""The options of ``canfb calibrate``, checked."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from canfb.cli.calibrate_combinations import refuse_combinations
from canfb.cli.options import add_bus_options, whole_number
from canfb.commissioning.access import CommissioningError
from canfb.commissioning.procedure import MOTION, ZERO_CROSSINGS, Settings
from canfb.commissioning.sample_files import read_npz
from canfb.commissioning.samples import Samples
from canfb.configuration import Config
from canfb.errors import ConfigError
from canfb.signal.source import SourceEnded
from canfb.signal.supervision import SampleLimits
from canfb.simulation.sources import RecordingLayout, RecordingSource

PDO, RECORDING, MODULE = "pdo", "recording", "module"
DEFAULT_MODULE = 0x20
LEAST_SAMPLES = 8000
LARGEST_ARRAY = 50_000_000


def add_options(parser: argparse.ArgumentParser) -> None:
    """All options of the command."""
    parser.add_argument(
        "config",
        metavar="CONFIG.yaml",
        nargs="?",
        help="takes the bus and the ids of the first module from it",
    )
    parser.add_argument("--module", type=whole_number, metavar="ID", help="node id of the module (32)")
    parser.add_argument(
        "--encoder-interface",
        type=whole_number,
        metavar="ID",
        help="node id (that from which the module has its samples)",
    )
    parser.add_argument("--dry-run", action="store_true", help="measure, and write nothing to the module")
    parser.add_argument(
        "--check", action="store_true", help="only say how far the encoder has moved away from its table"
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="write table, samples and report there")
    parser.add_argument("--json", action="store_true", help="the figures, for programs")
    parser.add_argument("--no-save", action="store_true", help="do not save (1010h): gone after a restart")
    _add_measurement(parser)
    _add_file(parser)
    add_bus_options(parser)


def _add_measurement(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("measurement")
    group.add_argument(
        "--method",
        choices=(MOTION, ZERO_CROSSINGS),
        default=MOTION,
        help="motion (default): any speed, samples at each SYNC; zero-crossings: slow, many samples a cycle",
    )
    group.add_argument(
        "--source",
        choices=(PDO, RECORDING, MODULE),
        help="pdo: the ADC PDO on the bus (default); recording: object 2050h (default of zero-crossings); "
        "module: the module calibrates itself (2030h)",
    )
    group.add_argument(
        "--recorder",
        choices=("interface", "module"),
        default="interface",
        help="whose object 2050h records (default: interface)",
    )
    group.add_argument(
        "--seconds", type=float, metavar="S", help="how long to collect (20; 4 for a recording)"
    )
    group.add_argument(
        "--least-samples",
        type=int,
        default=LEAST_SAMPLES,
        metavar="N",
        help=f"collect longer, up to six times, where the SYNC is slow ({LEAST_SAMPLES})",
    )
    group.add_argument(
        "--verify", type=float, metavar="S", help="how long to collect for the proof (4; 1 for a recording)"
    )
    group.add_argument(
        "--conditioning",
        choices=("fit", "none"),
        default="fit",
        help="fit offset, gain and phase error of the tracks first (default), or leave all to the table",
    )
    group.add_argument("--entries", type=int, default=1024, metavar="N", help="length of the table (1024)")
    group.add_argument("--adc-bits", type=int, metavar="N", help="of the converter (from 2001:02)")
    group.add_argument("--rate", type=float, metavar="HZ", help="samples per second, where nothing tells it")
    group.add_argument("--sync", type=float, metavar="HZ", help="produce the SYNC, on a bus that has none")
    group.add_argument("--encoder", default="", metavar="NAME", help="name or serial number, for the report")
    group.add_argument(
        "--answer-within", type=float, default=1.0, metavar="S", help="time for an SDO answer (1)"
    )


def _add_file(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("samples of a file (no bus is used)")
    group.add_argument("--samples", type=Path, metavar="FILE", help="NPZ file, or CSV with a header line")
    group.add_argument(
        "--columns", default="sine,cosine", metavar="SINE,COSINE", help="names or numbers of the two columns"
    )
    group.add_argument(
        "--mid-scale", type=float, default=0.0, metavar="COUNTS", help="the reading that means zero"
    )
    group.add_argument(
        "--time-column", metavar="NAME", help="column with seconds; gaps become missed samples"
    )
    group.add_argument(
        "--table", type=Path, metavar="FILE", help="the table in force, YAML or bytes of 2020:01"
    )
    group.add_argument(
        "--cycles-per-revolution", type=int, metavar="N", help="to give errors as angles of the shaft"
    )


def check_options(options: argparse.Namespace) -> None:
    """ConfigError for options that cannot be, alone or together; fills in what depends on others."""
    refuse_combinations(options)
    if options.source is None:
        options.source = RECORDING if options.method == ZERO_CROSSINGS else PDO
    fast = options.source == RECORDING and options.recorder == "interface"
    options.seconds = options.seconds if options.seconds is not None else (4.0 if fast else 20.0)
    options.verify = options.verify if options.verify is not None else (1.0 if fast else 4.0)
    for name, low, high in (
        ("seconds", 0.1, 3600.0),
        ("verify", 0.1, 600.0),
        ("least_samples", 0, 10_000_000),
        ("rate", 0.1, 1e7),
        ("sync", 0.1, 1e5),
        ("answer_within", 0.01, 60.0),
        ("entries", 16, 4096),
        ("adc_bits", 4, 16),
        ("module", 1, 127),
        ("encoder_interface", 1, 127),
        ("cycles_per_revolution", 1, 1 << 20),
    ):
        value = getattr(options, name)
        if value is not None and not low <= value <= high:
            raise ConfigError(f"--{name.replace('_', '-')} {value:g}: must be {low:g} to {high:g}")
    if not math.isfinite(options.mid_scale):
        raise ConfigError(f"--mid-scale {options.mid_scale:g}: must be a number of counts")
    if len(options.columns.split(",")) != 2:
        raise ConfigError(f"--columns {options.columns}: two columns, sine,cosine, are wanted")
    if options.table and not options.samples:
        raise ConfigError("--table: only with --samples; over the bus the module tells its table")
    if options.source == MODULE and options.method != MOTION:
        raise ConfigError("--source module: the module has the method motion only")


def settings_of(options: argparse.Namespace, limits: SampleLimits | None) -> Settings:
    """How to calibrate; the converter's bits from the module, unless given."""
    bits = options.adc_bits
    if bits is None and limits is not None and limits.full_scale_counts.bit_count() == 1:
        bits = limits.full_scale_counts.bit_length()
    return Settings(options.method, "fit" if options.conditioning == "fit" else None, options.entries, bits)


def chosen_nodes(options: argparse.Namespace, config: Config) -> tuple[int, int | None]:
    """Ids of module and encoder interface, None if the module is to say it. ConfigError if both are one."""
    module, interface = options.module, options.encoder_interface
    known = [one for one in config.modules if module in (None, one.node_id)]
    if module is None:
        module = known[0].node_id if known else DEFAULT_MODULE
    if interface is None and known and known[0].source is None:
        interface = known[0].encoder_interface
    if module == interface:
        raise ConfigError(f"--encoder-interface {interface}: must be another node than the module")
    return module, interface


def samples_of_file(options: argparse.Namespace) -> Samples:
    """Samples of ``--samples``. CanfbError, with file and line, for a file that cannot be used."""
    path: Path = options.samples
    if path.suffix == ".npz":
        found = read_npz(path)
        return Samples(found.sine, found.cosine, options.rate or found.rate_hz, found.origin)
    columns = [name.strip() for name in options.columns.split(",")]
    layout = RecordingLayout((columns[0], columns[1]), options.mid_scale, options.time_column)
    source = RecordingSource(path, layout)
    sine, cosine = [], []
    while True:
        try:
            sample = source.next()
        except SourceEnded:
            break
        sine.append(math.nan if sample is None else float(sample.sine))
        cosine.append(math.nan if sample is None else float(sample.cosine))
    try:
        return Samples.of(sine, cosine, options.rate, f"file {path.name}")
    except ValueError as error:
        raise CommissioningError(f"{path}: {error}") from None
