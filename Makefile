# Two commands do everything on a fresh machine: `make demo` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
LOWEST := .venv-lowest
WHEEL := .venv-wheel
INSTALL := $(BIN)/uv pip install --quiet --python $(BIN)/python
# What Python makes of a file is kept, whatever the environment says: each command that a test runs would make it anew.
unexport PYTHONDONTWRITEBYTECODE
PYTEST := $(BIN)/pytest --numprocesses auto --maxprocesses 4 --dist worksteal

.PHONY: demo test test-all style contracts loops tests slow browser cluster season mutated processes docs tutorials ros \
	coverage fuzz goldens mutants compare test-lowest package kernels benchmark pages clean

demo: $(VENV)/demo
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
	$(BIN)/touchline compile

tests: loops
	$(PYTEST) -m "not slow"

# Every night: also what takes minutes, what needs a browser or ROS, the tutorials word by word, the lowest versions.
test-all: test slow contracts docs tutorials browser cluster season mutated processes ros test-lowest

slow: loops
	$(PYTEST) -m slow

# Who may import whom, as pyproject.toml has it.
contracts: $(VENV)/installed
	$(PYTHON) -m venv $(VENV)-contracts
	$(VENV)-contracts/bin/pip install --quiet 'import-linter>=2.2,<3'
	PYTHONPATH=src:lab/src $(VENV)-contracts/bin/lint-imports

# Without Chromium it says how to install one, and fails.
browser: $(VENV)/installed
	$(BIN)/pytest tests/browser_pages.py

# The ROS package's node, `live ros` and `play ros` under a real rclpy, which x86-64 and Python 3.11 have as wheels.
ros: loops
	$(INSTALL) --editable '.[ros-test]'
	$(BIN)/pytest tests/ros_node.py

# The command for a running robot in a process of its own, killed in the middle.
processes: $(VENV)/installed
	$(BIN)/pytest tests/live_processes.py

# Ten thousand mutated messages by every way in.
mutated: $(VENV)/installed
	TOUCHLINE_MUTATED=10000 $(BIN)/pytest tests/test_live.py tests/test_live_messages.py tests/test_pixel_features.py \
	  -k mutated

# The same numbers on one core, on two and on a cluster.
cluster: $(VENV)/installed
	$(BIN)/pytest lab/tests/cluster_workers.py

# Recordings in an object store, a cluster whose worker dies, the questions of the season's page.
season: $(VENV)/installed
	$(INSTALL) 'moto[server]' s3fs duckdb
	$(BIN)/pytest tests/season_store.py

# The documentation as a site, build/docs/site: any warning and any link that leads nowhere is an error.
docs: $(VENV)/installed
	$(INSTALL) --editable '.[docs]'
	$(BIN)/python docs/site/build.py

# Every command of the tutorials, with images and calibration.
tutorials: $(VENV)/installed
	$(BIN)/pytest lab/tests/whole_tutorials.py

# Which lines the tests reach: they take a sixth longer.
coverage: $(VENV)/installed
	$(PYTEST) -m "not slow" --cov --cov-report=term:skip-covered

# The recorded trajectories anew, each row's facts before and after.
goldens: loops
	$(BIN)/python tests/goldens.py

# Every system's numbers on recordings and scenarios, compared with another revision's bit for bit: make compare REVISION=v0.1.0
compare: $(VENV)/installed
	$(BIN)/python lab/benchmarks/compare_runs.py $(REVISION)

# The lowest versions that pyproject.toml allows, in an environment and with compiled loops of their own.
test-lowest:
	$(PYTHON) -m venv --clear $(LOWEST)
	$(LOWEST)/bin/pip install --quiet uv
	$(LOWEST)/bin/uv pip install --quiet --python $(LOWEST) --resolution lowest-direct --editable '.[dev]' --editable lab
	NUMBA_CACHE_DIR=$(CURDIR)/$(LOWEST)/numba $(LOWEST)/bin/touchline demo --output $(LOWEST)/demo
	NUMBA_CACHE_DIR=$(CURDIR)/$(LOWEST)/numba $(LOWEST)/bin/pytest -m "not slow" --numprocesses auto --maxprocesses 4

