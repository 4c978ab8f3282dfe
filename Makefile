# make evaluate      the environment and the main job
# make test          the environment and the fast tests
# make test-all      these and the long ones, in one run, so that what they share is made once
# make test-nightly  trainings, processes and nodes that are killed, and all combinations
# make coverage      the fast tests, and which share of the lines they run
# make test-gpu      the kernels for CUDA devices; on one, its worlds are compared with those of the CPU
# make attack        what hostile submissions, files, numbers and machines can do, tried again
# make lint          format, lint and types
# make results       the generated files that are stale (hours); ARGS=--plan only says which and why
# make site          the documentation and the leaderboard as a site, in site/
#
# Another set of dependencies: make test VENV=.venv-imitation EXTRAS=all
# With RLlib, about a minute:  make test VENV=.venv-rllib EXTRAS=dev,rllib ARGS="-m slow"

PYTHON ?= python3
VENV ?= .venv
EXTRAS ?= dev,fit,minari,onnx,orca,pedpy,ray,site,tensorboard,torchrl,video,viewer
BIN := $(VENV)/bin
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt

.PHONY: evaluate test test-all test-nightly test-gpu attack coverage lint results site clean

evaluate: $(VENV)/core.stamp
	$(BIN)/crowdbench evaluate eth-v0 --out results/eth
	$(BIN)/crowdbench evaluate plaza-v0 --quick --out results/plaza

ARGS ?= -n auto --dist loadgroup

test: $(VENV)/dev.stamp
	$(BIN)/python -m pytest $(ARGS)

test-all: $(VENV)/dev.stamp
	$(BIN)/python -m pytest $(ARGS) -m "not slow and not nightly"

test-nightly: $(VENV)/dev.stamp
	$(BIN)/python -m pytest $(ARGS) -m "nightly and not slow"

test-gpu:
	$(MAKE) test VENV=.venv-gpu EXTRAS=dev,gpu ARGS="tests/gpu tests/simulation/test_cuda.py"

attack: $(VENV)/dev.stamp
	$(BIN)/python tests/attack.py

coverage: $(VENV)/dev.stamp
	$(BIN)/python -m pytest $(ARGS) --cov --cov-report=term:skip-covered

lint: $(VENV)/dev.stamp
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

results: ARGS =
results: $(VENV)/dev.stamp
	$(BIN)/python -m studies.remake $(ARGS)

site: $(VENV)/dev.stamp
	$(BIN)/python -m studies site --out site

$(BIN)/python:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "crowdbench needs Python 3.11 or newer; name one with make PYTHON=…")'
	$(PYTHON) -m venv $(VENV)

$(VENV)/core.stamp: $(BIN)/python pyproject.toml constraints.txt
	$(INSTALL) -e .
	touch $@

# The models of other simulators: make .venv-peers/peers.stamp
.venv-peers/peers.stamp: pyproject.toml constraints.txt examples/peers/requirements.txt
	$(PYTHON) -m venv .venv-peers
	.venv-peers/bin/python -m pip install --quiet --disable-pip-version-check -c constraints.txt \
		-e . -r examples/peers/requirements.txt
	touch $@

$(VENV)/dev.stamp: $(BIN)/python pyproject.toml constraints.txt
	$(INSTALL) -e ".[$(EXTRAS)]"
	touch $@ $(VENV)/core.stamp

clean:
	rm -rf .venv .venv-* results site build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis .coverage
