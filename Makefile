# The commands of this project; `make` alone lists them.  Each makes its own .venv, from Python 3.11+ and PyPI alone.

PYTHON ?= python3
LINK ?= zenoh
BENCH ?= *
ARGS ?=
PIP_ENV := PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_NO_INPUT=1 PIP_ROOT_USER_ACTION=ignore
BIN := .venv/bin

.PHONY: help run test lint format check bench docs docs-figures mutate lock clean
.DELETE_ON_ERROR:

help: ## this list
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## /  make \1\t/' | expand -t 24

run: .venv/.run ## the simulated satellite feeds the daemon over a real link (LINK=zenoh or LINK=serial)
	@$(BIN)/python -m sim_sensor.demo --link $(LINK) $(ARGS)

test: .venv/.dev ## all tests, in three processes for two cores, so one thread of linear algebra in each; what they compile is kept
	@PYTHONDONTWRITEBYTECODE= OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder $(ARGS)

lint: .venv/.dev ## formatting, lint, who may import whom, types
	@$(BIN)/python -m ruff format --check .
	@$(BIN)/python -m ruff check .
	@$(BIN)/python $(BIN)/lint-imports --no-logo
	@$(BIN)/python -m mypy

format: .venv/.dev ## put the code in the project's format
	@$(BIN)/python -m ruff format .
	@$(BIN)/python -m ruff check --fix .

check: lint test ## what CI runs

bench: .venv/.dev ## the measured figures of the documentation, again (BENCH=wire: one of tests/benchmarks)
	@set -e; for file in tests/benchmarks/bench_$(BENCH).py; do \
	  module=$${file%.py}; echo "== $$module"; $(BIN)/python -m $$(echo $$module | tr / .) $(ARGS); done

docs: .venv/.docs ## the pages as a site with search, in build/docs; a link that leads nowhere fails
	@NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet --strict --config-file - <docs/mkdocs.yml
	@echo "build/docs/index.html; with search: $(BIN)/python -m http.server --bind 127.0.0.1 --directory build/docs"

docs-figures: .venv/.dev ## write the tables of README and docs from docs/results
	@$(BIN)/python -m tests.figures

mutate: .venv/.mutate ## break the core in single places: do the tests notice? (ARGS="--room wire --sample 0": all of a room)
	@$(BIN)/python -m tests.mutation $(ARGS)

lock: ## resolve deploy/requirements.lock anew, with hashes (needs the network)
	@d=$$(mktemp -d) && $(PYTHON) -m venv $$d && $(PIP_ENV) $$d/bin/pip install -q 'pip-tools>=7.4' && \
	  sed -n '/^#/p' deploy/requirements.lock >$$d/lock && $$d/bin/pip-compile -q --generate-hashes --strip-extras \
	  --no-header --no-annotate --no-emit-index-url --no-emit-find-links -o $$d/new pyproject.toml && \
	  cat $$d/new >>$$d/lock && cp $$d/lock deploy/requirements.lock && rm -r $$d

clean: ## remove what the other commands made; recordings in output/ stay
	rm -rf .venv build dist *.egg-info .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

.venv/.run: pyproject.toml | $(BIN)/python
	@echo "installing magcal with its simulator, view and diagnosis into .venv (once, about a minute) ..."
	@$(PIP_ENV) $(BIN)/python -m pip install -q -e '.[sim,view,diagnosis]'
	@touch $@

.venv/.dev: pyproject.toml | $(BIN)/python
	@echo "installing magcal with everything its tests need into .venv (once, one to two minutes) ..."
	@$(PIP_ENV) $(BIN)/python -m pip install -q -e '.[dev]'
	@touch $@ .venv/.run

.venv/.docs: pyproject.toml | $(BIN)/python
	@echo "installing what makes the site into .venv (once) ..."
	@$(PIP_ENV) $(BIN)/python -m pip install -q -e '.[docs]'
	@touch $@

.venv/.mutate: .venv/.dev
	@echo "installing what breaks the code on purpose into .venv (once) ..."
	@$(PIP_ENV) $(BIN)/python -m pip install -q -e '.[mutate]'
	@touch $@

$(BIN)/python:
	@command -v $(PYTHON) >/dev/null || { echo "$(PYTHON) is not installed; on Debian: apt install python3 python3-venv" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "$$($(PYTHON) --version) is too old, 3.11 or later is needed; name one with: make PYTHON=python3.11" >&2; exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || { \
	  echo "this Python cannot make a virtual environment; on Debian: apt install python3-venv" >&2; exit 1; }
	@$(PYTHON) -m venv .venv || { rm -rf .venv; exit 1; }
