"""``canfb why``: why a position is not valid, meaning of a status word; ``--bundle``: one file for support.

It only reads and listens: nothing on the bus changes.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from canfb.bus.clocks import local_time
from canfb.cli import node_options
from canfb.cli.options import (
    JSON,
    TIMEOUT,
    Commands,
    add_bus_options,
    add_command,
    bus_options,
    checked,
    group,
    named_config,
    nodes,
    option,
    positive,
    whole_number,
)
from canfb.configuration import ANY_NODES, Config, load_config
from canfb.diagnosis.lost import decoded, read_lost_position
from canfb.diagnosis.nodes_and_frames import frame_counts, node_facts, scan
from canfb.eds_files import EDS_NAMES, eds_path
from canfb.errors import CanfbError, ConfigError
from canfb.files import check_writable, write_whole
from canfb.master.access import CommissioningError, NodeAccess

LISTEN_S = 2.0
STATUS_WORD = checked(
    whole_number, lambda word: 0 <= word <= 0xFFFF, "is not a status word (0x0000 to 0xFFFF)"
)


def register(commands: Commands) -> None:
    add_command(
        commands,
        "why",
        why,
        nodes("node-ID of the module, or CONFIG.yaml"),
        option("--status", metavar="WORD", type=STATUS_WORD, help="only decode this status word: 0x0006"),
        JSON,
        group(
            "one file for support (--bundle)",
            option(
                "--bundle",
                action="store_true",
                help="write versions, settings, log, and objects of NODE (default: of CONFIG.yaml, or all)",
            ),
            option("--out", type=Path, metavar="FILE", help="file (canfb-diagnose-DATE-TIME.json); replaced"),
            option("--seconds", metavar="S", type=positive, default=LISTEN_S, help="how long to listen (2)"),
        ),
        TIMEOUT,
        add_bus_options,
        idle=(
            (["out", "seconds"], "bundle", True, "only with --bundle"),
            (["json"], "bundle", False, "not with --bundle, which writes JSON"),
            (["nodes", "config", "bundle"], "status", False, "not with --status, which needs no bus"),
        ),
    )


def diagnose(options: argparse.Namespace) -> int:
    """Write a support file; facts that are unavailable are listed with the reason."""
    from canfb.hosting import (
        self_diagnosis as facts,
    )  # imported here: only --bundle needs the code of a process that serves nodes

    path = options.out or Path(f"canfb-diagnose-{local_time():%Y%m%d-%H%M%S}.json")
    check_writable(path)
    parts: dict[str, Any] = {"versions": facts.versions()}
    config = Config()
    try:
        if options.config:
            config = load_config(options.config, ANY_NODES)
            parts["configuration"] = config
            parts["log"] = facts.journal(Path(options.config).stem)
    except CanfbError as error:
        parts["configuration_error"] = str(error)
        options.config = None  # its bus need not be the one of the options
    parts["bus"] = {}
    try:
        parts["bus"] = facts.interface_facts(bus_options(options, config.bus))
        _ask(options, config, parts)
    except CanfbError as error:
        parts["bus"]["error"] = str(error)
    write_whole(path, facts.diagnosis_text("canfb why --bundle", parts).encode())
    _say(path, parts)
    return 0


def _ask(options: argparse.Namespace, config: Config, parts: dict[str, Any]) -> None:
    known = [eds_path(name) for name in EDS_NAMES]
    with node_options.master_of(options) as master:
        parts["bus"]["frames"] = frame_counts(master, options.seconds)
        parts["bus"]["seconds"] = options.seconds
        chosen = options.nodes or config.node_ids
        if not chosen:
            found = scan(master, options.seconds)
            parts["bus"]["found"] = [one.figures() for one in found]
            chosen = [one.node for one in found]
        parts["nodes"] = [node_facts(master, node_id, known) for node_id in chosen]


def _say(path: Path, parts: dict[str, Any]) -> None:
    missing = [said for said in (parts.get("configuration_error"), parts["bus"].get("error")) if said]
    for node in parts.get("nodes", []):
        print(f"node {node['node_id']} ({node['node_id']:02X}h): {len(node.get('objects', {}))} objects")
        missing += [node["error"]] if "error" in node else []
    print(f"written  {path}")
    if missing:
        raise CommissioningError(f"{path} is incomplete: {'; '.join(missing)}")


def why(options: argparse.Namespace) -> int:
    if options.bundle:
        return diagnose(options)
    if options.status is not None:
        return node_options.say_result(options, decoded(options.status))
    chosen = options.nodes or [one.node_id for one in named_config(options).modules]
    if len(chosen) != 1:
        raise ConfigError("one NODE is required, a node-ID such as 32 or 0x20; several with --bundle only")
    with node_options.master_of(options) as master:
        found = read_lost_position(NodeAccess(master, chosen[0], "module"))
    return node_options.say_result(options, found.result())
