# Two commands do everything on a fresh machine: `make demo` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
LOWEST := .venv-lowest
WHEEL := .venv-wheel
# What Python makes of a file is kept, whatever the environment says: each command that a test runs would make it anew.
unexport PYTHONDONTWRITEBYTECODE
PYTEST := $(BIN)/pytest --numprocesses auto --maxprocesses 4 --dist worksteal

.PHONY: demo test test-all style loops kernels tests browser cluster season docs tutorials mutated fastdds ros processes coverage fuzz goldens mutants test-lowest package benchmark pages clean zenoh

demo: $(VENV)/installed
	$(BIN)/touchline demo

# Style is looked at while the loops are compiled and the first tests run.
test: $(VENV)/installed
	$(MAKE) --jobs=2 style tests

style: $(VENV)/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# Once, not in each of the tests' processes.
loops: $(VENV)/installed
	$(BIN)/touchline compile --all

tests: loops
	$(PYTEST)

# Also the documentation's site, its tutorials word by word, and what needs a browser, the viewer and the tuner; without Chromium
# it says how to install one, and fails.
test-all: test docs tutorials browser cluster season mutated fastdds processes

browser: $(VENV)/extras
	$(BIN)/pytest tests/browser_pages.py tests/browser_viewer.py

# Every message between our DDS and the one that ROS 2 speaks by default; without its library it says how to install it.
fastdds: $(VENV)/installed
	$(BIN)/pytest tests/fastdds_peer.py

# ROS 2 over Zenoh between our link and another client of it.
zenoh: $(VENV)/installed
	$(BIN)/pip install --quiet zenoh-ros2-sdk
	$(BIN)/pytest tests/zenoh_peer.py

# The ROS package's node and bridge under a real rclpy, which x86-64 and Python 3.11 have as wheels.
ros: loops
	$(BIN)/pip install --quiet --editable '.[ros-test]'
	$(BIN)/pytest tests/ros_node.py

# The command for a running robot in a process of its own, killed in the middle.
processes: $(VENV)/installed
	$(BIN)/pytest tests/live_processes.py

# Ten thousand mutated messages by every link.
mutated: $(VENV)/installed
	TOUCHLINE_MUTATED=10000 $(BIN)/pytest tests/test_live.py tests/test_live_dds.py tests/test_pixel_features.py -k mutated

# The same numbers on one core, on two and on a cluster.
cluster: $(VENV)/installed
	$(BIN)/pytest tests/cluster_workers.py

# Recordings in an object store, a cluster whose worker dies, the questions of the season's page.
season: $(VENV)/installed
	$(BIN)/pip install --quiet 'moto[server]' s3fs duckdb
	$(BIN)/pytest tests/season_store.py

# The documentation as a site, build/docs/site: any warning and any link that leads nowhere is an error.
docs: $(VENV)/installed
	$(BIN)/pip install --quiet --editable '.[docs]'
	$(BIN)/python docs/site/build.py

# Every command of the tutorials, with images and calibration.
tutorials: $(VENV)/installed
	$(BIN)/pytest tests/whole_tutorials.py

# Which lines the tests reach: they take a sixth longer.
coverage: $(VENV)/installed
	$(PYTEST) --cov --cov-report=term:skip-covered

# The lowest versions that pyproject.toml allows, in an environment and with compiled loops of their own.
test-lowest:
	$(PYTHON) -m venv --clear $(LOWEST)
	$(LOWEST)/bin/pip install --quiet uv
	$(LOWEST)/bin/uv pip install --quiet --python $(LOWEST) --resolution lowest-direct --editable '.[dev]'
	NUMBA_CACHE_DIR=$(CURDIR)/$(LOWEST)/numba $(LOWEST)/bin/touchline demo --output $(LOWEST)/demo
	NUMBA_CACHE_DIR=$(CURDIR)/$(LOWEST)/numba $(LOWEST)/bin/pytest --every 10 --numprocesses auto --maxprocesses 4

