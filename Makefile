# make run    everything on this machine: simulator, server, pages; prints one address
# make check  a minute: lint, types, fast tests of what changed since the last commit
# make test   all checks and tests, from nothing
# make bench  figures (never part of the tests)
# make soak   hours of load with limits (HOURS=24 WORKERS=0 BROWSERS=1)
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
export PATH := $(CURDIR)/$(BIN):$(PATH)
PORT ?= $(or $(GSS_PORT),8181)
SIMULATOR ?= $(or $(GSS_SIMULATOR),cubestar)

.PHONY: run check test lint types unit web web-test bench soak lock clean docs

run: $(VENV)/.installed web
	@$(BIN)/gss serve --port $(PORT) --simulator $(SIMULATOR)

check: lint types
	@$(BIN)/python -m tools.check_tests

test: lint types web-test unit

lint: $(VENV)/.installed
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/lint-imports

types: $(VENV)/.installed
	$(BIN)/mypy

web: $(VENV)/.installed
	@$(BIN)/python tools/build_web.py

web-test: web
	cd web && npm run check && npm test

# tests/conftest.py says what stays together in one process, and the order.
unit: $(VENV)/.installed web
	$(BIN)/pytest -n 2 --dist loadfile --no-loadscope-reorder

# Hours of load: fifty packets a second, ten listeners, browsers; a line per minute, JSON at the end.
HOURS ?= 24
WORKERS ?= 0
BROWSERS ?= 1
soak: $(VENV)/.installed web
	$(BIN)/python -m tools.soak $(HOURS) --workers $(WORKERS) --browsers $(BROWSERS)

bench: $(VENV)/.installed
	$(BIN)/python -m tools.bench

# Everything is pinned with its hash, so the only step that trusts a name is the project itself.
$(VENV)/.installed: constraints.txt pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit("Python 3.11 or newer is needed; try make PYTHON=python3.11" if sys.version_info < (3, 11) else 0)'
	@echo "making a Python environment in $(VENV) …"
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@echo "fetching what GSS stands on into it, about two minutes, once …"
	@$(BIN)/python -m pip install --disable-pip-version-check --quiet --require-hashes -r constraints.txt
	@$(BIN)/python -m pip install --disable-pip-version-check --quiet --no-deps --no-build-isolation -e .
	@touch $@

lock:
	uv pip compile pyproject.toml --all-extras --universal --python-version 3.11 --generate-hashes \
		--no-emit-index-url --no-header --quiet --output-file constraints.txt
	$(BIN)/python -m tools.licences

clean:
	rm -rf $(VENV) gss/web web/node_modules var
