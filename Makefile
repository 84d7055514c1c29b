# make demo            the dam break, from nothing to a picture; make demo ARGS="--spacing 0.01" passes options on
# make play            a tank of water and oil to play with in a browser
# make install         tipfem with all that it can use
# make help            the other targets
#
# All runs in .venv, which is made with $(PYTHON) when it is missing: make demo PYTHON=python3.12

PYTHON ?= python3
ARGS ?=
# Processes that run tests side by side. Those of one file stay together: they share what their fixtures made.
WORKERS ?= 2
VENV := .venv
RUN := $(VENV)/bin/python

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
# One environment serves all targets, and two pips must not write to it at once.
.NOTPARALLEL:
.PHONY: help demo play install test test-slow lint docs wheel clean

help:
	@echo "make demo       run demos/dam_break.py; options go in ARGS=\"...\""
	@echo "make play       a tank of water and oil to play with in a browser: prints the address"
	@echo "make install    tipfem with all extras in $(VENV): tables, the viewer, drawings, notebooks, clusters"
	@echo "make test       run the tests, without the slow ones, in two processes (WORKERS=2); pytest's options go in ARGS"
	@echo "make test-slow  run the slow tests"
	@echo "make lint       ruff, mypy, the layers of import-linter, codespell, and the style of docstrings and pages"
	@echo "make docs       build the documentation in build/site; warnings are errors"
	@echo "make wheel      build dist/tipfem-*.whl"
	@echo "make clean      remove what was built and the caches; keeps $(VENV) and results"

demo: $(VENV)/.installed-plot
	$(RUN) demos/dam_break.py $(ARGS)

play: $(VENV)/.installed-view
	$(RUN) demos/play.py $(ARGS)

install: $(VENV)/.installed-all

test: $(VENV)/.installed-plot,test
	$(RUN) -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder $(ARGS)

test-slow: $(VENV)/.installed-plot,test
	$(RUN) -m pytest -m slow -n $(WORKERS) --dist loadfile $(ARGS)

lint: $(VENV)/.installed-lint
	$(RUN) -m ruff check .
	$(RUN) -m ruff format --check .
	$(RUN) -m mypy tipfem render
	$(VENV)/bin/lint-imports
	$(VENV)/bin/codespell
	$(RUN) .ci/check_style.py

docs: $(VENV)/.installed-docs
	NO_MKDOCS_2_WARNING=1 $(RUN) -m mkdocs build --quiet --strict
	@echo "build/site/index.html; with search: $(RUN) -m http.server --directory build/site"

# The machine code of kernels, which wheels have for a quick first start.
CODE := tipfem/backend/kernels

# setuptools reuses build/, and would pack files that are gone from the tree.
wheel: $(VENV)/.installed-lint
	rm -rf build dist $(CODE)
	TI_OFFLINE_CACHE_FILE_PATH=build $(RUN) -m tipfem compile
	mv build/tipfem $(CODE)
	rm -rf build
	$(RUN) -m build --wheel

clean:
	rm -rf build dist $(CODE) *.egg-info .pytest_cache .mypy_cache .ruff_cache
	find . -path ./$(VENV) -prune -o -type d -name __pycache__ -exec rm -rf {} +

# $(call check_python,interpreter): stop with a plain sentence unless it is one that the package supports.
define check_python
@"$(1)" -c 'import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 13))' || { \
  echo "error: tipfem needs Python 3.10 to 3.13, and $(1) is: $$("$(1)" --version 2>&1 | tail -n 1)" >&2; \
  echo "error: name another one, for example: make $(firstword $(MAKECMDGOALS)) PYTHON=python3.12$(2)" >&2; \
  exit 1; }
endef

$(VENV)/pyvenv.cfg:
	$(call check_python,$(PYTHON))
	@"$(PYTHON)" -m venv $(VENV) || { rm -f $@; \
	  echo "error: $(PYTHON) cannot make a virtual environment (Debian and Ubuntu: install python3-venv)" >&2; \
	  exit 1; }

# One stamp a set of extras; an environment that has others, or that lacks pip, is completed. pip below 21.3 cannot
# install in place from a pyproject.toml.
$(VENV)/.installed-%: pyproject.toml $(VENV)/pyvenv.cfg
	$(call check_python,$(RUN), after removing $(VENV))
	@$(RUN) -m pip --version >/dev/null 2>&1 || $(RUN) -m ensurepip --upgrade >/dev/null
	@echo "Installing tipfem[$*] in $(VENV) (minutes the first time)"
	@$(RUN) -m pip install --quiet --disable-pip-version-check "pip>=21.3"
	@$(RUN) -m pip install --quiet --disable-pip-version-check --editable ".[$*]"
	@touch "$@"
