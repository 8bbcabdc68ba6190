"""``canfb try``: module, encoder interface, SYNC, NMT and the page on a private bus, in one command."""

from __future__ import annotations

import _thread
import argparse
import contextlib
import json
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path

from canfb.bus.clocks import page_date
from canfb.bus.opening import describe, group_port
from canfb.bus.runner import ending_on_signals
from canfb.cli.commands import build_parser
from canfb.cli.options import (
    JITTER,
    PORTS,
    READY_FILE,
    Commands,
    add_command,
    between,
    group,
    jittered,
    option,
)
from canfb.cli.printing import PRINTING, Progress, say
from canfb.configuration import load_config
from canfb.files import check_writable, prepare_folder, write_whole
from canfb.hosting.event_log import summary_of
from canfb.hosting.readiness import Readiness
from canfb.hosting.trying import NetworkOnBus, private_bus
from canfb.rows import those

# At lower rates the machine of the example accelerates too much between SYNCs.
RATES = between(50.0, 1000.0, " Hz")
OF_THE_NETWORK = ("rate", "jitter", "no_page", "port", "ready_file", "write_config")


def register(commands: Commands) -> None:
    add_command(
        commands,
        "try",
        try_it,
        group(
            "the story (also as: canfb demo)",
            option(
                "--story",
                action="store_true",
                help="start, track, calibrate, verify and survive faults on an in-process bus, and end",
            ),
            option("--out", type=Path, metavar="DIR", help="folder for pictures (SVG) and report.html"),
        ),
        option(
            "--rate",
            type=float,
            within=RATES,
            default=100.0,
            metavar="HZ",
            help="SYNC rate, 50 to 1000 (100)",
        ),
        JITTER,
        option("--no-page", action="store_true", help="serve no page"),
        option(
            "--port",
            metavar="N",
            type=int,
            within=PORTS,
            default=0,
            help="of the page; default: any free port",
        ),
        option("--json", action="store_true", help="print one JSON object a line"),
        option("--write-config", type=Path, metavar="FILE", help="write the configuration, for log replay"),
        READY_FILE,
        idle=(
            (OF_THE_NETWORK, "story", False, "not with --story"),
            (["out"], "story", True, "only with --story"),
        ),
    )


def try_it(options: argparse.Namespace) -> int:
    if options.story:
        return _tell_story(options)
    from canfb.cli.config_file import EXAMPLE, EXAMPLE_BUS  # here: a command imports others only when needed

    with contextlib.ExitStack() as held:
        PRINTING.as_json = options.json
        words = held.enter_context(private_bus())
        path = Path(held.enter_context(tempfile.TemporaryDirectory(prefix="canfb-try-")), "feedback.yaml")
        path.write_text(EXAMPLE.replace(EXAMPLE_BUS, json.dumps(words)), encoding="utf-8")
        if options.write_config is not None:
            check_writable(options.write_config, "--write-config")
            write_whole(options.write_config, path.read_bytes())
        with NetworkOnBus(jittered(load_config(path), options), options.rate) as network:
            _serve(options, network, path)
    summary = summary_of(network.module)
    say(json.dumps({"event": "end", "text": summary}) if options.json else summary)
    return 0


def _serve(options: argparse.Namespace, network: NetworkOnBus, path: Path) -> None:
    if options.no_page:
        with Readiness(options.ready_file) as readiness, ending_on_signals(network.stop):
            readiness.ready()
            _tell(options, network, None)
            network.wait()
        return
    from canfb.cli.monitor import monitor  # here: a command imports others only when needed

    network.on_end = _thread.interrupt_main  # the effect of Ctrl-C, from any thread
    words = ["monitor", "--web", "--config", str(path), "--sdo", "--port", str(options.port)]
    if options.ready_file is not None:
        words += ["--ready-file", options.ready_file]
    page_options = build_parser("monitor").parse_args(words)
    page_options.opened = lambda address: _tell(options, network, address)
    monitor(page_options)


def _tell(options: argparse.Namespace, network: NetworkOnBus, address: str | None) -> None:
    (module,) = network.config.modules
    words = network.config.bus
    group = str(words["channel"])
    bus = f"-i {words['interface']} -c {group}"
    following = [
        f"canfb monitor 0x{module.node_id:02X} --sdo {bus}",
        f'canfb sdo read 0x{module.node_id:02X} "status word" {bus}',
        f"canfb calibrate 0x{module.node_id:02X} --out measured {bus}",
    ]
    said = {
        "event": "ready",
        "page": address,
        "interface": words["interface"],
        "channel": group,
        "port": group_port(group),
        "rate_hz": options.rate,
        "node_id": module.node_id,
        "encoder_interface": module.encoder_interface,
        "commands": following,
    }
    nodes = f"node {module.node_id} ({module.node_id:02X}h), its encoder interface and SYNC"
    lines = [
        f"running {nodes} at {options.rate:g} Hz on {describe(words)}; end with Ctrl-C",
        *those((address, f"open {address}")),
        "next, in another terminal:",
        *(f"  {line}" for line in following),
    ]
    say(json.dumps(said) if options.json else "\n".join(lines))


def _tell_story(options: argparse.Namespace) -> int:
    from canfb.demo.demo_page import account, figures, write_files
    from canfb.demo.story import (
        DemoNetwork,  # imported here: only --story needs it
        run_story,
    )

    if options.out:
        prepare_folder(options.out, "demo")
    date = page_date() if options.out else ""  # raises for a wrong SOURCE_DATE_EPOCH before the work
    network = DemoNetwork()
    story = run_story(network, Progress(options.json or not sys.stderr.isatty()).step)
    pictures, page = (
        write_files(network, story, options.out, version("canfb"), date) if options.out else ([], None)
    )
    written = {"figures": [str(path) for path in pictures]} | ({"report": str(page)} if page else {})
    lines = [f"  picture  {path}" for path in pictures] + [f"  report   {page}"] * bool(page)
    print(
        json.dumps(figures(story) | written, indent=2)
        if options.json
        else "\n".join([account(story), *lines])
    )
    return 0 if story.held else 1
