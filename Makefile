# make demo | test | lint | bench, each on a bare machine: Python 3.10-3.13 is all it needs. Options pass through: make test ARGS="-k store"
# The environment is .venv in this folder; remove it by `make clean-venv`. PYTHON=python3.12 chooses the interpreter.
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help

VENV := .venv
BIN := $(VENV)/bin
ARGS ?=
PYTHON ?=
PIP := $(BIN)/python -m pip --disable-pip-version-check --no-input -qq

# .venv stands alone: a sourced ROS distribution would put its own rclpy before the wheels, and the wheels' start-up guard, inherited from
# another environment, would keep them from finding their libraries.
unexport PYTHONPATH AMENT_PREFIX_PATH PYTHONHOME VIRTUAL_ENV _ROS_WHEELS_BOOTSTRAP_COMPLETE

PACKAGE_FILES := pyproject.toml setup.py setup.cfg package.xml $(shell find launch config scripts resource -type f -o -type l 2>/dev/null)

.PHONY: help demo test lint bench venv clean-venv

help:
	@echo 'make demo    simulator, calibration and corrector as ROS 2 nodes, before and after, a report page'
	@echo 'make test    the tests          make lint    ruff and mypy'
	@echo 'make bench   the benchmarks     ARGS="..."   passed on'

demo: $(VENV)/.installed
	$(BIN)/gyro-calib demo $(ARGS)

# What computes runs side by side, one thread each; then what starts nodes, which mostly waits, by files in domains of their own. Discovery and
# best-effort samples are at the mercy of whatever else the machine does: what failed there is tried once more, alone, and fails if it fails again.
test: $(VENV)/.installed
ifeq ($(strip $(ARGS)),)
	@export OPENBLAS_NUM_THREADS=1; status=0; \
	$(BIN)/python -m pytest -n 2 --dist loadfile -m 'not slow and not ros' || status=1; \
	$(BIN)/python -m pytest -n 3 --dist loadfile -m 'ros and not slow' || \
	$(BIN)/python -m pytest -m 'ros and not slow' --last-failed --last-failed-no-failures none || status=1; \
	exit $$status
else
	$(BIN)/python -m pytest $(ARGS)
endif

bench: $(VENV)/.installed
	$(BIN)/python benchmarks/run.py $(ARGS)

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check $(ARGS) .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

venv: $(VENV)/.installed

clean-venv:
	rm -rf $(VENV)

# The stamps come last: an installation that was interrupted is taken up again.
$(VENV)/.installed: $(PACKAGE_FILES)
	@python=$$(bash scripts/find-python $(PYTHON)); \
	if ! $(BIN)/python -c 'import pip' 2>/dev/null; then \
		echo "Making $(VENV) with $$python ($$($$python -V))"; \
		$$python -m venv --clear $(VENV) || { echo "Python's venv module must work. On Debian and Ubuntu: apt install python3-venv" >&2; exit 1; }; \
	fi
	@echo 'Installing gyro_calib and what it needs into $(VENV) (a few minutes the first time)'
	@$(PIP) install -e '.[ros,viz,bags,fast,test]'
	@touch $@

$(VENV)/.installed-dev: $(VENV)/.installed
	@$(PIP) install -e '.[dev]'
	@touch $@
