# Builds everything from Python 3.11 or newer with pip, make and git. `make` lists the targets.
# PYTHON=python3.12 selects another interpreter. LIMIT=../shared/limit adds the yardstick in that folder to `make bench`.
# PART="own force" measures only that part of the page. SHARD=1/3 runs the tests of the first third of the test files.

PYTHON ?= python3
UV := .tools/bin/uv
VENV := .venv
BIN := $(VENV)/bin

# Another environment must not leak into this one. Python keeps its compiled files.
unexport VIRTUAL_ENV PYTHONPATH PYTHONHOME PYTHONDONTWRITEBYTECODE
export UV_PYTHON_DOWNLOADS ?= automatic
ifdef PIP_INDEX_URL
export UV_DEFAULT_INDEX ?= $(PIP_INDEX_URL)
endif
# uv uses the certificates of the machine, like pip, if there are any.
ifneq ($(wildcard /etc/ssl/certs/*),)
export UV_SYSTEM_CERTS ?= true
endif
# Without a writable home folder the caches are in this folder.
ifneq ($(shell test -n "$$HOME" && test -w "$$HOME" && echo yes),yes)
export UV_CACHE_DIR ?= $(CURDIR)/.tools/cache
export MPLCONFIGDIR ?= $(CURDIR)/.tools/matplotlib
endif

INSTALL := $(UV) pip install --quiet --python $(BIN)/python
LOCKED := --require-hashes --no-build
# Two workers: most of the time of a test is compilation, which uses one core.
# COVERAGE=1 counts the lines that run, in all that runs since `make clean`; SHARD=1/3 runs a third of the tests.
PYTEST := $(if $(COVERAGE),COVERAGE=1 )$(BIN)/python -m pytest -n 2 --dist worksteal
SHARDED = $(if $(SHARD),$$($(BIN)/python -m tests.shard $(SHARD)))
THIS := $(INSTALL) --no-deps --no-build-isolation --editable .
COMPILE := $(UV) pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-annotate \
	--no-emit-index-url --no-emit-find-links --custom-compile-command "make lock"

.PHONY: help run paper test test-ci uncovered release-tests test-browser mutate bench reliability notebooks docs format lock clean
.DELETE_ON_ERROR:

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## /make \1\t/p' Makefile | expand -t 20

run: $(VENV)/.run ## compute figure 4 and its attractors into out/
	$(BIN)/jaxvibro run scenes/fig4.toml --out out --force

paper: $(VENV)/.run ## recompute the paper's figures and check its claims, into out/paper/
	$(BIN)/jaxvibro paper --out out/paper

test: $(VENV)/.dev ## run the linter, the type checker and the tests that take seconds; DRAWS=1000 PROPERTIES=maps: draws
ifdef DRAWS
	$(PYTEST) tests/properties/$(if $(PROPERTIES),test_$(PROPERTIES).py) --draws $(DRAWS)
else
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(PYTEST) --tier push $(SHARDED)
endif

test-ci: $(VENV)/.dev ## run what CI adds: tests that take minutes in all, and more draws of the properties
	$(PYTEST) --tier ci $(SHARDED)

uncovered: $(VENV)/.dev ## print the lines that no test has run, after `make test test-ci COVERAGE=1`
	-$(BIN)/python -m coverage combine --append --quiet  # nothing new since the last call is no error
	$(BIN)/python -m coverage report --show-missing --fail-under=95

release-tests: $(VENV)/.dev ## run what a release adds, into out/release/; goes on where it was stopped
	$(BIN)/python -m tests.release out/release

test-browser: $(VENV)/.dev ## test the explorer in a headless Chromium
	$(BIN)/python -m pytest -m browser tests/browser

mutate: $(VENV)/.dev ## break the code in one place at a time and check that a fast test fails
	$(BIN)/python -m tests.mutate

bench: $(VENV)/.dev ## measure costs of jaxvibro and of other programs, into docs/benchmarks.md
	$(BIN)/python -m benchmarks.run $(if $(LIMIT),--limit "$(LIMIT)") $(if $(PART),--part "$(PART)")

reliability: $(VENV)/.dev ## measure failure rates of jaxvibro and of other programs, into docs/reliability.md
	$(BIN)/python -m reliability.run $(if $(PART),--part "$(PART)")

notebooks: $(VENV)/.dev ## run the notebooks, store their output for the site and write them as .ipynb
	for script in notebooks/*.py; do $(BIN)/python -m docs.site.notebooks "$$script" || exit 1; done
	$(BIN)/jupytext --quiet --to ipynb notebooks/*.py

docs: $(VENV)/.dev ## build the site into out/docs/html, without a network
	rm -rf out/docs
	$(BIN)/python -m docs.site.pages out/docs/pages
	$(BIN)/python -m sphinx --fail-on-warning --keep-going --quiet -c docs/site -d out/docs/doctrees \
		out/docs/pages out/docs/html
	@echo "the site: out/docs/html/index.html"

format: $(VENV)/.dev ## format the source
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

lock: $(UV) ## resolve the dependencies again, with hashes for every platform
	$(COMPILE) --upgrade pyproject.toml --group build --output-file requirements.lock
	$(COMPILE) --upgrade pyproject.toml --group build --group dev --group docs --constraints requirements.lock \
		--output-file requirements-dev.lock
	echo "uv==$$($(UV) --version | cut -d' ' -f2)" | $(COMPILE) - --output-file requirements-uv.lock

clean: ## remove everything that make created, results included
	rm -rf $(VENV) .tools out .coverage* .pytest_cache .ruff_cache .mypy_cache .hypothesis

$(UV): requirements-uv.lock
	@echo "fetching uv into .tools"
	PIP_USER=0 PIP_REQUIRE_VIRTUALENV=0 $(PYTHON) -m pip install --quiet --disable-pip-version-check --upgrade \
		--target .tools --require-hashes --requirement requirements-uv.lock
	@touch $@

$(BIN)/python: | $(UV)
	interpreter=$$($(PYTHON) -c 'import sys; fits = (3, 11) <= sys.version_info < (3, 14); \
		print(sys.executable if fits else ">=3.11,<3.14")') && \
	$(UV) venv --quiet --clear --python "$$interpreter" $(VENV)

$(VENV)/.run: requirements.lock pyproject.toml | $(BIN)/python
	@echo "installing the run dependencies into $(VENV)"
	$(INSTALL) $(LOCKED) --requirement requirements.lock
	$(THIS)
	@touch $@

# requirements-dev.lock includes requirements.lock, hence both stamps.
$(VENV)/.dev: requirements-dev.lock pyproject.toml | $(BIN)/python
	@echo "installing the development dependencies into $(VENV)"
	$(INSTALL) $(LOCKED) --requirement requirements-dev.lock
	$(THIS)
	@touch $(VENV)/.run $@
