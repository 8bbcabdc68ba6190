"""CANopen drive feedback module: sine/cosine encoder tracks in, a supervised position out.

The method is that of Hoescheler and Szamel (1997): phase by division (Table 1), an
individual correction table, cycle count by second-order prediction (eq. 9), error
detection by the residual (eq. 12).
"""

from __future__ import annotations

from importlib import import_module

TYPE_CHECKING = False  # as in typing, which takes longer to load than all else here

if TYPE_CHECKING:  # what type checkers and readers see; at run time __getattr__ does it
    from canfb.calibration.methods import calibrate_from_motion, calibrate_from_zero_crossings
    from canfb.calibration.result import Calibration, Drift, drift
    from canfb.cia301.frame import Frame
    from canfb.configuration import Config, load_config
    from canfb.eds_files import eds_path
    from canfb.errors import BusError, CalibrationError, CanfbError, ConfigError
    from canfb.hosting.state_files import StateFiles
    from canfb.module.feedback_module import FeedbackModule
    from canfb.module.module_config import ModuleConfig, SecondPositionConfig
    from canfb.objects import StatusBit
    from canfb.signal.adaptation import AdaptConfig
    from canfb.signal.chain import SignalChain
    from canfb.signal.chain_config import ChainConfig
    from canfb.signal.conditioning import Conditioning
    from canfb.signal.correction import CorrectionTable
    from canfb.signal.limits import max_acceleration, max_speed
    from canfb.signal.phase import phase_in_cycle
    from canfb.signal.sample import Feedback, Sample
    from canfb.signal.second_position import SecondSensor
    from canfb.signal.stream import ChainResult, process, process_stream
    from canfb.signal.tracker import Track, Tracker, TrackResult, track

__all__ = [
    "AdaptConfig",
    "BusError",
    "Calibration",
    "CalibrationError",
    "CanfbError",
    "ChainConfig",
    "ChainResult",
    "Conditioning",
    "Config",
    "ConfigError",
    "CorrectionTable",
    "Drift",
    "Feedback",
    "FeedbackModule",
    "Frame",
    "ModuleConfig",
    "Sample",
    "SecondPositionConfig",
    "SecondSensor",
    "SignalChain",
    "StateFiles",
    "StatusBit",
    "Track",
    "TrackResult",
    "Tracker",
    "calibrate_from_motion",
    "calibrate_from_zero_crossings",
    "drift",
    "eds_path",
    "load_config",
    "max_acceleration",
    "max_speed",
    "phase_in_cycle",
    "process",
    "process_stream",
    "track",
]

# The same names for __getattr__; a test compares both.
_PLACES = {
    "hosting.state_files": ("StateFiles",),
    "calibration.methods": ("calibrate_from_motion", "calibrate_from_zero_crossings"),
    "calibration.result": ("Calibration", "Drift", "drift"),
    "cia301.frame": ("Frame",),
    "configuration": ("Config", "load_config"),
    "eds_files": ("eds_path",),
    "errors": ("BusError", "CalibrationError", "CanfbError", "ConfigError"),
    "module.feedback_module": ("FeedbackModule",),
    "module.module_config": ("ModuleConfig", "SecondPositionConfig"),
    "objects": ("StatusBit",),
    "signal.adaptation": ("AdaptConfig",),
    "signal.chain": ("SignalChain",),
    "signal.chain_config": ("ChainConfig",),
    "signal.conditioning": ("Conditioning",),
    "signal.correction": ("CorrectionTable",),
    "signal.limits": ("max_acceleration", "max_speed"),
    "signal.phase": ("phase_in_cycle",),
    "signal.sample": ("Feedback", "Sample"),
    "signal.second_position": ("SecondSensor",),
    "signal.stream": ("ChainResult", "process", "process_stream"),
    "signal.tracker": ("Track", "Tracker", "TrackResult", "track"),
}


def __getattr__(name: str) -> object:
    """A public name, or ``__version__`` (that of the installed package): loaded when it is first used.

    So ``import canfb`` loads neither numpy nor what speaks to a bus, and each program only what it uses.
    """
    if name == "__version__":
        from importlib.metadata import version

        return version("canfb")
    for place, names in _PLACES.items():
        if name in names:
            thing: object = getattr(import_module(f"canfb.{place}"), name)
            globals()[name] = thing
            return thing
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """All public names, loaded or not."""
    return sorted({*globals(), *__all__, "__version__"})
