"""Run one command of a command line.

Exit codes: 0 done, 1 failed, 2 wrong use or configuration. An error is one line on stderr; ``--debug`` shows
the traceback before it, with the same exit code.
"""

import io
import logging
import os
import shlex
import sys
import traceback
from collections.abc import Sequence

from canfb.bus.line_output import FULL
from canfb.cli.aliases import current
from canfb.cli.commands import WRONG_USE, build_parser, named_command
from canfb.cli.options import refuse_combinations
from canfb.cli.printing import drop_output, print_line, printed_log
from canfb.errors import CanfbError, ConfigError

FAILED = 1


def run(arguments: Sequence[str] | None) -> int:
    """Run one command (without one: print the help); returns the exit code."""
    arguments = sys.argv[1:] if arguments is None else arguments
    # More threads save 10 %, but with another busy program they make a calibration six times slower.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if "_ARGCOMPLETE" in os.environ:
        from canfb.cli import completion  # imported here because only the shell needs it

        completion.answer(os.environ)
        return FAILED
    sys.stdout = sys.stdout or open(os.devnull, "w")  # noqa: SIM115 - None: closed (>&-)
    sys.stderr = sys.stderr or open(os.devnull, "w")  # noqa: SIM115
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # for terminals without µ and ″
    try:
        code = _run(arguments or ["--help"])
        sys.stdout.flush()
    except BrokenPipeError:  # the reader has ended, as in `canfb demo | head`
        drop_output(sys.stdout)
        return FAILED
    except OSError as error:
        if "--debug" in arguments:
            traceback.print_exc()
        is_output = error.filename is None and error.errno in FULL
        where = "cannot write the output: " if is_output else f"{error.filename}: " * bool(error.filename)
        print(f"canfb: {where}{error.strerror or error}", file=sys.stderr)
        drop_output(sys.stdout)
        return FAILED
    return code


def _run(arguments: Sequence[str]) -> int:
    line = shlex.join(["canfb", *arguments])  # command line, for reports
    arguments, said = current(arguments)
    if said:
        print_line(f"canfb: {said}", sys.stderr)
    parser = build_parser(named_command(arguments))
    try:
        options = parser.parse_args(arguments)
    except SystemExit as end:  # argparse has printed its message
        return int(end.code or 0)
    options.line = line
    # python-can also logs errors that it raises; here an error is one line.
    logging.basicConfig(level=logging.INFO if options.debug else logging.CRITICAL)
    try:
        with printed_log():
            refuse_combinations(options)
            return int(options.action(options))
    except CanfbError as error:
        if options.debug:
            traceback.print_exc()
        print(f"canfb: {error}", file=sys.stderr)
        return WRONG_USE if isinstance(error, ConfigError) else FAILED
