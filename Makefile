# Every target sets up .venv by itself, and only when pyproject.toml or constraints.txt have changed.
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
READY := $(VENV)/.ready
READY_DOCS := $(VENV)/.ready-docs
WORKERS ?= 3
LOWEST := .venv-lowest
TOOLS := .venv-tools

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.DEFAULT:
	$(error there is no '$@', and no target that makes it: `make help` lists the targets)
.PHONY: help compare train setup test test-all test-lowest fuzz soak mutants coverage lint format bench dist sbom hashes docs clean scenarios physics paper loops tails scaling drive sensors guard embedded observers tune learning film readme

##@ Use

help:  ## Show this list
	@awk '/^##@/ { printf "\n%s\n", substr($$0, 5) } \
		/^[a-z-]+:.*## / { split($$0, part, ":.*## "); printf "  make %-11s %s\n", part[1], part[2] }' $(MAKEFILE_LIST)
	@printf '\nOptions of a command go in ARGS: make compare ARGS="--episodes 20"\n'

compare: $(READY)  ## Compare all controllers on 50 scenarios of every split (with ARGS: 200, or --episodes): report.html in results/compare
	$(BIN)/python eval/compare.py $(or $(ARGS),--episodes 50)

train: $(READY)  ## Train a residual PPO policy, saved in runs/ppo
	$(BIN)/python train/ppo.py $(ARGS)

##@ Develop

setup: $(READY)  ## Create .venv with pinned versions; HASHES=1 checks their SHA-256 too

$(READY): pyproject.toml $(CONSTRAINTS)
	$(NEEDS_PYTHON)$(PYTHON) -m venv $(VENV)
	$(if $(HASHES),$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --require-hashes --requirement hashes.txt)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint $(CONSTRAINTS) --editable '.[$(EXTRA)]'
	@touch $@

test: $(READY)  ## Run the tests
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder $(ARGS)

test-all:  ## Run the tests that are marked slow, too
	$(MAKE) test ARGS="--slow $(ARGS)"

test-lowest: $(LOWEST).txt  ## Run the tests with the lowest versions that pyproject.toml allows, in .venv-lowest
	$(MAKE) test-all VENV=$(LOWEST) CONSTRAINTS=$(LOWEST).txt EXTRA=test

$(LOWEST).txt: pyproject.toml tests/lowest.py
	$(NEEDS_PYTHON)$(PYTHON) tests/lowest.py > $@

fuzz: $(READY)  ## Try ten times as many examples in the property tests, at random; ARGS=--hypothesis-seed=7 repeats
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder -m hypothesis --hypothesis-profile fuzz $(ARGS)

# atheris does not install everywhere; without it the siege guides no damage by coverage, and says so.
soak: $(READY)  ## Attack all that is promised: results/soak/reliability.md; ARGS="--share 0.1 --seed 1" is a tenth of another
	-$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[siege]'
	$(BIN)/python eval/soak.py $(ARGS)

mutants: $(READY)  ## Put faults into the code, and see which the tests find, in docs/mutation.md: an hour; goes on where interrupted
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[mutation]'
	$(BIN)/python eval/mutants.py --out docs $(ARGS)

coverage: $(READY)  ## Run the tests and show which lines of the packages they reach
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder --slow --cov --cov-report term:skip-covered $(ARGS)

lint: $(READY)  ## Check style and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

format: $(READY)  ## Format the code
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(READY)  ## Measure speed and accuracy, with ratios to a peer in the same run
	$(BIN)/python eval/bench.py $(ARGS)

dist: $(READY)  ## Build the wheel and the source archive in dist: the same commit gives the same bytes
	SOURCE_DATE_EPOCH=$$(git log -1 --format=%ct) $(BIN)/python -m build --no-isolation

sbom: $(READY) $(TOOLS)/.ready  ## List all packages of .venv in dist/sbom.json, in the format CycloneDX
	mkdir -p dist
	$(TOOLS)/bin/cyclonedx-py environment --pyproject pyproject.toml --output-reproducible --output-file dist/sbom.json $(VENV)

# Not of peers of the benchmark, nor of torch: its builds differ from machine to machine, and so does what they need.
hashes: $(TOOLS)/.ready  ## Write the hashes of all pinned packages to hashes.txt, after a change of constraints.txt
	sed '/^torch==/d; /^# Of the extra `bench`/,$$d' constraints.txt | $(TOOLS)/bin/uv pip compile --quiet --no-deps --no-annotate --generate-hashes \
		--python-version 3.11 --custom-compile-command 'make hashes' --output-file hashes.txt -

