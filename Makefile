# Two commands for a newcomer: `make quickstart` and `make test`. Everything is installed into .venv.

# The first Python on the path for which the simulators have wheels; `make PYTHON=... ` names another.
PYTHON ?= $(shell for p in python3 python3.12 python3.11; do \
	$$p -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 12))' 2>/dev/null && echo $$p && break; done)
BIN := .venv/bin
AS_ROOT := $(shell test "$$(id -u)" = 0 || echo sudo)
PYTEST := $(BIN)/python -m pytest
PIP := $(BIN)/python -m pip install
# What pip says is shown where it fails: about some package indexes it warns a hundred times.
LOGGED := >.venv/install.log 2>&1 || { cat .venv/install.log >&2; exit 1; }

.PHONY: quickstart test test-slow test-cluster check install browser tex opengl cluster bench soak clean

quickstart: install
	$(BIN)/rrmctl run quickstart
	$(BIN)/rrmctl report final quickstart
	$(BIN)/rrmctl plot quickstart

test: install
	$(PYTEST) -n auto -m "not slow and not cluster"

test-slow: install browser
	$(PYTEST) -n $$(( $$(getconf _NPROCESSORS_ONLN) * 3 / 2 )) -m "slow and not cluster $(LEFT_OUT)" $(TESTS)  # many of them wait

test-cluster: install
	$(PYTEST) -n 2 --dist loadfile -m "cluster $(LEFT_OUT)" tests/cluster

# A headless Chromium from npm for the tests of pages; without one they are skipped.
browser: install
	@$(BIN)/python -m tests.browser

check: install
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

MINUTES ?= 20
soak: install
	$(BIN)/python -m tests.soak --minutes $(MINUTES)

# For the test that compiles the LaTeX tables, on Debian and its kin; any other pdflatex with these packages will do.
tex:
	command -v pdflatex || { $(AS_ROOT) apt-get update && \
		$(AS_ROOT) apt-get install --yes --no-install-recommends texlive-latex-recommended; }

# OpenGL without a display, for what a camera sees, on Debian and its kin; a graphics card's driver brings its own.
opengl: install
	$(BIN)/python -c "from rrm.rendering import renderer; renderer()" 2>/dev/null || { $(AS_ROOT) apt-get update && \
		$(AS_ROOT) apt-get install --yes --no-install-recommends libegl1 libegl-mesa0 libgl1-mesa-dri; }

# Slurm for the tests of job arrays, on Debian and its kin; they run one of their own, on this machine alone.
cluster:
	command -v slurmctld || { $(AS_ROOT) apt-get update && \
		$(AS_ROOT) apt-get install --yes --no-install-recommends slurm-wlm; }

bench: .venv/benched
	$(BIN)/python -m benchmarks $(BENCHMARKS)

.venv/benched: .venv/installed
	$(PIP) --constraint constraints.txt --editable '.[dev,bench]' $(LOGGED)
	@touch $@

install: .venv/installed

.venv/installed: pyproject.toml constraints.txt
	@test -n "$(PYTHON)" || { echo "rrmctl needs Python 3.11 or 3.12 (the simulators have wheels for no other); \
	install one and run make again, or name it: make PYTHON=/path/to/python3.12 ..." >&2; exit 1; }
	$(PYTHON) -m venv .venv
	$(PIP) --upgrade pip $(LOGGED)
	$(PIP) --constraint constraints.txt --editable '.[dev]' $(LOGGED)
	@touch $@

clean:
	rm -rf .venv .mypy_cache .ruff_cache .pytest_cache .hypothesis