# Source and wheel as they would be published, whether the index would take and show them, and whether the wheel runs.
package: $(VENV)/installed
	rm -rf dist
	$(BIN)/pip install --quiet build twine
	$(BIN)/python -m build
	$(BIN)/twine check --strict dist/*
	$(PYTHON) -m venv --clear $(WHEEL)
	$(WHEEL)/bin/pip install --quiet dist/*.whl
	cd $(WHEEL) && bin/touchline demo --output demo

# Wheels of compiled loops for x86-64-v3 and ARMv8, which fit this Python and these versions of Numba and NumPy, in
# build/kernels: five minutes of a core, on x86-64 with AVX2.
kernels: $(VENV)/installed
	$(BIN)/pip install --quiet build wheel
	$(BIN)/python kernels/kernel_wheels.py build/kernels

# Any number of hostile files through every reader: make fuzz N=100000 SEED=7
fuzz: N ?= 20000
fuzz: SEED ?= 0
fuzz: $(VENV)/installed
	$(BIN)/python tests/fuzzing.py $(N) --seed $(SEED) 2>/dev/null

# Faults laid into a copy of the code, N into every room, and which of them no test notices; two minutes on two cores:
# make mutants N=5 SEED=7
mutants: N ?= 1
mutants: SEED ?= 0
mutants: $(VENV)/installed
	$(BIN)/python tests/mutants.py $(N) --seed $(SEED)

# Golden trajectories and facts of the replays, from this code: prints each fact before and after.
goldens: $(VENV)/installed
	$(BIN)/python tests/goldens.py

benchmark: $(VENV)/installed
	$(BIN)/pytest benchmarks --benchmark-only --benchmark-sort=name

# Results, benchmark and figures anew, from this commit: a night on two cores; stopped, it goes on in a folder of build/pages.
# TOUCHLINE_DATA names the folder of the public recordings.
pages: WORKERS ?= 2
pages: BUDGET ?= 12
pages: PAGES = build/pages/$(shell git rev-parse --short=12 HEAD)
pages: BENCH = $(PAGES)/benchmark
pages: loops
	test -d "$(TOUCHLINE_DATA)"
	$(BIN)/touchline experiment all --workers $(WORKERS) --budget $(BUDGET) --seeds 30 --output $(PAGES)
	$(BIN)/touchline bench suite touchline-bench-1 --workers $(WORKERS) --output $(BENCH)/systems.jsonl $(foreach system, \
	  touchline nubot-mti nubot-mcl iris-fusion nimbro-lines nubot-mti:paper nubot-mcl:paper iris-fusion:paper \
	  nimbro-lines:paper, --system $(system))
	$(BIN)/touchline bench export touchline-bench-1 $(BENCH)/inputs
	$(BIN)/python benchmarks/baselines/amcl.py $(BENCH)/inputs $(BENCH)/amcl
	$(BIN)/python benchmarks/baselines/marker_search.py $(BENCH)/inputs $(BENCH)/marker-search
	$(CXX) -O2 -std=c++17 -o $(BENCH)/odometry_alone benchmarks/baselines/odometry_alone.cpp
	mkdir -p $(BENCH)/odometry-alone
	for drive in $(BENCH)/inputs/*/; do \
	  $(BENCH)/odometry_alone $$drive > $(BENCH)/odometry-alone/$$(basename $$drive).tum || exit; done
	$(BIN)/touchline bench score touchline-bench-1 $(BENCH)/amcl $(BENCH)/marker-search $(BENCH)/odometry-alone \
	  --output $(BENCH)/baselines.jsonl
	rm -f docs/benchmark/*.jsonl
	cp $(BENCH)/systems.jsonl $(BENCH)/baselines.jsonl docs/benchmark/
	$(BIN)/python docs/images/results.py $(PAGES)
	$(BIN)/python docs/images/figures.py --measure "$(TOUCHLINE_DATA)"
	$(BIN)/python docs/images/benchmark.py
	$(BIN)/python docs/images/integrity.py
	$(BIN)/python docs/images/own_system.py

$(VENV)/installed: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/pip install --quiet --editable '.[dev]'
	touch $@

# The extra that is large: with it, `make test` tests more.
$(VENV)/extras: $(VENV)/installed
	$(BIN)/pip install --quiet --editable '.[view]'
	touch $@

clean:
	rm -rf $(VENV) $(LOWEST) $(WHEEL)
