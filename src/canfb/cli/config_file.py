"""``canfb config check|example|dcf``: help with the configuration."""

from __future__ import annotations

import argparse
from pathlib import Path

from canfb.cli import config_dcf
from canfb.cli.examples import examples_of
from canfb.cli.options import Commands, add_command
from canfb.configuration import ANY_NODES, load_config
from canfb.hosting.hosting import check_machine

EXAMPLE = """\
# canfb run CONFIG.yaml, canfb simulate CONFIG.yaml
bus: {interface: socketcan, channel: vcan0}     # python-can's parameters; add bitrate: 1000000 on a real bus

modules:                                        # one process serves several nodes
  - node_id: 0x20
    encoder_interface: 0x10                     # the node whose TPDO1 carries the ADC counts
    cycles_per_revolution: 2500
    adc_bits: 12
    times: true                                 # the ADC PDO carries the time of each sample
    # What the machine can do at most (2010:02); the motion below needs less. At 100 Hz it is 0.01 cycle per
    # interval^2: after a gap of up to 9 intervals one trajectory fits the samples. 0: not known, and a gap
    # may cost the position.
    max_acceleration_rad_s2: 0.25
    residual_limit: 0.3333                      # cycles; the paper's 1/3, narrowed by the acceleration
    coast_samples: 30                           # bad or missed samples to bridge before the position is lost
    sync_timeout_periods: 20                    # a desktop may stop a program for 0.1 s; a real-time bus: 2
    autostart: false                            # true: OPERATIONAL without a master
    # prediction_order: 3                       # a servo: the limit bounds its jerk, not its acceleration
    # max_jerk_rad_s3: 785000                   # and narrows it, if it is known (2010:08)
    # predict: true                             # synchronous PDOs carry the position of their SYNC (2013h)
    # nominal_sync: true                        # the position of a SYNC without jitter (2013:02)
    # second_position: {cob_id: 0x3B0, increments: 65536, tolerance_revolutions: 0.01}    # 2014h
    # state_dir: /var/lib/canfb/x               # storage of `save` (1010h); without it, nothing is saved
    # source: {kind: iio, device: ads7950}      # the module's own ADC (Linux IIO) instead of the ADC PDO, or
    #                                           # {kind: recording, file: tracks.csv}, or {kind: motion}
    # conditioning:                             # offset, gain and phase error of the tracks; default: none
    #   {sine_offset_counts: 0, cosine_offset_counts: 0, sine_gain: 1, cosine_gain: 1, phase_error_rad: 0}
    #                                           # and cosine_delay_s, delay_s (2002:06, :07)
    # adapt: true                               # offset, gain and phase are followed slowly (2002:08)
    # corner_hz: 125e3                          # low-pass of the analog path: the amplitude over the speed

simulation:                                     # the machine of canfb simulate
  encoder: {amplitude: 0.75, sine_offset: 0.01, cosine_amplitude: 0.99, noise_lsb: 0.5}
  # 0.23 rad/s^2: less than max_acceleration_rad_s2. The speed ripple, present in every machine, gives
  # canfb calibrate all phases of the cycle.
  motion: {standstill_s: 0.5, ramp_s: 30, rpm: 61, ripple_rpm: 0.3, ripple_hz: 0.1}
  # drive: {node_id: 0x30}                      # a CiA 402 drive moves the machine instead of `motion`

# realtime: {priority: 80, lock_memory: true, cpu: 3}
#                                               # or {cpu: 3, busy_poll: true}: it never sleeps
"""
EXAMPLE_BUS = "{interface: socketcan, channel: vcan0}"  # in it


def register(commands: Commands) -> None:
    """Add the commands."""
    parser = commands.add_parser(
        "config",
        help="check a configuration, print an example, write a DCF",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.epilog = examples_of(parser.prog)
    parts = parser.add_subparsers(dest="part", required=True, metavar="check|example|dcf")
    add_command(parts, "check", "check a configuration", check).add_argument("config", metavar="CONFIG.yaml")
    add_command(parts, "example", "print an example", example)
    summary = "write a device configuration file (CiA 306) for a CANopen master"
    config_dcf.add_options(add_command(parts, "dcf", summary, config_dcf.write_dcf))


def check(options: argparse.Namespace) -> int:
    """Say what is in the configuration, or what is wrong with it, on this machine."""
    config = load_config(options.config, ANY_NODES)
    check_machine(Path(options.config), config)
    nodes: dict[str, list[str]] = {}
    for key, _, one in config.nodes:
        nodes.setdefault(key, []).append(f"{one.node_id:02X}h")
    lists = [f"; {key}: {', '.join(ids)}" for key, ids in nodes.items()]
    print(f"{options.config}: valid{''.join(lists)}")
    return 0


def example(options: argparse.Namespace) -> int:
    """Print an example configuration."""
    print(EXAMPLE, end="")
    return 0
