# make run    everything on this machine: simulator, server, pages; prints one address
# make check  a minute: lint, types, fast tests of what changed since the last commit
# make test   all checks and tests, from nothing
# make evidence  all trials of the statistical tests
# make never-wrong  hours of lists and frames with faults, without one false attitude (never-wrong-daily: minutes)
# make bench  figures (never part of the tests)
# make soak   hours of load with limits (HOURS=24 WORKERS=0 BROWSERS=1)
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
export PATH := $(CURDIR)/$(BIN):$(PATH)
PORT ?= $(or $(GSS_PORT),8181)
SIMULATOR ?= $(or $(GSS_SIMULATOR),cubestar)

.PHONY: run check test lint types unit web web-test kernels collected evidence never-wrong never-wrong-daily bench soak lock clean docs

run: $(VENV)/.run-installed
	@$(BIN)/python tools/build_web.py --once
	@$(BIN)/gss serve --port $(PORT) --simulator $(SIMULATOR)

check: lint types
	@$(BIN)/python -m tools.check_tests

# The checks before the tests use one processor each, so that two run at a time, the longest first.
test: $(VENV)/.test-installed web
	@$(MAKE) --jobs 2 --no-print-directory kernels types collected web-test lint
	@$(MAKE) --no-print-directory unit

lint: web
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/lint-imports
	cd web && npm run --silent lint

types: $(VENV)/.test-installed
	$(BIN)/mypy

web: $(VENV)/.test-installed
	@$(BIN)/python tools/build_web.py

web-test: web
	cd web && npm run check && npm test

# Compiles the solver's loops once, instead of in every process that solves a frame.
kernels: $(VENV)/.test-installed
	@$(BIN)/gss compile --camera cubestar

# Compiles the test files once. On a new checkout, each of the processes would compile all of them. unit reports errors.
collected: $(VENV)/.test-installed
	@$(BIN)/pytest --collect-only --quiet --quiet > /dev/null || true

# Three processes on two cores: one can wait for a server while two compute. tests/conftest.py says what stays together.
unit: $(VENV)/.test-installed web
	$(BIN)/pytest -n 3 --dist loadfile --no-loadscope-reorder

# Every trial of the statistical tests; make test runs a part of them. Campaigns: gss experiments, tools/fuzz.py, make soak.
evidence: $(VENV)/.test-installed
	$(BIN)/pytest -n 2 --dist loadfile --timeout 600 tests/pipeline --evidence

# Hours of load: fifty packets a second, ten listeners, browsers; a line per minute, JSON at the end.
HOURS ?= 24
WORKERS ?= 0
BROWSERS ?= 1
soak: $(VENV)/.test-installed web
	$(BIN)/python -m tools.soak $(HOURS) --workers $(WORKERS) --browsers $(BROWSERS)

# Hours of lists and frames with faults: every wrong attitude is a fault. It continues with the results of earlier runs, which
# are in the repository. LISTS, FRAMES: of each system's chain, and of the reference chain over five cameras together.
# never-wrong-daily: minutes, on the current sources.
LISTS ?= 1000000
FRAMES ?= 10000
RESULTS := validation/never_wrong/results.json
never-wrong: $(VENV)/.test-installed kernels
	$(BIN)/gss experiments never-wrong --chain reference --attitudes $$(($(LISTS) / 5)) --frames $$(($(FRAMES) / 5)) --workers 2 \
	  --keep $(RESULTS) || [ $$? = 3 ]
	$(BIN)/gss experiments never-wrong --chain own --attitudes $(LISTS) --frames $(FRAMES) --workers 2 --keep $(RESULTS) || [ $$? = 3 ]
	$(BIN)/gss experiments never-wrong --keep $(RESULTS) --page docs/never-wrong.md

never-wrong-daily: $(VENV)/.test-installed kernels
	$(BIN)/gss experiments never-wrong --attitudes 1000 --frames 26 --workers 2 --keep never-wrong-daily.json --again

bench: $(VENV)/.test-installed
	$(BIN)/python -m tools.bench

# Everything is pinned with its hash, so the only step that trusts a name is the project itself. Python compiles a module
# when it is first imported instead of all at installation: that saves a third of the time and a tenth of the disk.
unexport PYTHONDONTWRITEBYTECODE
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet
INSTALL := $(BIN)/python -m tools.install_packages

$(VENV)/.run-installed: constraints.txt pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit("Python 3.11 or newer is needed; try make PYTHON=python3.11" if sys.version_info < (3, 11) else 0)'
	@echo "creating a Python environment in $(VENV) …"
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@echo "installing what running needs, once …"
	@$(INSTALL) constraints.txt
	@$(PIP) install --no-compile --no-deps --no-build-isolation -e .
	@$(BIN)/python -m tools.slim
	@touch $@

$(VENV)/.test-installed: $(VENV)/.run-installed constraints-dev.txt
	@echo "installing extras and test tools, once …"
	@$(INSTALL) constraints-dev.txt
	@touch $@

EXTRAS := cluster postgres s3 gaia checkerboard bench checkout dev
LOCK := uv pip compile pyproject.toml --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-header --quiet
lock: $(VENV)/.test-installed
	$(LOCK) $(addprefix --extra ,$(EXTRAS)) --output-file constraints-dev.txt
	cp constraints-dev.txt constraints.txt # its versions are preferred, so that both files agree
	$(LOCK) --extra checkout --output-file constraints.txt
	$(INSTALL) constraints-dev.txt
	$(BIN)/python -m tools.licences

clean:
	rm -rf $(VENV) gss/web web/node_modules var
