"""What is loaded when: `import canfb` and a command load what they use, and no more."""

import ast
import inspect
from pathlib import Path

import pytest

import canfb
from processes import python

# Slow to import: together many times the rest of a start.
HEAVY = ("numpy", "can", "canopen", "yaml", "msgpack", "canfb.simulation")
# What each use may load of these.
USES: dict[str, set[str]] = {
    "import canfb": set(),
    "from canfb import CanfbError, Frame, StatusBit, eds_path": set(),
    "from canfb import phase_in_cycle, process, calibrate_from_motion": {"numpy"},
    "from canfb import ModuleConfig": {"numpy"},
    "from canfb import load_config": {"numpy", "yaml"},
    "import canfb; canfb.FeedbackModule(canfb.ModuleConfig(node_id=1))": {"numpy"},
    "from canfb.cli.run import Hosting; from canfb.configuration import parse_config; "
    "Hosting(parse_config('modules: [{node_id: 32}]'))": {"numpy", "yaml", "can", "canopen", "msgpack"},
    "from canfb.cli.main import main; main([])": set(),
    "from canfb.cli.main import main; main(['--help'])": set(),
    "from canfb.cli.main import main; main(['--version'])": set(),
    "from canfb.cli.main import main; main(['no-command'])": set(),
}


def loaded_by(statement: str) -> set[str]:
    code = f"{statement}\nimport sys\nprint('loaded', *({{*{HEAVY}}} & set(sys.modules)))"
    done = python("-c", code)
    return set(done.stdout.splitlines()[-1].split()[1:])


@pytest.mark.parametrize("statement", USES)
def test_a_use_loads_no_more_than_it_needs(statement: str) -> None:
    assert loaded_by(statement) == USES[statement]


def test_the_test_sees_what_is_loaded() -> None:
    assert loaded_by("import canfb, canopen; canfb.track") >= {"numpy", "can", "canopen"}


def test_each_public_name_is_where_the_type_checker_finds_it() -> None:
    tree = ast.parse(Path(canfb.__file__).read_text(encoding="utf-8"))
    checked = {
        alias.name: node.module
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module is not None and node.module.startswith("canfb.")
        for alias in node.names
    }
    places = {name: f"canfb.{place}" for place, names in canfb._PLACES.items() for name in names}
    assert places == checked
    assert sorted(places) == sorted(canfb.__all__)


def test_names_are_listed_before_they_are_loaded() -> None:
    code = "import canfb; print(*dir(canfb)); from canfb import *; print(FeedbackModule.__name__, track)"
    done = python("-c", code)
    assert set(done.stdout.splitlines()[0].split()) >= {*canfb.__all__, "__version__"}
    assert done.stdout.splitlines()[1].startswith("FeedbackModule ")
    assert inspect.isclass(canfb.Tracker)
    assert vars(canfb)["Tracker"] is canfb.Tracker
