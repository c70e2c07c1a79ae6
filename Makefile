# Needs only python3 >= 3.11, a C compiler and make.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.zoo-setup
APART := --ignore tests/test_readme.py --ignore tests/test_installed.py
PYTEST_ARGS ?= -n auto --dist loadfile --no-loadscope-reorder
# Of the Python that is there: PyMC 5 on 3.11, PyMC 6 on later ones.
LOCK := $(shell $(or $(wildcard $(BIN)/python),$(PYTHON)) -c 'import sys; \
    print("requirements-py313.lock" if sys.version_info >= (3, 12) else "requirements.lock")')
NATIVE := native/build_ffi.py $(wildcard native/src/*.[ch] native/include/*.h)

.PHONY: setup test test-all test-nightly test-next test-some test-all-next native-test durations readme installed check fuzz nightly demo report docs bench reproduce mutants clean
setup: $(STAMP)

# Versions come from the lock file, those of the build tools too.
$(STAMP): pyproject.toml setup.py $(LOCK) src/zoo/__init__.py $(NATIVE)
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "zoo needs Python 3.11 or newer, this is " + sys.version)'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint $(LOCK) setuptools cffi
	$(BIN)/python -m pip install --quiet --constraint $(LOCK) --no-build-isolation --editable '.[dev]'
	@touch $@

native-test: setup
	$(MAKE) --no-print-directory -C native test

# C tests under sanitizers and the fast tier of tests/tiers.py: ten minutes on two cores.
test: native-test
	$(BIN)/pytest $(PYTEST_ARGS) -m "not slow" $(APART)

# Both tiers.
test-all: native-test
	$(BIN)/pytest $(PYTEST_ARGS) -m "not nightly" $(APART)

# What repeats a measurement that a cheaper test makes once.
test-nightly: setup
	$(BIN)/pytest $(PYTEST_ARGS) -m nightly $(APART)

# A Python of PyMC's later line, the last that is found. Candidates are run, since a shim without its Python is there
# too; 3.14, which is allowed and not claimed, if there is no other.
LATER = $(shell for one in python3.14 python3.13 python3.12 $${PYENV_ROOT:-$$HOME/.pyenv}/versions/3.1[23]*/bin/python3; do \
    "$$one" -c 'import ensurepip, sys, venv; sys.exit(sys.version_info < (3, 12))' 2>/dev/null && echo "$$one"; \
    done | tail -n 1)
ON_LATER = test -n "$(LATER)" || { echo "no Python 3.12 or later runs here, which PyMC 6 needs: install one" >&2; exit 1; }; \
    $(MAKE) --no-print-directory VENV=.venv-next PYTHON="$(LATER)"

# What differs between the lines of PyMC, a wheel, and the diagnosis that README.md ends with, on the later line.
NEXT := $(patsubst %,tests/test_%.py,lines op in_numba storage comparison packaging) \
    tests/test_models.py::test_log_posterior_is_that_of_the_model_written_out \
    tests/test_sampling.py::test_chains_in_turns_draw_what_processes_draw \
    tests/test_docs.py::test_the_simulator_of_the_readme_gives_what_the_readme_prints
test-next:
	@$(ON_LATER) test-some

test-some: setup
	$(BIN)/pytest $(PYTEST_ARGS) -m "not nightly" $(NEXT)

# Both tiers there.
test-all-next:
	@$(ON_LATER) test-all

# Both tiers, and how long each test took into tests/durations.json, which says what is slow and what is first.
durations: setup
	$(BIN)/pytest $(PYTEST_ARGS) --durations-file -m "not nightly" $(APART)

# What takes too long for each change.
nightly: readme installed report mutants test-nightly test-all-next
	@$(ON_LATER) readme installed test-nightly
	$(MAKE) --no-print-directory fuzz FUZZ_SECONDS=1200

# What README.md shows, as it stands, with the time of each block: five minutes on two cores.
readme: setup
	$(BIN)/pytest -n 0 -s -v tests/test_readme.py

# A wheel with its dependencies in an empty environment; three minutes of a processor, and an index of packages is needed.
installed: setup
	$(BIN)/pytest -n 0 tests/test_installed.py

check: setup
	$(BIN)/ruff check .
	$(BIN)/mypy src/zoo examples
	rm -rf build/imports
	$(BIN)/python setup.py -q build_py --build-lib build/imports
	cd build/imports && $(abspath $(BIN))/lint-imports --no-cache --no-logo --config $(CURDIR)/pyproject.toml

# Which small changes of the code no test notices: one at a time in a copy, by tests/mutants/mutants.toml.
JOBS ?= 1
mutants: setup
	$(BIN)/python tests/mutants/run.py --jobs $(JOBS) $(MUTANTS)

# Hostile arguments to the C entry points, then hostile studies and files to their readers: half of the time each.
FUZZ_SECONDS ?= 60
FUZZ_SEED ?= 1
FUZZ_HALF := $(shell expr $(FUZZ_SECONDS) / 2)

fuzz: setup
	$(MAKE) --no-print-directory -C native fuzz FUZZ_SECONDS=$(FUZZ_HALF) FUZZ_SEED=$(FUZZ_SEED)
	if test -f tests/fuzz/run.py; then $(BIN)/python tests/fuzz/run.py --seconds $(FUZZ_HALF) --seed $(FUZZ_SEED); fi

# The embedded study from waves to WAIC; results in demo-output/.
demo: setup
	mkdir -p demo-output
	$(BIN)/zoo simulate demo --stiffness 4e4 --psi1 0.3 --psi2 0.6 --c 1.7 -o demo-output/waves.nc
	$(BIN)/zoo sample A demo --seed 1 -o demo-output/A.nc
	$(BIN)/zoo sample B demo --seed 1 -o demo-output/B.nc
	$(BIN)/zoo compare demo --models A,B -o demo-output

# One page: demo with short chains, mouse-c6 with the stored posteriors.
REPORT := demo-output/report.html
SHORT := $(patsubst %,demo-output/short/%.nc,A B H)

report: $(REPORT)

.PHONY: $(REPORT)
$(REPORT): $(SHORT)
	$(BIN)/zoo report demo mouse-c6 --posteriors demo-output/short --posteriors notebooks/posteriors \
		--solves demo-output/solves -o $@

$(SHORT): demo-output/short/%.nc: $(STAMP)
	mkdir -p $(@D)
	$(BIN)/zoo sample $* demo --draws 150 --tune 300 --seed 1 --fresh -o $@

# The site, with the gallery executed, in build/site; warnings are errors. Three minutes of one core, and
# one minute when no script changed.
docs: $(VENV)/.zoo-docs
	$(BIN)/python -m sphinx -W -q -c docs . build/site
	@echo build/site/index.html

$(VENV)/.zoo-docs: $(STAMP)
	$(BIN)/python -m pip install --quiet --constraint $(LOCK) --no-build-isolation --editable '.[docs]'
	@touch $@

bench: setup
	$(BIN)/python -m benchmarks.bench_solver

# Tables 3, 4 and 5 of Paun et al. 2020 and the calibration into paun2020/; a killed run goes on.
reproduce: setup
	for what in table4 synthetic calibration; do $(BIN)/python -m benchmarks.paun2020 $$what || exit; done

clean:
	$(MAKE) --no-print-directory -C native clean
	rm -rf build dist pymc_zoo.egg-info src/pymc_zoo.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis $(STAMP) $(VENV)/.zoo-docs docs/generated
	rm -f src/zoo/_native*.so native/src/*.o
	find src models tests benchmarks -name __pycache__ -type d -exec rm -rf {} +
