"""``canfb config check|example|dcf``: check a configuration, print one, or write it as a DCF for a master."""

from __future__ import annotations

import argparse
from pathlib import Path

from canfb.bus.clocks import file_date_and_time
from canfb.cli.node_options import master_of, say_result
from canfb.cli.options import (
    JSON,
    TIMEOUT,
    Commands,
    add_bus_options,
    add_command,
    add_group,
    bus_options,
    chosen_module,
    named_config,
    nodes,
    option,
    refuse_idle,
)
from canfb.cli.printing import report
from canfb.configuration import ANY_NODES, Config, load_config
from canfb.device.od.dcf import Reals
from canfb.errors import ConfigError, saying
from canfb.files import check_writable
from canfb.hosting.hosting import check_machine, saved_configuration
from canfb.master.access import NodeAccess
from canfb.module.device_configuration import ConfigurationFiles, place_names, read_configuration
from canfb.module.module_config import ModuleConfig
from canfb.rows import Result

EXAMPLE = """\
# canfb run CONFIG.yaml, canfb simulate CONFIG.yaml
bus: {interface: socketcan, channel: vcan0}     # python-can's parameters; add bitrate: 1000000 on a real bus

modules:                                        # one process serves several nodes
  - node_id: 0x20
    encoder_interface: 0x10                     # the node whose TPDO1 carries the ADC counts
    cycles_per_revolution: 2500
    adc_bits: 12
    times: true                                 # the ADC PDO carries the time of each sample
    # Largest acceleration of the machine (2010:02), more than used below. At 100 Hz it is 0.01 cycle per
    # interval^2: after a gap of up to 9 intervals one trajectory fits the samples. 0: not known, and a gap
    # may lose the position.
    max_acceleration_rad_s2: 0.25
    residual_limit: 0.3333                      # cycles; the paper's 1/3, narrowed by the acceleration
    coast_samples: 30                           # bad or missed samples to bridge before the position is lost
    sync_timeout_periods: 20                    # a desktop may stop a program for 0.1 s; a real-time bus: 2
    autostart: false                            # true: OPERATIONAL without a master
    # predict: true                             # synchronous PDOs carry the position of their SYNC (2013h)
    # nominal_sync: true                        # the position of a SYNC without jitter (2013:02)
    # second_position: {cob_id: 0x3B0, increments: 65536, tolerance_revolutions: 0.01}    # 2014h
    # state_dir: /var/lib/canfb/x               # storage of `save` (1010h); without it, nothing is saved
    # source: {kind: iio, device: ads7950}      # the module's own ADC (Linux IIO) instead of the ADC PDO, or
    #                                           # {kind: recording, file: tracks.csv}, or {kind: motion}
    # conditioning:                             # offset, gain and phase error of the tracks; default: none
    #   {sine_offset_counts: 0, cosine_offset_counts: 0, sine_gain: 1, cosine_gain: 1, phase_error_rad: 0}
    #                                           # and cosine_delay_s, delay_s (2002:06, :07)
    # adapt: true                               # follow offset, gain and phase slowly (2002:08)
    # corner_hz: 125e3                          # corner frequency of the analog path, 0: none

simulation:                                     # the machine of canfb simulate
  encoder: {amplitude: 0.75, sine_offset: 0.01, cosine_amplitude: 0.99, noise_lsb: 0.5}
  # 0.23 rad/s^2: less than max_acceleration_rad_s2. The speed ripple, present in every machine, gives
  # canfb calibrate all phases of the cycle.
  motion: {standstill_s: 0.5, ramp_s: 30, rpm: 61, ripple_rpm: 0.3, ripple_hz: 0.1}
  # drive: {node_id: 0x30}                      # a CiA 402 drive moves the machine instead of `motion`

# realtime: {priority: 80, lock_memory: true, cpu: 3}
#                                               # or {cpu: 3, busy_poll: true}: never sleep
"""
INLINE, FILE = "inline", "file"  # place of the table of a DCF
EXAMPLE_BUS = "{interface: socketcan, channel: vcan0}"  # bus of the example


