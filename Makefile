# Every target sets up what it needs first; set-up does nothing when it is done.
SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
.PHONY: help setup workspace demo test check bench blind results clean

ENV := source ros2_ws/env.sh;
WORKERS ?= 2
TESTS ?=

help: ## this list
	@sed -nE 's/^([a-z]+):.*## (.*)/make \1@\2/p' Makefile | column -t -s @

setup: workspace ## .venv from the lock, the colcon workspace, compiled kernels (PYTHON=/path/to/python3.12 chooses the interpreter)
	@$(ENV) python -m via_bringup.kernels

workspace:
	@PYTHON="$(PYTHON)" ros2_ws/setup.sh

demo: setup ## the main job on a real robot's log and on a live simulated joint; writes out/demo/index.html
	@$(ENV) via demo

test: workspace ## all tests (TESTS="via_ros/test tests/test_ros_player.py" for some, WORKERS=2)
	@$(ENV) python -m pytest -n $(WORKERS) --dist loadscope -p no:launch_testing -p no:launch_pytest -p no:launch_testing_ros_pytest_entrypoint $(TESTS)

check: workspace ## style, types, import rules
	@$(ENV) ros2_ws/check.sh

bench: setup ## speed against MuJoCo, scipy, mcap-ros2-support, Eigen and padasip, each in one run
	@$(ENV) via bench all

blind: setup ## 30 joints of a second simulator, diagnosed without their keys and scored (development seeds; ten minutes)
	@$(ENV) rm -rf out/blind && mkdir -p out/blind && cd out/blind && \
		via gap blind make --out cases --keys keys --seed-from 2000 --count 30 --processes $(WORKERS) && \
		via gap blind run cases --results results --processes $(WORKERS) && \
		via gap blind score cases --keys keys --results results --processes $(WORKERS) --write .

results: setup ## docs/results anew: the document's tables and ours, the comparison (about a quarter of an hour)
	@$(ENV) via tables --write docs/results && via compare --write docs/results

clean: ## back to a fresh clone
	@rm -rf .venv ros2_ws/build ros2_ws/install ros2_ws/log out .numba_cache .pytest_cache .mypy_cache .ruff_cache \
		.hypothesis .import_linter_cache
	@find . -name __pycache__ -prune -exec rm -rf {} + -o -name '*.egg-info' -prune -exec rm -rf {} +
