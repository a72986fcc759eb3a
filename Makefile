# Commands of this checkout. `make` without a target lists them.
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
MAKEFLAGS += --no-print-directory
.DEFAULT_GOAL := help

# Tests and demonstrations stay on this machine unless this variable is set.
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST
# Byte code is kept for the many processes that tests start, regardless of the user's environment.
export PYTHONDONTWRITEBYTECODE :=

RUN := source tools/env.sh &&
PYTEST := pytest -n 4 --dist loadgroup --no-loadscope-reorder --durations=5 --durations-min=4
SLOW := slow or statistics or (live and not smoke)
PYTEST_ARGS ?=

VOYAGES ?= 1000
HOURS ?= 100
CELLS ?= 0
RUNS ?= 2000
LIVE_HOURS ?= 24
BAG_HOURS ?= 1 10 100
FAULT_ARGS ?=
ARGS ?=
PORT ?= 5006

.PHONY: help setup setup-all test test-all lint quick demo watch bags golden bench campaign faults returns hours kills reproduction stanford availability wheels bundle release audit clean

help: ## this list
	@sed -n 's/^\([a-z-]*\):.*## /\1\t/p' $(MAKEFILE_LIST) | expand -t 14

setup: ## environment and build; minutes the first time, seconds afterwards
	@tools/setup

setup-all: ## the same with optional wheels: Parquet, GTSAM, style and types
	@tools/setup --all

test: setup-all ## tests for daily work, in minutes; PYTEST_ARGS="-k name" for some of them
	@$(RUN) $(PYTEST) -m "not ($(SLOW))" $(PYTEST_ARGS)

test-all: setup-all ## the remaining tests: statistics, slow tests, live tests
	@$(RUN) $(PYTEST) -m "$(SLOW)" $(PYTEST_ARGS)

lint: setup-all ## style, types, import rules, language
	@$(RUN) ruff check . && mypy && lint-imports --no-logo && python tools/words.py

quick: setup ## the ship's attitude from the bag of a voyage, offline: table and figure in seconds
	@$(RUN) python tools/demo.py --offline

demo: setup ## a simulated voyage from bag to report
	@$(RUN) python tools/demo.py

watch: setup ## a simulated voyage in a loop, live, and its page in the browser; PORT=5007 for another port
	@$(RUN) exec python tools/watch.py --port $(PORT)

bags: setup ## the bags in bags/, from their scenarios
	@$(RUN) python tools/make_bags.py

golden: setup ## the numbers that replays publish, compared to the last bit; ARGS=--renew where they changed on purpose
	@$(RUN) python tools/golden.py $(ARGS)

bench: setup-all ## speed, as ratios within one run; ARGS="--only setup" for a part
	@$(RUN) python tools/bench.py $(ARGS)

campaign: setup-all ## 2000 seeds of each case (ten hours on two cores), long voyages; RUNS=50 LIVE_HOURS=2 BAG_HOURS="1 10" for less
	@$(RUN) python tools/campaign.py --seeds $(RUNS)
	@$(RUN) python tools/pointing_campaign.py
	@$(RUN) FUZZED_MESSAGES=100000 pytest -q -s test/test_fuzzed_messages.py
	@$(RUN) FAULT_SEEDS=20 pytest -q -s test/test_pointing_faults.py
	@$(RUN) FAULT_SEEDS=40 pytest -q -s src/ship_attitude_star/test/test_fault_detection.py -k any_size
	@$(RUN) SEEDS=32 pytest -q -s src/ship_attitude_star/test/test_interpolated_ins.py \
	    src/ship_attitude_star/test/test_wide_clocks.py src/ship_studies/test/test_calibration_consistency.py
	@$(RUN) TEN_MINUTES=6 pytest -q -s src/ship_estimation/test/test_integrated_rates.py -k noise_alone
	@$(RUN) SKY_SEEDS=12 pytest -q -s test/test_star_level_filter.py
	@$(RUN) STAR_SCENES=10000 STAR_EPOCHS=10000 pytest -q -s src/ship_stars/test/test_star_solution.py
	@$(RUN) python tools/long_bags.py --hours $(BAG_HOURS)
	@$(RUN) python tools/live_memory.py --hours $(LIVE_HOURS)

faults: setup ## voyages with faults: detection, isolation, errors within the protection level; VOYAGES=40 for few
	@$(RUN) python tools/faults.py --voyages $(VOYAGES) $(FAULT_ARGS)

returns: setup ## time until all outputs are VALID after every fault of every input; CELLS=50 for some
	@$(RUN) python tools/returns.py --cells $(CELLS)

hours: setup ## a hundred hours without faults: false exclusions, availability, levels; HOURS=5 for few
	@$(RUN) python tools/clean_hours.py --hours $(HOURS)

stanford: setup ## errors against protection levels, a million epochs: docs/figures/stanford*.png
	@$(RUN) python tools/stanford.py

availability: setup ## star vectors and other methods under clouds, and stars minus INS alongside: docs/explanation/availability.md
	@$(RUN) python tools/availability.py
	@$(RUN) python tools/mooring.py

reproduction: setup ## values printed in the papers and those computed here: docs/reproduction.md and its figures
	@$(RUN) python -m tools.reproduction

kills: setup ## kill -9 of recorder and node at random times: lost messages
	@$(RUN) python tools/kill_campaign.py

wheels: setup ## prebuilt wheels of our own packages, in prebuilt/, for set-up without a compiler
	@$(RUN) python tools/make_wheels.py

bundle: setup ## one tar of this commit with all wheels, to set up without a network; FOR=3.12 for another Python
	@$(RUN) python tools/bundle.py $(if $(FOR),--for $(FOR))

release: setup ## one tar of this commit with the C that Cython generates: colcon builds it without Cython
	@$(RUN) python tools/bundle.py --no-wheels

audit: setup-all ## known vulnerabilities of the pinned packages, and their licences; needs the network
	@$(RUN) python tools/licences.py --check
	@$(RUN) python tools/audit.py

clean: ## remove built files; out/ with your files and the wheels in .venv stay
	@rm -rf build install log .pytest_cache .mypy_cache .ruff_cache .import_linter_cache
	@find src -name 'compiled_*.c' -delete -o -name 'compiled_*.so' -delete -o -name 'compiled_sources.sha256' -delete
	@find src test tools -name __pycache__ -prune -exec rm -rf {} + 2>/dev/null || true
