# Every target makes its own set-up: Python >= 3.11 with venv, make and git are enough.

PYTHON ?= python3
VENV := .venv
PY := $(VENV)/bin/python
PIP := $(PY) -m pip install --quiet --quiet --disable-pip-version-check
PYTEST := $(PY) -m pytest
WORKERS ?= auto
VCAN := $(PYTHON) tools/vcan.py
DEMO_OUT ?= build/demo
# The tests run side by side already: more threads of the linear algebra only wait for each other.
export OPENBLAS_NUM_THREADS ?= 1

# What pip has installed, one stamp for each set of extras; a change of pyproject.toml installs again.
INSTALLED := $(VENV)/.installed
INSTALLED_TEST := $(VENV)/.installed-test

.DEFAULT_GOAL := help
.PHONY: help demo test lint types unit socketcan bench format clean

help: ## Show the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / {printf "make %-10s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

demo: $(INSTALLED) ## Run the whole story on an in-process bus; pictures and report in build/demo
	$(VENV)/bin/canfb demo --out $(DEMO_OUT)

# The first part that fails ends the run, so the last line of pytest is that of the whole. The tests on a
# real SocketCAN come first: they are few. Where no vcan can be had, pytest lists them as skipped and why.
test: $(INSTALLED_TEST) ## Run all checks and all tests
	@$(MAKE) --no-print-directory lint types
	@if $(VCAN) check; then \
		$(MAKE) --no-print-directory socketcan && $(MAKE) --no-print-directory unit; \
	elif [ "$$CANFB_REQUIRE_VCAN" = 1 ]; then \
		echo "CANFB_REQUIRE_VCAN=1, and there is no vcan" >&2; exit 1; \
	else \
		$(PYTEST) -n $(WORKERS) --dist worksteal; \
	fi

lint: $(INSTALLED_TEST) ## Check style and format
	$(PY) -m ruff check
	$(PY) -m ruff format --check

types: $(INSTALLED_TEST) ## Check types
	$(PY) -m mypy

unit: $(INSTALLED_TEST) ## Run the tests that need no CAN interface
	$(PYTEST) -n $(WORKERS) --dist worksteal -m "not socketcan"

socketcan: $(INSTALLED_TEST) ## Run the tests on a real SocketCAN: this kernel's vcan, or one in user-mode Linux
	$(VCAN) run -- $(PYTEST) tests/socketcan

bench: $(INSTALLED_TEST) ## Measure the time of one cycle, and of whole arrays
	$(PY) tools/bench.py

format: $(INSTALLED_TEST) ## Write the code as the checks want it
	$(PY) -m ruff check --fix
	$(PY) -m ruff format

clean: ## Remove what was built, and the virtual environment
	rm -rf $(VENV) build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find src tests tools -name __pycache__ -type d -prune -exec rm -rf {} +

$(PY):
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed: make PYTHON=...")'
	@$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); echo "no venv module: apt-get install python3-venv" >&2; exit 1; }

$(INSTALLED): pyproject.toml | $(PY)
	@echo "installing canfb into $(VENV)"
	@$(PIP) --editable '.[plot]'
	@touch $@

$(INSTALLED_TEST): pyproject.toml | $(PY)
	@echo "installing canfb and what its tests need into $(VENV)"
	@$(PIP) --editable '.[test]'
	@touch $(INSTALLED) $@
