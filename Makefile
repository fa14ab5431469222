# Everything runs in .venv, which is made on first use, and made anew when pyproject.toml, constraints.txt, the Python
# or the place of this folder changes. Another Python: make PYTHON=/path/to/python3 test

VENV  := .venv
STAMP := $(VENV)/made-for
RUN   := $(VENV)/bin/python

ifndef PYTHON
PYTHON := $(shell for python in python3.11 python3 python3.12 python3.13 python3.14; do \
	"$$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo "$$python" && break; done)
endif

# What a virtual environment cannot survive a change of: its shebangs and its editable install hold both.
IDENTIFY := "$(PYTHON)" -c 'import os, platform; print("Python", platform.python_version(), "in", os.getcwd())'
ifneq ($(shell cat $(STAMP) 2>/dev/null),$(shell $(IDENTIFY) 2>/dev/null))
.PHONY: $(STAMP)
endif

.PHONY: help demo test test-lowest test-judges test-kernel check bench fixtures reference man site firmware clean

help:
	@echo "make demo         calibrate a virtual sensor, show what that does to a recorded log, and write its report"
	@echo "make test         run the tests"
	@echo "make test-judges  let drivers by other hands, and Linux's in QEMU, read our virtual parts"
	@echo "make test-lowest  run one command of each kind with the lowest versions that pyproject.toml admits"
	@echo "make test-kernel  run the GPIO driver, and Linux's drivers of our parts, on Debian's kernel in QEMU"
	@echo "make check        lint, types, layers, and what the wheel holds"
	@echo "make bench        measure how fast it is, beside polars and others; benchmarks/README.md has the long ones"
	@echo "make fixtures     make the recorded sessions and golden files of the tests anew"
	@echo "make reference    write the generated pages of docs/reference anew"
	@echo "make man          write a man page of each command into man/"
	@echo "make site         build the documentation into site/, with warnings as errors"
	@echo "make firmware     build the firmware for the ADXL202's microcontroller (firmware/build/adxl202.hex)"
	@echo "make clean        remove all that make has made"

demo: $(STAMP)
	@$(VENV)/bin/tiltcal demo demo

# One worker more than cores, for many tests wait for a line or a clock; each takes its part of the tests in order, and
# then half of what another has left. Hundreds of processes are started: let them find their byte code.
test: $(STAMP)
	@PYTHONDONTWRITEBYTECODE= $(RUN) -m pytest --dist worksteal \
		-n $$($(RUN) -c 'import os; print(min((os.cpu_count() or 1) + 1, 5))')

test-judges: $(STAMP)
	@tests/judges/run

test-kernel: $(STAMP)
	@tests/kernel/run

# One command of each kind: a session and its replay, logs of each format, report, export, match and a bus.
LOWEST := $(VENV)/lowest
LOWEST_TESTS := tests/project/test_installed.py tests/contract/test_every_bus.py tests/commands/test_apply_netcdf.py \
	tests/commands/test_log_formats.py tests/commands/test_report.py tests/commands/test_match.py tests/commands/test_export.py

test-lowest: $(STAMP)
	@$(RUN) -c 'import uv' 2>/dev/null || { echo "test-lowest skipped: uv is not installed (pip install uv)"; exit 0; }; \
		$(RUN) -m uv venv --quiet --clear --seed --python $(RUN) $(LOWEST) && \
		$(RUN) -m uv pip install --quiet --python $(LOWEST)/bin/python --resolution lowest-direct -e '.[dev]' && \
		{ $(RUN) -m uv pip install --quiet --python $(LOWEST)/bin/python --resolution lowest-direct -e '.[spi]' \
			|| echo "no SPI: python-spidev cannot be built here" >&2; } && \
		$(LOWEST)/bin/python -B -m pytest -q $(LOWEST_TESTS)

check: $(STAMP)
	@$(RUN) -m ruff check .
	@$(RUN) -m ruff format --check .
	@$(RUN) -m mypy
	@$(VENV)/bin/lint-imports
	@rm -rf build dist
	@$(RUN) -m pip wheel --quiet --disable-pip-version-check --no-deps --no-build-isolation --wheel-dir dist .
	@rm -rf build
	@$(VENV)/bin/check-wheel-contents dist

bench: $(STAMP)
	@$(RUN) benchmarks/apply.py --keep
	@$(RUN) benchmarks/long_logs.py --rows 2000000
	@$(RUN) benchmarks/match.py
	@$(RUN) benchmarks/capture.py --seconds 20

fixtures: $(STAMP)
	@$(RUN) fixtures/make.py

reference: $(STAMP)
	@$(RUN) docs/reference/generate.py

man: $(STAMP)
	@$(RUN) docs/reference/man.py man

site: $(STAMP)
	@$(INSTALL) -e '.[docs]'
	@$(VENV)/bin/sphinx-build -W --keep-going -q -c docs . site/$$($(RUN) -c 'import tiltcal; print(tiltcal.__version__)')

firmware:
	@$(MAKE) --no-print-directory -C firmware

clean:
	rm -rf firmware/build tests/judges/build tests/kernel/build
	rm -rf $(VENV) build dist demo man site tiltcal.egg-info .benchmarks .hypothesis .import_linter_cache .mypy_cache .pytest_cache .ruff_cache
	find tiltcal/ drivers procedures tests fixtures benchmarks docs -name __pycache__ -prune -exec rm -rf {} +

INSTALL := $(RUN) -m pip install --quiet --disable-pip-version-check -c constraints.txt

# python-spidev comes as source: where it cannot be built there is no SPI, and all the rest works.
$(STAMP): pyproject.toml constraints.txt
	@test -n "$(PYTHON)" || { echo "tiltcal needs Python 3.11 or newer: make PYTHON=/path/to/python3 ..." >&2; exit 1; }
	@echo "making $(VENV), which takes a minute ..." >&2
	@"$(PYTHON)" -m venv --clear $(VENV)
	@$(INSTALL) -e '.[dev]'
	@$(INSTALL) spidev >$(VENV)/spidev.log 2>&1 \
		|| echo "no SPI in $(VENV): python-spidev cannot be built here (see $(VENV)/spidev.log)" >&2
	@$(RUN) -m compileall -q tiltcal drivers procedures  # a third of a short command's time where Python may not do so itself
	@$(IDENTIFY) >$@
