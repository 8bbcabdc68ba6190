"""The object dictionary of a module as a configuration delivers it: the EDS, with its defaults replaced."""

from __future__ import annotations

from canfb.device.od.dictionary import Dictionary
from canfb.eds_files import eds_path
from canfb.module.module_config import ModuleConfig
from canfb.module.parameters import apply_defaults, configured_defaults, without_adc_pdo

EDS = "canfb-module"


def delivered_dictionary(config: ModuleConfig, *, samples_itself: bool = False) -> Dictionary:
    """All objects with the values of the first power-on; nothing saved is in it.

    ``samples_itself``: a source takes the place of the ADC PDO.
    """
    dictionary = Dictionary.load(eds_path(EDS), config.node_id)
    apply_defaults(dictionary, configured_defaults(config))
    if samples_itself:
        apply_defaults(dictionary, without_adc_pdo(config))
    return dictionary
