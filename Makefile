# Every target first runs the set-up that it needs; a finished set-up is not repeated.
SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
.PHONY: help setup workspace view demo test test-all check docs bench blind results soak mutants clean

ENV := source ros2_ws/env.sh;
WORKERS ?= 2
TESTS ?=
SOAK ?= 1800
# The plug-ins of launch are of no use here and would be loaded by every worker. conftest.py orders the modules.
PYTEST = python -m pytest -n $(WORKERS) --dist loadscope --no-loadscope-reorder -p no:launch_testing -p no:launch_pytest \
	-p no:launch_testing_ros_pytest_entrypoint

help: ## show this list
	@sed -nE 's/^([a-z-]+):.*## (.*)/make \1@\2/p' Makefile | column -t -s @

setup: workspace ## make .venv and the colcon workspace, compile kernels (PYTHON=/path/to/python3.12 chooses the interpreter)
	@$(ENV) python -m via_bringup.compile_kernels

workspace:
	@PYTHON="$(PYTHON)" ros2_ws/setup.sh

view: workspace ## install rerun into .venv for `via watch --web` (half a gigabyte)
	@$(ENV) python -m pip install --quiet --disable-pip-version-check --no-input -r ros2_ws/requirements-view.txt

demo: setup ## estimate and diagnose recordings of a real robot, run a simulated joint; write out/demo/index.html
	@$(ENV) via demo

test: workspace ## run the quick tests: all but those marked slow (TESTS="via_sim/test tests/test_sim_node.py" for some, WORKERS=2)
	@$(ENV) $(PYTEST) -m "not slow" $(TESTS)

test-all: workspace ## run every test, as continuous integration does (TESTS and WORKERS as above; half an hour on two cores)
	@$(ENV) $(PYTEST) $(TESTS)

check: workspace ## check style, types, import rules, machine paths and the documentation site
	@$(ENV) ros2_ws/check.sh

docs: workspace ## build the documentation site, out/docs/index.html; fails on a warning
	@$(ENV) ros2_ws/docs.sh out/docs
	@echo "docs: open out/docs/index.html"

bench: setup ## compare speed with MuJoCo, scipy, mcap-ros2-support, Eigen and padasip
	@$(ENV) via bench all

blind: setup ## diagnose and score 30 joints of the second simulator, keys sealed (development seeds; ten minutes)
	@$(ENV) rm -rf out/blind && mkdir -p out/blind && cd out/blind && \
		via gap blind make --out cases --keys keys --seed-from 2000 --count 30 --processes $(WORKERS) && \
		via gap blind run cases --results results --processes $(WORKERS) && \
		via gap blind score cases --keys keys --results results --processes $(WORKERS) --write .

results: setup ## rewrite docs/results: tables of the research document, comparison, change, faults (about half an hour)
	@$(ENV) via tables --write docs/results && via compare --seeds 10 --write docs/results && \
		via changes --seeds 3 --write docs/results && via faults --write docs/results

soak: setup ## run the live graph at 1 kHz for SOAK=1800 seconds; write docs/results/soak-live.md
	@$(ENV) via soak --seconds $(SOAK) --write docs/results

mutants: setup ## plant 200 small errors in the numerical heart and count those that the tests notice (some hours)
	@$(ENV) rm -rf out/mutants && via mutants --processes $(WORKERS) --write docs/results

clean: ## return to a fresh clone
	@rm -rf .venv ros2_ws/build ros2_ws/install ros2_ws/log out .numba_cache .pytest_cache .mypy_cache .ruff_cache \
		.hypothesis .import_linter_cache
	@find . -name __pycache__ -prune -exec rm -rf {} + -o -name '*.egg-info' -prune -exec rm -rf {} +
