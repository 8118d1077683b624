# `make compare` runs the whole job, `make check` the quick tests, `make test` all of a day. All set up .venv first.
PYTHON ?= python3
BIN := .venv/bin
STAMP := .venv/.complete
PYTEST := SYSID_EVO_CACHE=$(CURDIR)/.venv/kernels $(BIN)/pytest
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
# Every process imports the packages: compiled once, wherever the environment says otherwise.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: setup compare check test nightly unit suite lint docs pictures clean

setup: $(STAMP)

# Entry points are read at installation, so a change of either file builds .venv anew.
$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "sysid-evo needs Python 3.11 or newer; name it with make PYTHON=python3.11"; exit 1; }
	rm -rf .venv
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[all,dev,docs]'
	touch $@

compare: setup
	$(BIN)/sysid-evo compare

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# Lint, layers and types, beside the unit tests: after every step.
check: setup
	$(MAKE) --no-print-directory -j 2 lint unit

# Lint, layers and types, beside all tests of a day: before every commit.
test: setup
	$(MAKE) --no-print-directory -j 2 lint suite

# Also what takes long, the benchmarks, and lines changed by chance.
nightly: setup
	$(PYTEST) -n 3 --nightly
	$(PYTEST) -n 2 --nightly tests/benchmarks
	$(BIN)/python -m tests.mutate --nightly

unit: setup
	$(PYTEST) -n 2 tests/unit

# Three workers for two processors, since some tests wait.
suite: setup
	$(PYTEST) -n 3

# The pages of docs/ as a site in build/site; a broken link or name is an error.
docs: setup
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet
	@echo "build/site/index.html; its search needs a server: python3 -m http.server -d build/site"

# The pictures of the README and of the tutorials, by commands: some minutes a page.
pictures: setup
	$(BIN)/python -m tests.docs.pictures

clean:
	rm -rf .venv build dist .mypy_cache .pytest_cache .ruff_cache .hypothesis .import_linter_cache
