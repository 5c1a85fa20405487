# Every target sets up .venv by itself, and only when pyproject.toml or constraints.txt have changed.

PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
WORKERS ?= 2

.DEFAULT_GOAL := help
.PHONY: help setup compare scenarios paper loops physics test lint format bench tune train learning readme clean

help:  ## Show this list
	@awk -F ':.*## ' '/^[a-z]+:.*## / {printf "  make %-9s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: $(READY)  ## Create .venv with pinned versions

$(READY): pyproject.toml constraints.txt
	@command -v $(PYTHON) >/dev/null || { echo "$(PYTHON) not found: install Python 3.11, or make PYTHON=..." >&2; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	@touch $@

compare: $(READY)  ## Compare all controllers on 70 scenarios of every split: report.html, pictures in results/compare
	$(BIN)/python eval/compare.py $(or $(ARGS),--episodes 70)

scenarios: $(READY)  ## Check the test scenarios and that the physics is still theirs; ARGS=--write draws them
	$(BIN)/python eval/scenarios.py $(ARGS)

paper: $(READY)  ## Regenerate the paper's figures and tables in docs/paper
	$(BIN)/python eval/paper.py --out docs/paper $(ARGS)

loops: $(READY)  ## Margins, costs and times of every controller, and where it breaks, in docs/baselines
	$(BIN)/python eval/baselines.py --out docs/baselines $(ARGS)

physics: $(READY)  ## Check the plant: order of convergence, and MuJoCo's arm in docs/crosscheck
	$(BIN)/python eval/convergence.py
	$(BIN)/python eval/crosscheck.py --out docs/crosscheck $(ARGS)

test: $(READY)  ## Run the tests
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile $(ARGS)

lint: $(READY)  ## Check style and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

format: $(READY)  ## Format the code
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(READY)  ## Measure speed and accuracy, with ratios to a peer in the same run
	$(BIN)/python eval/bench.py $(ARGS)

tune: $(READY)  ## Tune every classical controller anew, into baselines/gains.json; takes half an hour
	$(BIN)/python baselines/tune.py --all $(ARGS)

train: $(READY)  ## Train a residual PPO policy, saved in runs/ppo
	$(BIN)/python train/ppo.py $(ARGS)

learning: $(READY)  ## Ablations of the training in docs/learning: half an hour or more; goes on where it was interrupted
	$(BIN)/python eval/ablations.py --out docs/learning $(ARGS)

readme: $(READY)  ## Regenerate the README, docs/comparison, docs/iterative and docs/training
	$(BIN)/python eval/compare.py --out docs/comparison
	$(BIN)/python eval/iterative.py --out docs/iterative
	$(BIN)/python eval/curves.py --out docs/training
	$(BIN)/python eval/readme.py

clean:  ## Remove .venv, results and caches
	rm -rf $(VENV) results .pytest_cache .ruff_cache .hypothesis dist
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
