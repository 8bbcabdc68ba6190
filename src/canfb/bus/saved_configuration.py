"""The configuration of a module with what it has saved, without a bus."""

from __future__ import annotations

from canfb.bus.saved_parameters import SavedParameters
from canfb.errors import CanfbError, ConfigError
from canfb.module.device_configuration import DeviceConfiguration, configuration_of
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import UNCONFIGURED, ModuleConfig


def saved_configuration(config: ModuleConfig) -> DeviceConfiguration:
    """The module as it comes up: its configuration, and over it what is saved in its state_dir.

    ConfigError when it has no node-ID, CanfbError when what is saved is refused.
    """
    store = None if config.state_dir is None else SavedParameters(config.state_dir)
    module = FeedbackModule(config, store, source=None if config.source is None else _NoSource())
    module.start(0.0)
    if module.node.node_id == UNCONFIGURED:
        raise ConfigError(
            f"the module with serial number {config.serial_number} has no node-ID yet; a DCF needs one: "
            "set node_id in the configuration, or assign one by LSS"
        )
    for group, why in module.node.storage.faults.items():
        raise CanfbError(f"stored {group.name.lower()} parameters in {config.state_dir} refused: {why}")
    return configuration_of(module)


class _NoSource:
    """Stands in for a source that is never read."""

    def next(self) -> None:
        """No sample."""
