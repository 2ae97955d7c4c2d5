# Two commands do everything: `make demo` and `make test`. `make help` lists the rest.
# Needs GNU make and python3 >= 3.7 with venv; everything else goes into .venv in this checkout.

comma := ,
PYTHON ?= python3
VENV ?= .venv
VENV37 ?= .venv37
ARGS ?=
# GRAPH=0 leaves out the graph models, and with them torch
GRAPH ?= 1
OFFLINE := offline,distributed,sweep$(if $(filter 0,$(GRAPH)),,$(comma)graph)
export PYTHONNOUSERSITE := 1

RUN := $(VENV)/bin/python
RUN37 := $(VENV37)/bin/python
SETUP := scripts/setup_venv.py
DEVICE_PACKAGES := apex_edge firmware_bridge calib
NO_37 := no CPython 3.7 found (python3.7 on the PATH, pyenv, or PYTHON37=/path/to/python3.7)

.DEFAULT_GOAL := help
.NOTPARALLEL:
.PHONY: help setup demo test test-default test-37 lint style types bench clean

help: ## list these targets
	@awk -F ':.*## ' '/^[a-z0-9-]+:.*## / { printf "  make %-13s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)
	@echo "  PYTHON=/path/to/python3 picks the interpreter, ARGS=... goes to demo, test or bench"

setup: ## make .venv and install the project into it
	@command -v "$(PYTHON)" >/dev/null || { \
	  echo "$(PYTHON) not found; run: sudo apt-get install -y python3 python3-venv" >&2; exit 1; }
	@"$(PYTHON)" $(SETUP) $(VENV)

demo: setup ## see a collision, a quiet and an implicit scene, with no hardware
	$(VENV)/bin/apex demo $(ARGS)

test: test-default test-37 ## run all tests; the device packages once more on CPython 3.7

test-default:
	@if [ "$(GRAPH)" = 0 ]; then echo "*** GRAPH=0: graph models are not tested" >&2; fi
	@"$(PYTHON)" $(SETUP) $(VENV) --extras test --optional $(OFFLINE)
	@$(RUN) scripts/setup_peers.py
	$(RUN) -m pytest $(ARGS)

# Offline training needs newer Pythons; everything that runs on the arm's computer runs here again.
test-37:
	@python37="$$("$(PYTHON)" scripts/find_python37.py)" || python37=; \
	if [ -n "$$python37" ]; then \
	  set -ex; "$$python37" $(SETUP) $(VENV37) --extras test,lint; \
	  $(RUN37) scripts/setup_peers.py; \
	  $(RUN37) -m pytest --ignore=tests/offline_train $(ARGS); \
	elif [ "$${CI:-}" = true ]; then \
	  echo "FAILED: $(NO_37)" >&2; exit 1; \
	else \
	  echo "*** SKIPPED the tests on Python 3.7: $(NO_37)" >&2; \
	fi

lint: style types ## style, layer order, 3.7 syntax and types

style:
	@"$(PYTHON)" $(SETUP) $(VENV) --extras test,lint --optional $(OFFLINE)
	$(RUN) -m ruff check .
	$(RUN) -m ruff format --check .
	$(VENV)/bin/lint-imports
	$(VENV)/bin/vermin --quiet --violations --no-tips --target=3.7- $(DEVICE_PACKAGES) scripts

# mypy 1.4.1 is the last that checks for 3.7, and runs there.
types:
	@python37="$$("$(PYTHON)" scripts/find_python37.py)" || python37=; \
	if [ -n "$$python37" ]; then \
	  set -ex; "$$python37" $(SETUP) $(VENV37) --extras test,lint; \
	  $(RUN37) -m mypy; \
	elif [ "$${CI:-}" = true ]; then \
	  echo "FAILED: $(NO_37)" >&2; exit 1; \
	else \
	  echo "*** SKIPPED the type check: $(NO_37)" >&2; \
	fi

bench: setup ## measure the roll-outs side by side on this machine
	$(VENV)/bin/apex bench rollout $(ARGS)

clean: ## remove everything the other targets made
	rm -rf $(VENV) $(VENV37) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache \
	  .hypothesis .import_linter_cache .coverage
	find . -name __pycache__ -type d -not -path './.git/*' -prune -exec rm -rf {} +
