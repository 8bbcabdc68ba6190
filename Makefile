# Every target makes its own set-up: Python >= 3.11 with venv, make and git are enough.

PYTHON ?= python3
VENV := .venv
PY := $(VENV)/bin/python
PIP := $(PY) -m pip install --quiet --quiet --disable-pip-version-check
PYTEST := $(PY) -m pytest
WORKERS ?= auto
VCAN := $(PYTHON) -m tools.vcan
DEMO_OUT ?= build/demo
# The tests run side by side already: more threads of the linear algebra only wait for each other.
export OPENBLAS_NUM_THREADS ?= 1
# Where this is set (in container images), each of some hundred processes compiles canfb again, and each pytest
# all tests: 12 s of processor time.
unexport PYTHONDONTWRITEBYTECODE

# What pip has installed, one stamp for each set of extras; a change of pyproject.toml installs again.
INSTALLED := $(VENV)/.installed
INSTALLED_TEST := $(VENV)/.installed-test
LOWEST := .venv-lowest
MUTATED ?= $(addprefix src/canfb/signal/,supervision.py \
	witness/witness.py witness/zero_pulse.py witness/reference.py)

PARTS ?= unit lint types socketcan site package $(MORE)
VERDICTS := build/verdicts.txt
# What a part says comes at its end, so that two do not mix; the make of macOS (3.81) cannot do this.
SYNCED := $(if $(filter output-sync,$(.FEATURES)),--output-sync=target)

.DEFAULT_GOAL := help
.PHONY: help demo check test lint types unit socketcan package site lowest mutate bench format clean

help: ## Show the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / {printf "make %-10s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

demo: $(INSTALLED) ## Run the whole story on an in-process bus; pictures in build/demo/report.html
	$(VENV)/bin/canfb demo --out $(DEMO_OUT)

# For use while writing: all rooms, without what takes long (tests/long_tests.txt), five examples of a property.
check: lint $(INSTALLED_TEST) ## Check style and types, and run what takes less than 0.05 s, in a minute
	$(PY) -m mypy
	$(PYTEST) -q -n $(WORKERS) --dist worksteal -m "not long and not socketcan" --hypothesis-profile check

# Each part has its own verdict, whatever becomes of the others; make fails if one of them does. Two run at a time:
# the unit tests, and beside them the others, of which those on a real SocketCAN wait more than they compute.
test: $(INSTALLED_TEST) ## Run all checks and all tests
	@mkdir -p build && : >$(VERDICTS)
	@$(MAKE) --no-print-directory --keep-going --jobs=2 $(SYNCED) $(addprefix part-,$(PARTS)); \
		status=$$?; cat $(VERDICTS); exit $$status

part-%:
	@if $(MAKE) --no-print-directory $*; then echo "$*: passed" >>$(VERDICTS); \
		else echo "$*: FAILED" >>$(VERDICTS); exit 1; fi

lint: $(INSTALLED_TEST) ## Check style and format
	$(PY) -m ruff check --no-cache
	$(PY) -m ruff format --check

types: $(INSTALLED_TEST) ## Check types
	$(PY) -m mypy
	$(PY) -m mypy --config-file tests/mypy.ini
	set -e; for file in tests/conftest.py tests/*/conftest.py; do $(PY) -m mypy --config-file tests/mypy.ini $$file; done

unit: $(INSTALLED_TEST) ## Run the tests that need no CAN interface
	$(PYTEST) -n $(WORKERS) --dist worksteal -m "not socketcan"

# Where no vcan can be had, pytest lists these tests as skipped and why; with CANFB_REQUIRE_VCAN=1 they fail.
socketcan: $(INSTALLED_TEST) ## Run the tests on a real SocketCAN: this kernel's vcan, or one in user-mode Linux
	@if $(VCAN) check; then $(VCAN) run -- $(PYTEST) tests/socketcan; else $(PYTEST) tests/socketcan; fi

package: $(INSTALLED_TEST) ## Build sdist and wheel into dist, check them, and run the demo from the wheel
	$(PY) -m tools.suite.package

site: $(INSTALLED_TEST) ## Build the documentation site, strictly, in build/site/html
	rm -rf build/site
	$(PY) -m sphinx -E -q -W --keep-going -c tools/site -d build/site/doctrees . build/site/html

# A wheel of each for Python 3.11 and 3.12; newer Pythons need newer versions anyway.
lowest: $(LOWEST)/.installed ## Run a part of the tests with the lowest versions that pyproject.toml allows
	$(LOWEST)/bin/python -m pytest tests/bus/test_opening.py tests/bus/test_runner.py tests/cli/test_main.py \
		tests/cli/test_config_command.py tests/cli/test_simulate_command.py tests/module/test_feedback_module.py \
		tests/calibrate/test_calibration_page.py tests/test_exports.py

# What watches over the position: a change that no test notices is one that a mistake could be.
mutate: $(INSTALLED_TEST) ## Change the supervision in one place at a time, and see whether the tests notice
	$(PY) -m tools.suite.mutate $(MUTATED) --allow tests/signal/known_survivors.txt -- tests/signal

bench: $(INSTALLED_TEST) ## Measure the time of one cycle, and of whole arrays
	$(PY) -m tools.bench.cycle

format: $(INSTALLED_TEST) ## Write the code as the checks want it
	$(PY) -m ruff check --fix
	$(PY) -m ruff format

clean: ## Remove what was built, and the virtual environment
	rm -rf $(VENV) .venv-* build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find src tests tools -name __pycache__ -type d -prune -exec rm -rf {} +

$(PY):
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed: make PYTHON=...")'
	@$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); echo "no venv module: apt-get install python3-venv" >&2; exit 1; }

$(INSTALLED): pyproject.toml | $(PY)
	@echo "installing canfb into $(VENV)"
	@$(PIP) --editable '.[monitor]'
	@touch $@

$(INSTALLED_TEST): pyproject.toml | $(PY)
	@echo "installing canfb and what its tests need into $(VENV)"
	@$(PIP) --editable '.[test]'
	@touch $(INSTALLED) $@

$(LOWEST)/.installed: pyproject.toml
	@echo "installing canfb with the lowest versions into $(LOWEST)"
	@$(PYTHON) -m venv --clear $(LOWEST)
	@$(LOWEST)/bin/python -m pip install --quiet --quiet --disable-pip-version-check uv pytest hypothesis
	@$(LOWEST)/bin/uv pip install --quiet --python $(LOWEST)/bin/python --resolution lowest-direct \
		--editable '.[monitor]'
	@touch $@
