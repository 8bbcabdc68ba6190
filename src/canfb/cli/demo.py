"""``canfb demo``: the whole story on an in-process bus."""

from __future__ import annotations

import argparse
import json
import sys
from importlib.metadata import version
from pathlib import Path

from canfb.bus.clocks import page_date
from canfb.cli.options import Commands, add_command
from canfb.demo.account import account, figures
from canfb.demo.demo_network import DemoNetwork
from canfb.demo.demo_page import prepare, write_files
from canfb.demo.story import run_story


def register(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(commands, "demo", demo)
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for pictures (SVG) and report.html")


def demo(options: argparse.Namespace) -> int:
    """Run the demo; 0 if everything held, else 1."""
    if options.out:
        prepare(options.out)
    date = page_date() if options.out else ""
    network = DemoNetwork()
    show = None if options.json or not sys.stderr.isatty() else _progress
    story = run_story(network, show) if show else run_story(network)
    pictures: list[Path] = []
    page: Path | None = None
    if options.out:
        pictures, page = write_files(network, story, options.out, version("canfb"), date)
    if options.json:
        files = {"figures": [str(path) for path in pictures]} | ({"report": str(page)} if page else {})
        print(json.dumps(figures(story) | files, indent=2))
    else:
        print(account(story))
        for path in pictures:
            print(f"  picture  {path}")
        if page:
            print(f"  report   {page}")
    return 0 if story.held else 1


def _progress(text: str) -> None:
    print(f"... {text}", file=sys.stderr)