def register(commands: Commands) -> None:
    parts = add_group(commands, "config")
    add_command(
        parts,
        "check",
        check,
        option("config", metavar="CONFIG.yaml"),
        summary="check a configuration",
    )
    add_command(parts, "example", example, summary="print an example")
    add_command(
        parts,
        "dcf",
        write_dcf,
        nodes(
            "CONFIG.yaml, with a node-ID if it has several modules; a node-ID alone: read over the bus",
            least=1,
            most=1,
            file="subject",
        ),
        option("--out", type=Path, metavar="FILE", help="the DCF (module-20h.dcf); replaced"),
        option("--concise", type=Path, metavar="FILE", help="the concise form, for object 1F22h"),
        option(
            "--table",
            choices=(INLINE, FILE),
            default=INLINE,
            help="the correction table: in the DCF and in a file (default), or in the file only",
        ),
        option(
            "--reals",
            choices=[reals.value for reals in Reals],
            default=Reals.DECIMAL.value,
            help="format of REAL32: decimal (default), or the bits, as lely's tools read them",
        ),
        option("--name", default="", help="NodeName of the DCF (module_20h)"),
        JSON,
        TIMEOUT,
        add_bus_options,
        summary="write a device configuration file (CiA 306) for a CANopen master",
    )


def check(options: argparse.Namespace) -> int:
    config = load_config(options.config, ANY_NODES)
    check_machine(Path(options.config), config)
    lists = [
        f"; {key}: {', '.join(f'{one.node_id:02X}h' for one in those)}"
        for key, those in config.lists.items()
        if those
    ]
    print(f"{options.config}: valid{''.join(lists)}")
    return 0


def example(options: argparse.Namespace) -> int:
    print(EXAMPLE, end="")
    return 0


def write_dcf(options: argparse.Namespace) -> int:
    _check(options)
    config = named_config(options)
    words = bus_options(options, config.bus)
    if options.node is None:
        configuration = saved_configuration(_chosen(config, options))
    else:
        with master_of(options) as master:
            configuration = read_configuration(NodeAccess(master, options.node, "node"))
    inline, reals = options.table == INLINE, Reals(options.reals)
    files = ConfigurationFiles(
        configuration, options.out, options.concise, inline, reals, options.name, words
    )
    if options.concise is not None and options.concise.resolve() == files.path.resolve():
        raise ConfigError(f"--concise {options.concise}: must differ from --out")
    files.write(*file_date_and_time())
    say_result(options, Result(files.summary(), files.lines()))
    refused = configuration.refused_in_index_order()
    if refused and not options.json:
        report(
            f"note: a master that writes each object once, in the order of the indices, is refused at "
            f"{place_names(refused)}; give it the concise form (--concise)"
        )
    return 0


def _check(options: argparse.Namespace) -> None:
    options.node = None if options.subject else options.module  # without a file: read it on the bus
    if options.node is None:
        refuse_idle(options, ["timeout", "config"], "only with NODE alone, which is read over the bus")
        options.config = options.subject
    if not options.name.isascii() or not options.name.isprintable() or ";" in options.name:
        raise ConfigError(f"--name {options.name!r}: must be printable ASCII without ';'")
    for name, path in (("--out", options.out), ("--concise", options.concise)):  # check before writing
        if path is not None:
            check_writable(path, name)


def _chosen(config: Config, options: argparse.Namespace) -> ModuleConfig:
    if options.module is None and len(config.modules) > 1:
        there = ", ".join(f"{module.node_id} ({module.node_id:02X}h)" for module in config.modules)
        raise ConfigError(f"{options.config}: NODE is required, as there are several: {there}")
    with saying(ConfigError, options.config, ConfigError):
        module = chosen_module(options, config)
    if getattr(module.source, "adc_bits", module.adc_bits) is None:
        raise ConfigError(
            f"{options.config}: adc_bits is required: a DCF has the full scale and the limits of the "
            "amplitude, and the converter is not read. Or give NODE alone: the module is read on the bus"
        )
    return module
