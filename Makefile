# One command each. Every target sets up what it needs in a local virtual environment (.venv).
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
ARGS   ?=

.DEFAULT_GOAL := help
.PHONY: help demo chromium test test-slow fuzz kills bench instructions docs test-docs test-torch test-learners wheels format clean

help:  ## say what each target does
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | sort | awk -F'\t' '{printf "  make %-10s %s\n", $$1, $$2}'

$(VENV)/bin/python:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "tasklift needs Python 3.11 or newer: make PYTHON=python3.12 ..."; exit 2; }
	$(PYTHON) -m venv $(VENV)

$(STAMP): pyproject.toml constraints.txt $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	@touch $@

demo: $(STAMP)  ## set up, train a team (runs/demo/report.html), reproduce the paper (reproduction/report.html)
	mkdir -p runs && { [ -f runs/demo.json ] || $(BIN)/tasklift map generate --seed 7 -o runs/demo.json; }
	$(BIN)/tasklift train runs/demo.json --seeds 1 --out runs/demo
	$(BIN)/tasklift reproduce --out reproduction $(ARGS)

chromium:  ## install the browser that the replay page is tested in (Debian and its kin, as root)
	@command -v chromium >/dev/null || command -v chromium-browser >/dev/null || command -v google-chrome >/dev/null \
	|| { [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null && apt-get update -qq && apt-get install -yqq chromium >/dev/null; } \
	|| echo "no Chromium, and it cannot be installed here: the tests of the replay page will be skipped"

test: $(STAMP) chromium  ## everything CI runs: lint, types, import contracts, tests
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/pytest -m "not slow" --numprocesses auto --dist loadfile $(ARGS)

test-slow: $(STAMP)  ## the tests that are slow by nature
	$(BIN)/pytest -m slow $(ARGS)

test-torch: $(STAMP)  ## what needs PyTorch (4 GB): the surgery of networks, Stable-Baselines3
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[torch]' 'stable-baselines3>=2.4' 'onnxscript>=0.2'
	$(BIN)/pytest tests/networks $(ARGS)

test-learners:  ## RLlib, TorchRL, BenchMARL, Stable-Baselines3 on the building search, in an environment of their own (8 GB)
	$(PYTHON) -m venv .venv-learners
	.venv-learners/bin/python -m pip install --quiet --disable-pip-version-check --editable '.[gym]' pytest supersuit \
	  'stable-baselines3>=2.4' 'ray[rllib]>=2.40' torchrl benchmarl
	.venv-learners/bin/python -m pytest tests/learners $(ARGS)

fuzz: $(STAMP)  ## give every reader 100,000 damaged files (ARGS="policy --runs 1000")
	$(BIN)/python tests/fuzz.py $(ARGS)

wheels: $(STAMP)  ## build the wheel; try it in empty environments (ARGS="--extras torch,ray,all")
	$(BIN)/python tests/wheels.py $(ARGS)

kills: $(STAMP)  ## stop commands at random moments, and let them finish (ARGS="train --rounds 50")
	$(BIN)/python tests/kills.py $(ARGS)

bench: $(STAMP)  ## measure speed; prints ratios within one run
	for file in $(filter-out %/instructions.py %/detector.py,$(wildcard benchmarks/*.py)); do echo "== $$file"; $(BIN)/python $$file $(ARGS) || exit 1; done

instructions: $(STAMP)  ## count the simulator's machine instructions with valgrind, and compare with the record
	$(BIN)/python benchmarks/instructions.py $(ARGS)

docs: $(STAMP)  ## build the documentation into site/
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[docs]'
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

test-docs: docs chromium  ## open every page of the documentation in a browser: axe, widths, the replay
	$(BIN)/pytest -m slow tests/docs/test_site.py $(ARGS)

format: $(STAMP)  ## sort imports and mend what ruff can mend
	$(BIN)/ruff check --fix .

clean:  ## remove the environment and what was built
	rm -rf $(VENV) .venv-learners site build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
