# Everything from a bare machine: Python 3.11 or newer with pip, make, git. `make` lists what there is.
# PYTHON=python3.12 takes another interpreter; LIMIT=../shared/limit adds the yardstick kept there to `make bench`,
# PART="own force" measures that part of its page alone.

PYTHON ?= python3
UV := .tools/bin/uv
VENV := .venv
BIN := $(VENV)/bin

# Another environment must not leak into this one, and what Python compiles is kept.
unexport VIRTUAL_ENV PYTHONPATH PYTHONHOME PYTHONDONTWRITEBYTECODE
export UV_PYTHON_DOWNLOADS ?= automatic
ifdef PIP_INDEX_URL
export UV_DEFAULT_INDEX ?= $(PIP_INDEX_URL)
endif
# uv asks for no certificates of its own where the machine has some: what pip trusts, it trusts.
ifneq ($(wildcard /etc/ssl/certs/*),)
export UV_SYSTEM_CERTS ?= true
endif
# Without a home to write to, caches stay in here.
ifneq ($(shell test -n "$$HOME" && test -w "$$HOME" && echo yes),yes)
export UV_CACHE_DIR ?= $(CURDIR)/.tools/cache
export MPLCONFIGDIR ?= $(CURDIR)/.tools/matplotlib
endif

INSTALL := $(UV) pip install --quiet --python $(BIN)/python
LOCKED := --require-hashes --no-build
# Two at a time: most of a test is compiling, on one core.
PYTEST := $(BIN)/python -m pytest -n 2 --dist worksteal
THIS := $(INSTALL) --no-deps --no-build-isolation --editable .
COMPILE := $(UV) pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-annotate \
	--no-emit-index-url --no-emit-find-links --custom-compile-command "make lock"

.PHONY: help run paper test test-slow test-long test-browser mutate bench reliability notebooks docs format lock clean
.DELETE_ON_ERROR:

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## /make \1\t/p' Makefile | expand -t 20

run: $(VENV)/.run ## compute figure 4 and its attractors into out/
	$(BIN)/jaxvibro run scenes/fig4.toml --out out --force

paper: $(VENV)/.run ## recompute the paper's figures and judge its claims, into out/paper/
	$(BIN)/jaxvibro paper --out out/paper

test: $(VENV)/.dev ## lint, types and the tests that take seconds
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(PYTEST) -m "not slow and not long and not browser"

test-slow: $(VENV)/.dev ## the tests that take minutes
	$(PYTEST) -m "(slow and not long and not browser) or smoke"

test-long: $(VENV)/.dev ## what takes minutes a test
	$(PYTEST) -m "long and not browser"

test-browser: $(VENV)/.dev ## the explorer in a real headless Chromium
	$(BIN)/python -m pytest -m browser tests/browser

mutate: $(VENV)/.dev ## break guards one by one, each against a fast test that ought to notice
	$(BIN)/python -m tests.mutate

bench: $(VENV)/.dev ## what answers cost, ours and others', into docs/benchmarks.md
	$(BIN)/python -m benchmarks.run $(if $(LIMIT),--limit "$(LIMIT)") $(if $(PART),--part "$(PART)")

reliability: $(VENV)/.dev ## where methods fail, ours and others', into docs/reliability.md
	$(BIN)/python -m reliability.run $(if $(PART),--part "$(PART)")

notebooks: $(VENV)/.dev ## run the notebooks, keep what they print and draw for the site, write them as .ipynb
	for script in notebooks/*.py; do $(BIN)/python -m docs.site.notebooks "$$script" || exit 1; done
	$(BIN)/jupytext --quiet --to ipynb notebooks/*.py

docs: $(VENV)/.dev ## build the site into out/docs/html, without a network
	rm -rf out/docs
	$(BIN)/python -m docs.site.pages out/docs/pages
	$(BIN)/python -m sphinx --fail-on-warning --keep-going --quiet -c docs/site -d out/docs/doctrees \
		out/docs/pages out/docs/html
	@echo "the site: out/docs/html/index.html"

format: $(VENV)/.dev ## put the source into its standard form
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

lock: $(UV) ## resolve the dependencies anew, hashes for every platform
	$(COMPILE) --upgrade pyproject.toml --group build --output-file requirements.lock
	$(COMPILE) --upgrade pyproject.toml --group build --group dev --group docs --constraints requirements.lock \
		--output-file requirements-dev.lock
	echo "uv==$$($(UV) --version | cut -d' ' -f2)" | $(COMPILE) - --output-file requirements-uv.lock

clean: ## remove all that make made, results included
	rm -rf $(VENV) .tools out .pytest_cache .ruff_cache .mypy_cache .hypothesis

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
	@echo "installing what a run needs into $(VENV)"
	$(INSTALL) $(LOCKED) --requirement requirements.lock
	$(THIS)
	@touch $@

# Holds all of requirements.lock as well, hence both stamps.
$(VENV)/.dev: requirements-dev.lock pyproject.toml | $(BIN)/python
	@echo "installing what the tests need into $(VENV)"
	$(INSTALL) $(LOCKED) --requirement requirements-dev.lock
	$(THIS)
	@touch $(VENV)/.run $@
