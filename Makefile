# Every target sets up .venv by itself, and only when pyproject.toml, constraints.txt or the version have changed: `make
# compare` with what it needs alone, the others with all packages, beside those.
# Each Python has an environment of its own: `make test PYTHON=python3.13` sets up .venv-3.13.
# make reads options before this file, so options of a command are given in ARGS.

PYTHON ?= python3.11
# Of Python 3.11 or newer; empty for an older one, and for none. Then what was set up is used only if PYTHON was not told.
VERSION := $(shell $(PYTHON) -c 'import sys; v = sys.version_info[:2]; print("%d.%d" % v if v >= (3, 11) else "")' 2>/dev/null)
VENV ?= .venv$(addprefix -,$(filter-out 3.11,$(or $(VERSION),$(if $(filter file,$(origin PYTHON)),,without-python))))
NEEDS_PYTHON = $(if $(VERSION),,$(error $(PYTHON) is not there, or older than Python 3.11: make $(or $(firstword $(MAKECMDGOALS)),setup) PYTHON=/path/to/python3.11))
CONSTRAINTS ?= constraints.txt
EXTRA ?= dev
BIN := $(VENV)/bin
# Python writes the bytecode of what it imports; that of whole packages takes longer than all else of an installation.
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile
export PYTHONDONTWRITEBYTECODE =
READY_COMPARE := $(VENV)/.ready-compare
READY := $(VENV)/.ready
READY_DOCS := $(VENV)/.ready-docs
# On Linux PyTorch's own index, where it can be reached, has a build without CUDA, a tenth as large. Empty: that of PyPI.
TORCH_INDEX ?= https://download.pytorch.org/whl/cpu
FROM_TORCH = $(shell $(BIN)/python -c 'import sys, urllib.request as u; sys.platform == "linux" and \
	u.urlopen("$(TORCH_INDEX)/", timeout=3) and print("--extra-index-url $(TORCH_INDEX)")' 2>/dev/null)
WORKERS ?= 3
PYTEST := $(BIN)/python -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.DEFAULT:
	$(error there is no '$@', and no target that makes it: `make help` lists the targets)
.PHONY: help compare train setup test stress lint format bench pages docs dist clean

##@ Use

help:  ## Show this list
	@awk '/^##@/ { printf "\n%s\n", substr($$0, 5) } \
		/^[a-z-]+:.*## / { split($$0, part, ":.*## "); printf "  make %-8s %s\n", part[1], part[2] }' $(MAKEFILE_LIST)
	@printf '\nOptions of a command go in ARGS: make compare ARGS="--quick --episodes 40"\n'

compare: $(READY_COMPARE)  ## Compare all controllers, with --quick in about a minute; ARGS replaces --quick: results/compare/report.html
	$(BIN)/python eval/compare.py $(or $(ARGS),--quick)

train: $(READY)  ## Train a residual PPO policy, saved in runs/ppo
	$(BIN)/python train/ppo.py $(ARGS)

##@ Develop

setup: $(READY)  ## Create .venv with pinned versions, and compile kernels; HASHES=1 checks the SHA-256 of packages too

$(READY_COMPARE): pyproject.toml $(CONSTRAINTS) $(wildcard beltarm_env/__init__.py)
	$(NEEDS_PYTHON)@echo "Setting up $(VENV): a minute or two"
	$(PYTHON) -m venv $(VENV)
	$(if $(HASHES),$(PIP) --no-deps --require-hashes --requirement hashes.txt)
	$(PIP) --constraint $(CONSTRAINTS) --editable '.[compare]'
	@touch $@

$(READY): $(READY_COMPARE)
	@echo "Adding all other packages to $(VENV), and compiling kernels: two minutes"
	$(PIP) --constraint $(CONSTRAINTS) $(FROM_TORCH) --editable '.[$(EXTRA)]'
	$(BIN)/python -m agents.compile_kernels
	@touch $@

test: $(READY)  ## Run the tests; ARGS=--slow runs those that are marked slow, too
	$(PYTEST) $(ARGS)

stress: $(READY)  ## Attack the promises with random arms, damaged files, kills and hostile controllers; ARGS=--hypothesis-seed=7 repeats
	$(PYTEST) --hypothesis-profile fuzz tests/stress $(ARGS)

lint: $(READY)  ## Check style and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

format: $(READY)  ## Format the code
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(READY)  ## Measure speed, with ratios to a peer in the same run: results/bench
	$(BIN)/python eval/bench.py $(ARGS)

pages: $(READY)  ## Render all measured pages from their data; ARGS=--check says which are fresh, ARGS=--measure measures them anew
	$(BIN)/python eval/pages.py $(ARGS)

docs: $(READY_DOCS)  ## Build the documentation site in docs/_build, and run its tutorials (needs a C compiler): three minutes
	rm -rf docs/_build docs/gallery
	$(BIN)/python -m sphinx --fail-on-warning docs docs/_build
	@echo "Open docs/_build/index.html"

$(READY_DOCS): $(READY)
	$(PIP) --constraint $(CONSTRAINTS) --editable '.[docs]'
	@touch $@

dist: $(READY)  ## Build the source archive and this machine's wheel in dist; TARGETS="win_amd64 macosx_11_0_arm64" for others
	export SOURCE_DATE_EPOCH=$$(git log -1 --format=%ct); set -e; $(BIN)/python -m build --no-isolation --sdist; \
	for target in $(or $(TARGETS),''); do BELTARM_TARGET=$$target $(BIN)/python -m build --no-isolation --wheel; done

clean:  ## Remove environments, results, the site and caches
	rm -rf .venv .venv-* results docs/_build docs/gallery .pytest_cache .ruff_cache .hypothesis dist
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