# Sources and wheels of both packages as they would be published, whether the index would take and show them, and
# whether the core runs alone and the lab beside it.
package: $(VENV)/installed
	rm -rf dist
	$(INSTALL) build twine
	$(BIN)/python -m build --outdir dist
	$(BIN)/python -m build --outdir dist lab
	$(BIN)/twine check --strict dist/*
	$(PYTHON) -m venv --clear $(WHEEL)
	$(WHEEL)/bin/pip install --quiet dist/touchline-*.whl
	cd $(WHEEL) && bin/touchline demo --output demo
	$(WHEEL)/bin/pip install --quiet --find-links dist dist/touchline_lab-*.whl
	cd $(WHEEL) && bin/touchline simulate match --seconds 1 --level points --output match

# Wheels of compiled loops for x86-64-v3 and ARMv8, which fit this Python and these versions of Numba and NumPy, in
# build/kernels: five minutes of a core, on x86-64 with AVX2.
kernels: $(VENV)/installed
	$(INSTALL) build wheel
	$(BIN)/python kernels/kernel_wheels.py build/kernels

# Any number of hostile files through every reader: make fuzz N=100000 SEED=7
fuzz: N ?= 20000
fuzz: SEED ?= 0
fuzz: $(VENV)/installed
	$(BIN)/python tests/fuzzing.py $(N) --seed $(SEED) 2>/dev/null

# Faults laid into a copy of the code, and which of them no test notices: N into every room (make mutants N=5 SEED=7), or
# those of a list (make mutants LIST=tests/mutants.jsonl).
mutants: N ?= 1
mutants: SEED ?= 0
mutants: loops
	$(BIN)/python tests/mutants.py $(if $(LIST),--list $(LIST),$(N) --seed $(SEED))

benchmark: $(VENV)/installed
	$(BIN)/pytest lab/benchmarks --benchmark-only --benchmark-sort=name

# Results, benchmark and figures anew, from this commit: a night on two cores; stopped, it goes on in a folder of build/pages.
# TOUCHLINE_DATA names the folder of the public recordings.
pages: WORKERS ?= 2
pages: BUDGET ?= 12
pages: PAGES = build/pages/$(shell git rev-parse --short=12 HEAD)
pages: BENCH = $(PAGES)/benchmark
pages: $(VENV)/installed
	test -d "$(TOUCHLINE_DATA)"
	$(BIN)/touchline experiment all --workers $(WORKERS) --budget $(BUDGET) --seeds 30 --output $(PAGES)
	$(BIN)/touchline bench suite touchline-bench-1 --workers $(WORKERS) --output $(BENCH)/systems.jsonl $(foreach system, \
	  touchline nubot-mti nubot-mcl iris-fusion nimbro-lines nubot-mti:paper nubot-mcl:paper iris-fusion:paper \
	  nimbro-lines:paper, --system $(system))
	$(BIN)/touchline bench export touchline-bench-1 $(BENCH)/inputs
	$(BIN)/python lab/benchmarks/baselines/amcl.py $(BENCH)/inputs $(BENCH)/amcl
	$(BIN)/python lab/benchmarks/baselines/marker_search.py $(BENCH)/inputs $(BENCH)/marker-search
	$(CXX) -O2 -std=c++17 -o $(BENCH)/odometry_alone lab/benchmarks/baselines/odometry_alone.cpp
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

$(BIN)/uv:
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check uv

$(VENV)/demo: pyproject.toml | $(BIN)/uv
	$(INSTALL) --editable .
	touch $@

$(VENV)/installed: pyproject.toml lab/pyproject.toml | $(BIN)/uv
	$(INSTALL) --editable '.[dev]' --editable lab
	touch $@ $(VENV)/demo

clean:
	rm -rf $(VENV) $(VENV)-contracts $(LOWEST) $(WHEEL)
