# Two commands matter: `make reproduce` and `make test`. Both set up .venv first; a second call costs nothing.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
DEV := $(VENV)/.dev
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile
RESULTS ?= results
STUDY := $(RESULTS)/cong2008
SOURCES := core calibration problems optimizers discrepancy bench
PYTEST_WORKERS ?= 2
# one thread of BLAS, as `bench` has it: sums in another order end some searches elsewhere
export OPENBLAS_NUM_THREADS ?= 1
export OMP_NUM_THREADS ?= 1
export MKL_NUM_THREADS ?= 1
# of `make reference`; a small rehearsal: make reference BUDGET=800 SEEDS=1 RESULTS=results/small REFERENCE=results/small/kept
BUDGET ?= paper
SEEDS ?= paper
REFERENCE ?= results/reference

.PHONY: dist docs peers venv reproduce reference test lint types bench slow clean

venv: $(READY) $(DEV)

# bytecode is not made of all that is installed, which takes as long as all else: Python makes it of what it imports
$(READY): requirements.lock pyproject.toml CITATION.cff
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "Python >= 3.11 is needed, $(PYTHON) is $$($(PYTHON) -V 2>&1); try: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 2; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(INSTALL) --require-hashes -r requirements.lock
	$(INSTALL) --no-deps --no-build-isolation -e .
	@touch $@

# the tools; a first run compiles kernels beside their installation
$(DEV): requirements-dev.lock $(READY)
	@$(BIN)/bench run problem=sensor_zero optimizer=de budget=2000 seeds=1 results=$(VENV)/first >$(VENV)/first.log 2>&1 & \
		$(INSTALL) --require-hashes --no-deps -r requirements-dev.lock; ended=$$?; wait; exit $$ended
	@touch $@

reproduce: $(READY)  ## both papers' problems at the reduced budget: Parquet, tables, figures, ledger
	$(BIN)/bench run study=cong2008 budget=ci seeds=ci execution=processes results=$(RESULTS)
	$(BIN)/bench run study=pashkevich2008 budget=ci seeds=ci execution=processes results=$(RESULTS)
	$(BIN)/bench report $(STUDY)
	$(BIN)/bench report $(RESULTS)/pashkevich2008
	$(BIN)/bench paper --budget ci results=$(RESULTS)
	@echo; echo "Read, in a browser, offline:"
	@for page in cong2008/report.html pashkevich2008/report.html paper/ledger.html; do echo "  $(RESULTS)/$$page"; done

reference: $(READY)  ## both papers at their own budget, some 40 CPU minutes; a stopped one goes on; what is kept of it is small
	$(BIN)/bench run study=cong2008 budget=$(BUDGET) seeds=$(SEEDS) execution=processes results=$(RESULTS)
	$(BIN)/bench run study=pashkevich2008 budget=$(BUDGET) seeds=$(SEEDS) execution=processes results=$(RESULTS)
	$(BIN)/bench paper budget=$(BUDGET) seeds=$(SEEDS) results=$(RESULTS) to=$(REFERENCE)

test: venv lint types
	$(BIN)/python -m pytest -n $(PYTEST_WORKERS) --dist loadfile -m "not slow"

lint: venv
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

types: venv
	$(BIN)/mypy

slow: venv  ## the long laws: budget 1000 over the registry, 100 random starts, DE to 1e-18
	$(BIN)/python -m pytest -n $(PYTEST_WORKERS) --dist loadfile -m slow

bench: venv  ## timings, never asserted in the tests, ours and those of peers: results/benchmarks/, docs/benchmarks.md, docs/peers-measured.md
	$(BIN)/python -m benchmarks
	$(BIN)/python -m benchmarks peers

docs: venv  ## the documentation as a site that opens as files, offline: site/index.html; any warning is an error
	@$(BIN)/python -c 'import material, mkdocstrings' 2>/dev/null \
		|| $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-build-isolation -e '.[docs]'
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet --strict
	@echo "Read, in a browser, offline: site/index.html"

PEERS := $(RESULTS)/peers
PEER_CASES ?= 30000:30100

peers: venv  ## STLSQ, FROLS and a Gaussian process on the same blind cases, in an environment of their own
	@test -x $(PEERS)/venv/bin/python || $(PYTHON) -m venv $(PEERS)/venv
	$(PEERS)/venv/bin/python -m pip install --quiet --disable-pip-version-check -r benchmarks/peers/requirements.txt
	rm -rf $(PEERS)/cases $(PEERS)/sealed $(PEERS)/rows
	$(BIN)/python -m benchmarks.blind.write --seeds $(PEER_CASES) --to $(PEERS)/cases --sealed $(PEERS)/sealed
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m benchmarks.peers.export $(PEERS)/cases --to $(PEERS)/rows
	OPENBLAS_NUM_THREADS=1 $(PEERS)/venv/bin/python benchmarks/peers/rivals.py $(PEERS)/rows --to $(PEERS)/rows/rivals.jsonl
	$(BIN)/python -m benchmarks.peers.table $(PEERS)/rows --sealed $(PEERS)/sealed \
		--versions "$$($(PEERS)/venv/bin/python -m pip list --disable-pip-version-check 2>/dev/null \
			| grep -E '^(pysindy|scikit-learn|sysidentpy) ' | tr -s ' ' | paste -sd, | sed 's/,/, /g')"

INDEX ?= build/index

dist: venv  ## sdist, wheel, list of parts in dist/; tried by PYTHONS="python3.11 python3.14", from an index in the folder INDEX
	$(BIN)/python .ci/dist.py --index $(INDEX) $(if $(PYTHONS),--pythons $(PYTHONS))

clean:
	rm -rf $(VENV) build dist site .mypy_cache .pytest_cache .ruff_cache .import_linter_cache .hypothesis