$(TOOLS)/.ready: constraints.txt
	$(NEEDS_PYTHON)$(PYTHON) -m venv $(TOOLS)
	$(TOOLS)/bin/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt cyclonedx-bom uv
	@touch $@

docs: $(READY_DOCS)  ## Build the documentation site in docs/_build, and run its tutorials (needs a C compiler): three minutes
	rm -rf docs/_build docs/gallery
	$(BIN)/python -m sphinx --fail-on-warning docs docs/_build
	@echo "Open docs/_build/index.html"

$(READY_DOCS): $(READY)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[docs]'
	@touch $@

clean:  ## Remove environments, results, the site and caches
	rm -rf .venv .venv-* results docs/_build docs/gallery .pytest_cache .ruff_cache .hypothesis dist
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

##@ Regenerate, or check, what is committed

scenarios: $(READY)  ## Check the scenarios and that the physics is still theirs; ARGS=--write keeps those of a changed physics
	$(BIN)/python eval/scenarios.py $(ARGS)

physics: $(READY)  ## Check the plant: order of convergence, and MuJoCo's arm in docs/results/physics
	$(BIN)/python eval/convergence.py
	$(BIN)/python eval/crosscheck.py --out docs/results/physics $(ARGS)

paper: $(READY)  ## Regenerate the paper's figures and tables in docs/results/paper
	$(BIN)/python eval/paper.py --out docs/results/paper $(ARGS)

loops: $(READY)  ## Margins, costs and times of every controller, and where it breaks, in docs/results/loops
	$(BIN)/python eval/baselines.py --out docs/results/loops $(ARGS)

tails: $(READY)  ## Tail risk of controllers on 25000 scenarios, in docs/results/tails: half an hour; goes on where it was interrupted
	$(BIN)/python eval/compare.py --scenario-seed 1 --episodes 25000 --splits randomized \
		--methods paper preview adaptive ppo student --out docs/results/tails $(ARGS)

scaling: $(READY)  ## What tasks side by side take, by engine, in docs/scaling; takes ten minutes
	$(BIN)/python eval/scaling.py --methods paper --out docs/scaling $(ARGS)

drive: $(READY)  ## Cost and vibration of every controller over each effect of the drive, in docs/results/drive; takes five minutes
	$(BIN)/python eval/drive.py --out docs/results/drive $(ARGS)

sensors: $(READY)  ## What an accelerometer buys, in docs/results/sensors
	$(BIN)/python eval/sensors.py --episodes 60 --out docs/results/sensors $(ARGS)

guard: $(READY)  ## What the guard is worth where something breaks, in docs/results/guard; takes ten minutes
	$(BIN)/python eval/faults.py --arms 60 --episodes 40 --out docs/results/guard $(ARGS)

embedded: $(READY)  ## Controllers as programs: equality, time, flash and memory, in docs/results/embedded; takes ten minutes
	$(BIN)/python eval/embedded.py --out docs/results/embedded $(ARGS)

observers: $(READY)  ## What a filter and learned observers see through the encoder, in docs/results/observers
	$(BIN)/python eval/observers.py --out docs/results/observers $(ARGS)

tune: $(READY)  ## Tune every classical controller anew, into baselines/gains.json; takes half an hour
	$(BIN)/python baselines/tune.py --all --budget 8000000 $(ARGS)

learning: $(READY)  ## Ablations of the training in docs/results/learning: two hours or more; goes on where it was interrupted
	$(BIN)/python eval/ablations.py --out docs/results/learning $(ARGS)

film: $(READY)  ## Regenerate the film on the README's first screen
	$(BIN)/python eval/watch.py --controller paper --controller adaptive --policy agents/policies/student/seed0 \
		--speed 0.5 --out docs/results/comparison/motion.gif

readme: $(READY)  ## Regenerate the README, docs/results/comparison, docs/results/iterative and docs/results/curves
	$(BIN)/python eval/compare.py --episodes 500 --out docs/results/comparison
	$(BIN)/python eval/iterative.py --out docs/results/iterative
	$(BIN)/python eval/curves.py --out docs/results/curves
	$(BIN)/python eval/readme.py
