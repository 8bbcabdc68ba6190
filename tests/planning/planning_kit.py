"""A plan from a few words."""

import functools
from typing import Any

from canfb.configuration import Config
from canfb.hosting.hosting import saved_configuration
from canfb.module.device_configuration import DeviceConfiguration
from canfb.planning.plan import Plan
from canfb.planning.plan_input import PlanOptions, modules_alike, plan_of

RATE_HZ = 1000.0


def planned(modules: Any = 1, adc_bits: Any = 12, **stated: Any) -> Plan:
    """A plan of modules as delivered."""
    return plan_of(*delivered(modules, adc_bits), PlanOptions(**{"rate_hz": RATE_HZ, **stated}))


@functools.cache
def delivered(modules: int, adc_bits: int) -> tuple[Config, list[DeviceConfiguration]]:
    config = modules_alike(modules, adc_bits)
    return config, [saved_configuration(one) for one in config.modules]
