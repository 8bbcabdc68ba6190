"""A configuration without ``--config``, beside other arguments: as ``canfb run`` takes it."""

from __future__ import annotations

import argparse

from canfb.cli.options import node_number
from canfb.errors import ConfigError


def is_yaml(text: str) -> bool:
    """It is named like a configuration."""
    return text.endswith((".yaml", ".yml"))


def yaml_file(text: str) -> str:
    """A configuration, CONFIG.yaml: a type for argparse."""
    if not is_yaml(text):
        raise argparse.ArgumentTypeError(f"{text!r} is no CONFIG.yaml; a name of several words needs quotes")
    return text


def node_or_yaml(text: str) -> int | str:
    """A node-ID, or a configuration; :func:`take_yaml` tells them apart. A type for argparse."""
    return text if is_yaml(text) else node_number(text)


def take_yaml(options: argparse.Namespace) -> None:
    """Move a configuration among ``options.nodes`` to ``options.config``. ConfigError for several."""
    files = [one for one in options.nodes if isinstance(one, str)]
    if len(files) + (options.config is not None) > 1:
        raise ConfigError(f"{files[-1]}: there is another configuration already; one is taken")
    options.nodes = [one for one in options.nodes if not isinstance(one, str)]
    options.config = files[0] if files else options.config
