"""What `import canfb` gives, and `python -m canfb`."""

import inspect
from importlib.metadata import version
from pathlib import Path

import pytest

import canfb
from folding import each
from processes import python

# Section 3 of the design: names that users rely on.
CONTRACT = """
    phase_in_cycle CorrectionTable Tracker track SignalChain process calibrate_from_zero_crossings
    calibrate_from_motion max_acceleration FeedbackModule ModuleConfig Frame load_config CanfbError
    CalibrationError StateFiles eds_path
"""
# What these take, give and raise; named in the contract without a place of their own, or added.
ADDITIONS = """
    AdaptConfig BusError Calibration ChainConfig ChainResult Conditioning Config ConfigError Drift Feedback
    Sample SecondPositionConfig SecondSensor StatusBit Track TrackResult drift max_speed process_stream
"""
# What the design says of their use: parameters by name, in order, with the defaults that it states.
SIGNATURES = {
    "phase_in_cycle": ["sine", "cosine"],
    "CorrectionTable": ["entries"],
    "Tracker": ["residual_limit"],
    "Tracker.update": ["self", "phase", "elapsed"],
    "track": ["phase", "residual_limit"],
    "SignalChain.step": ["self", "sample"],
    "process": ["sine", "cosine", "table", "residual_limit"],
    "calibrate_from_zero_crossings": ["sine", "cosine", "conditioning"],
    "calibrate_from_motion": ["sine", "cosine", "conditioning"],
    "max_acceleration": ["cycles_per_revolution", "sample_rate_hz", "residual_limit"],
    "FeedbackModule": ["config"],
    "FeedbackModule.start": ["self", "now"],
    "FeedbackModule.receive": ["self", "frame", "now"],
    "FeedbackModule.tick": ["self", "now"],
    "FeedbackModule.deadline": ["self"],
    "Frame": ["can_id", "data", "rtr", "timestamp"],
    "load_config": ["path"],
    "StateFiles": ["folder"],
    "eds_path": ["name"],
}
DEFAULTS = {
    ("Tracker", "residual_limit"): 1 / 3, ("Tracker.update", "elapsed"): 1.0,
    ("track", "residual_limit"): 1 / 3, ("process", "table"): None, ("process", "residual_limit"): 1 / 3,
    ("calibrate_from_zero_crossings", "conditioning"): None,
    ("calibrate_from_motion", "conditioning"): None, ("max_acceleration", "residual_limit"): 0.5,
    ("Frame", "rtr"): False, ("Frame", "timestamp"): None,
}  # fmt: skip


def signature_of(name: str) -> inspect.Signature:
    thing: object = canfb
    for word in name.split("."):
        thing = getattr(thing, word)
    return inspect.signature(thing)  # type: ignore[arg-type]


def test_the_exports_are_the_contract_and_what_is_stated_here() -> None:
    assert set(canfb.__all__) == {*CONTRACT.split(), *ADDITIONS.split()}
    assert len(canfb.__all__) == len(set(canfb.__all__))


@each("name", canfb.__all__)
def test_each_is_there_and_comes_from_the_package(name: str) -> None:
    thing = getattr(canfb, name)
    assert thing.__name__ == name
    assert thing.__module__.startswith("canfb.")


@pytest.mark.parametrize("name", SIGNATURES)
def test_parameters_are_those_of_the_contract(name: str) -> None:
    assert list(signature_of(name).parameters)[: len(SIGNATURES[name])] == SIGNATURES[name]


@pytest.mark.parametrize(("name", "parameter"), DEFAULTS)
def test_defaults_are_those_of_the_contract(name: str, parameter: str) -> None:
    assert signature_of(name).parameters[parameter].default == DEFAULTS[name, parameter]


def test_the_config_of_a_module_needs_its_node_id_alone() -> None:
    config = canfb.ModuleConfig(node_id=32)
    assert (config.encoder_interface, config.cycles_per_revolution, config.adc_bits) == (16, 2500, 12)
    with pytest.raises(TypeError, match="node_id"):
        canfb.ModuleConfig()  # type: ignore[call-arg]


def test_tracks_and_tables_have_what_the_contract_says() -> None:
    assert canfb.Track._fields == ("cycles", "phase", "residual", "ok")
    assert tuple(canfb.TrackResult.__dataclass_fields__) == canfb.Track._fields
    table = canfb.CorrectionTable.identity()
    assert len(table) == 256
    assert canfb.CorrectionTable.from_bytes(table.to_bytes()).crc32 == table.crc32


@pytest.mark.parametrize("name", ["CalibrationError", "ConfigError", "BusError"])
def test_every_error_is_one_of_ours(name: str) -> None:
    assert issubclass(getattr(canfb, name), canfb.CanfbError)


def test_a_refused_measurement_says_why() -> None:
    error = canfb.CalibrationError("too short", "samples")
    assert (error.reason, error.calibration, str(error)) == ("samples", None, "too short")


def test_import_is_clean_and_brings_in_no_bus_and_no_pictures() -> None:
    """Importing the package must not warn, open anything, or load what only single commands need."""
    unwanted = "canfb.bus", "canfb.hosting", "canfb.cli", "canfb.demo", "canfb.report"
    code = f"import canfb, sys; print(*(name for name in {unwanted} if name in sys.modules))"
    done = python("-W", "error", "-c", code)
    assert (done.returncode, done.stdout, done.stderr) == (0, "\n", "")


def test_the_version_is_that_of_the_package() -> None:
    done = python("-W", "error", "-m", "canfb", "--version")
    assert (done.returncode, done.stdout, done.stderr) == (0, f"canfb {version('canfb')}\n", "")
    assert canfb.__version__ == version("canfb")
    with pytest.raises(AttributeError, match="no attribute 'versions'"):
        _ = canfb.versions


def test_a_module_of_ones_own_saves_in_a_folder(tmp_path: Path) -> None:
    heartbeat, save = bytes.fromhex("2B171000F4010000"), bytes.fromhex("2310100173617665")
    for saved in (False, True):
        with canfb.StateFiles(tmp_path / "state") as store:
            module = canfb.FeedbackModule(canfb.ModuleConfig(node_id=32), store)
            module.start(0.0)
            assert module.dictionary.entry(0x1017).value == (500 if saved else 0)
            for number, data in enumerate((heartbeat, save)):
                (answer,) = module.receive(canfb.Frame(0x620, data), 0.1 * number)
                assert answer.data[0] == 0x60
