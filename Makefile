# make demo    install into .venv and run the whole job on the recording that ships with the package
# make test    install into .venv and run the tests, but for those that take longest
# make long    run those: pages, whole recordings, runs that are killed
# Both need Python 3.11 or newer and make, and nothing else. The rest: make lint examples verdicts docs bench wheel minimum clean

PYTHON := $(or $(PYTHON),$(shell for p in python3 python3.13 python3.12 python3.11; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p && break; done))
BIN := .venv/bin
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint .ci/constraints.txt
CORE := $(addprefix tests/test_,$(addsuffix .py,scene recording orbit orbit_vectors attitude shape brdf brdf_energy brdf_gradients brdf_module rough_surfaces model model_equations fit output cli))
export OMP_NUM_THREADS ?= 1

.PHONY: demo test long lint format examples verdicts docs bench wheel minimum clean

demo: .venv/demo
	$(BIN)/torchlc demo

test: .venv/develop
	$(BIN)/python -m pytest -m "not long" --numprocesses 2 --dist worksteal

long: .venv/develop
	$(BIN)/python -m pytest -m long --numprocesses 2 --dist worksteal

lint: .venv/develop
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

format: .venv/develop
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

examples: .venv/develop
	@set -e; for script in examples/*.py examples/fleets examples/paper; do echo "$$script" && $(BIN)/python "$$script" out; done

verdicts: .venv/develop
	$(BIN)/python examples/calibration/make_injections.py out/cases --seed 7 --subset
	rm -f out/verdicts.jsonl
	$(BIN)/python examples/calibration/verdicts.py out/cases out/verdicts.jsonl --least 0.85

docs: .venv/develop
	$(BIN)/sphinx-build -W --keep-going -q -j 2 docs docs/_build/html

bench: .venv/bench
	$(BIN)/python -m benchmarks $(SECTIONS)

wheel: .venv/develop
	$(BIN)/python -m build --quiet --wheel --outdir dist
	rm -rf build .venv-wheel && $(PYTHON) -m venv .venv-wheel
	.venv-wheel/bin/pip install --quiet --constraint .ci/constraints.txt dist/torchlc-*.whl
	cd "$$(mktemp -d)" && $(CURDIR)/.venv-wheel/bin/torchlc --version && $(CURDIR)/.venv-wheel/bin/torchlc demo --quiet

minimum: .ci/constraints-minimum.txt
	rm -rf .venv-minimum && $(PYTHON) -m venv .venv-minimum
	.venv-minimum/bin/pip install --quiet --constraint .ci/constraints-minimum.txt --editable '.[mesh,dask,report,test]'
	.venv-minimum/bin/python -m pytest -m "not long" --numprocesses 2 -W default $(CORE)

clean:
	rm -rf build dist docs/_build .venv .venv-wheel .venv-minimum .pytest_cache .ruff_cache .hypothesis

.venv/bin/python:
	@test -n "$(PYTHON)" || { echo "torchlc needs Python 3.11 or newer: set PYTHON=/path/to/python"; exit 1; }
	$(PYTHON) -m venv .venv

.venv/demo: .venv/bin/python pyproject.toml .ci/constraints.txt
	$(INSTALL) --editable '.[mesh,report]'
	touch $@

.venv/develop: .venv/bin/python pyproject.toml .ci/constraints.txt
	$(INSTALL) --editable '.[mesh,dask,report,docs,test,dev]'
	touch $@

.venv/bench: .venv/develop
	$(INSTALL) --editable '.[bench]'
	touch $@
