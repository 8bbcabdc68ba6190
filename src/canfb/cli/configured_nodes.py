"""The nodes of a configuration, for the commands that speak to them."""

from __future__ import annotations

from canfb.configuration import Config


def nodes_of(config: Config) -> list[tuple[int, int | None]]:
    """Module and encoder interface, None for a module that samples itself."""
    modules = config.modules
    return [(one.node_id, None if one.source is not None else one.encoder_interface) for one in modules]
