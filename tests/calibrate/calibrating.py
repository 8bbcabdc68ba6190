"""`canfb calibrate` on a bench, and what the position of its module is worth."""

from typing import Any

import numpy as np

from canfb.cli.calibrate import measured, measured_nodes
from canfb.cli.commands import build_parser
from canfb.cli.printing import Progress
from canfb.configuration import Config
from canfb.files import prepare_folder
from canfb.master.all_or_nothing import Guard
from commissioning_kit import Bench, EmbeddedMaster

SHORT = ("--seconds", "1.5", "--least-samples", "1000", "--verify", "0.6")


def command(
    master: EmbeddedMaster,
    *arguments: str,
    config: Config | None = None,
    progress: Progress | None = None,
    guard: Guard | None = None,
) -> int:
    """`canfb calibrate ARGUMENT...`; its exit status."""
    options = build_parser().parse_args(["calibrate", *arguments])
    if options.out:
        prepare_folder(options.out, "calibrate")
    nodes, guard, quiet = measured_nodes(options, config or Config()), guard or Guard(), Progress(quiet=True)
    return measured(options, progress or quiet, "2026-03-01", lambda run: run.over_bus(master, *nodes, guard))


def calibrate(bench: Bench, *arguments: str, **words: Any) -> int:
    """The same with a short measurement."""
    return command(bench.master, *SHORT, *arguments, **words)


def position_errors(bench: Bench, samples: int) -> Any:
    """Error of the module's position, cycles, against the truth, mean taken off."""
    errors = []
    for _ in range(samples):
        bench.bus.run_until(bench.bus.now + 0.001)
        feedback = bench.module.feedback
        assert feedback is not None
        errors.append(feedback.phase - bench.source.source.position_cycles)
    off = np.mod(errors, 1.0)
    middle = np.angle(np.mean(np.exp(2j * np.pi * off))) / (2 * np.pi)
    off = (off - middle + 0.5) % 1.0 - 0.5
    return off - off.mean()
