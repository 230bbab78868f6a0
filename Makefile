# SPDX-License-Identifier: Apache-2.0
# Environment, demo, tests, benchmarks; `make` without a target lists the targets.

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.NOTPARALLEL:
SHELL := /bin/sh

# Python interpreter for .venv; unset: the first suitable one on the path.
PYTHON ?=
BIN := .venv/bin
# Number of test processes; test/conftest.py sets the default.
WORKERS ?= auto
# The sample of `make mutants`: rooms (none: all pure rooms), mutants per room, seed.
ROOM ?=
N ?= 60
SEED ?= 1
# Seconds of `make soak`.
DURATION ?= 3600
# The test processes have the cores: threads of OpenBLAS in each only disturb.
PYTEST := OPENBLAS_NUM_THREADS=1 $(BIN)/pytest --numprocesses $(WORKERS) --dist worksteal

# Keep DDS traffic on this machine, and keep a sourced ROS or another environment out.
export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST
ifneq ($(AMENT_PREFIX_PATH)$(_ROS_WHEELS_BOOTSTRAP_COMPLETE),)
unexport LD_LIBRARY_PATH
endif
unexport AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH PYTHONHOME PYTHONPATH VIRTUAL_ENV
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE
export PIP_DISABLE_PIP_VERSION_CHECK := 1
# Containers often set it; without bytecode every process start takes twice the CPU time.
unexport PYTHONDONTWRITEBYTECODE

help:  ## list the targets
	@sed -n 's/^\([a-z]*\):.*## /\1\t/p' $(MAKEFILE_LIST) | expand -t 10

setup: .venv/.installed  ## make .venv: what the demo needs, the messages, the compiled kernel, and this tree, editable

demo: setup  ## run all nodes on the simulated cell and write a report
	$(BIN)/scara-effmass demo --force

test: .venv/.caches lint kernel  ## run lint, types and all tests
	$(PYTEST)

check: .venv/.caches lint kernel  ## run lint, types and the tests without DDS and processes
	$(PYTEST) -m "not live"

lint: .venv/.test  ## run ruff and mypy
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy

coverage: .venv/.test  ## measure the branch coverage of each room; ROOM restricts the tests
	@mkdir -p build
	$(PYTEST) --cov --cov-report= $(addprefix test/,$(ROOM))
	@# What numba compiles is not measured, so its tests run again as Python.
	NUMBA_DISABLE_JIT=1 $(PYTEST) --cov --cov-append --cov-report= test/kernel
	$(BIN)/python scripts/coverage_table.py $(ROOM)

mutants: .venv/.test  ## test mutants of the pure rooms; ROOM, N and SEED choose the sample
	$(BIN)/python scripts/mutants.py $(ROOM) --number $(N) --seed $(SEED)

bench: .venv/.test  ## measure the speed of core, nodes, bag reader, assess and recorder
	$(BIN)/python benchmarks/run.py

fuzz: .venv/.test  ## damaged input through core, live node and file parsers; N sequences (a tenth messages, a 500th of each file) and SEED
	$(BIN)/python test/endurance/fuzz.py --number $(if $(filter command line environment,$(origin N)),$(N),1000000) --seed $(SEED)

faults: .venv/.test  ## inject faults into live nodes one by one and write them into docs/measured.md; takes about 6 minutes
	$(BIN)/pytest --numprocesses 0 test/endurance/faults.py

soak: .venv/.test  ## run all nodes at 1 kHz for DURATION seconds and write the figures into docs/measured.md
	$(BIN)/python test/endurance/soak.py --duration $(DURATION) --write

scale: .venv/.test  ## assess many recordings with 1 and 2 worker processes, end some of them, and write the table into docs/measured.md
	$(BIN)/python benchmarks/scale.py --write

bags: setup  ## generate the shipped recordings again
	$(BIN)/python -m scara_effmass.studies.shipped_bags -o bags --force

docs: setup .venv-tools/.requirements  ## build the documentation as a site in build/site; a warning is an error
	$(BIN)/python scripts/docs_reference.py
	.venv-tools/bin/sphinx-build --quiet --fail-on-warning --keep-going --conf-dir docs . build/site

dist: setup  ## build sdist and wheel in build/dist and use the wheel in a clean environment
	scripts/check_dist.sh $(BIN)/python build/dist

sbom: dist .venv-tools/.requirements  ## list what the clean environment of `make dist` holds in build/dist/sbom.json (CycloneDX)
	.venv-tools/bin/cyclonedx-py environment --output-file build/dist/sbom.json build/dist/venv

colcon: .venv-colcon/.requirements  ## build the tree as a ROS workspace and check the installation
	scripts/check_colcon.sh .venv-colcon build/colcon

lock: setup  ## update the locked requirements
	$(BIN)/python -m pip install --quiet uv
	scripts/lock_requirements.sh $(BIN)/python

clean:  ## remove all generated files
	rm -rf .venv .venv-colcon .venv-tools build out .mypy_cache .pytest_cache .ruff_cache .hypothesis

.PHONY: help setup demo test check kernel lint coverage mutants bench fuzz faults soak scale bags docs dist sbom colcon lock clean

# The stamps are written last, so that an interrupted set-up starts over.
.venv/.requirements: requirements/setup.lock
.venv-colcon/.requirements: requirements/colcon.lock
.venv-tools/.requirements: requirements/tools.lock
%/.requirements:
	@python=$$(scripts/check_machine.sh . $(PYTHON)) && \
	rm -rf $* $(if $(filter .venv,$*),build/messages-*) && \
	echo "making $* with $$($$python --version)" && \
	$$python -m venv $* && \
	scripts/install_locked.sh $* $< && \
	touch $@

# Everything else that tests, measurements and all commands need.
.venv/.test: requirements/test.lock .venv/.installed
	@echo "installing what the tests need"
	@scripts/install_locked.sh .venv $<
	@touch $@

# The editable installation keeps a list of the modules.
.venv/.modules: FORCE | .venv/.requirements
	@find scara_effmass -name '*.py' | sort > $@.new
	@cmp -s $@.new $@ && rm $@.new || mv $@.new $@
FORCE:

# Once, where its sources have changed since the installation: else each test process does so.
kernel: .venv/.test
	@$(BIN)/python scripts/compile_kernel.py

# What mypy and pytest compile once, at the same time: else one core waits for mypy, and then each test process compiles
# all tests.
.venv/.caches: .venv/.test
	@echo "preparing mypy and the tests"
	@$(BIN)/mypy > /dev/null & $(BIN)/pytest --collect-only --quiet > /dev/null; wait; touch $@

# The kernel compiles while the messages are built; it needs this tree, not its installation.
.venv/.installed: .venv/.requirements .venv/.modules pyproject.toml package.xml setup.py \
		$(shell find cmake msg_schemas scripts -type f)
	@echo "building the messages and compiling the kernel"
	@PYTHONPATH=. $(BIN)/python scripts/compile_kernel.py & \
	$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation --editable . && installed=1; \
	wait $$! && [ "$$installed" ] && touch $@
