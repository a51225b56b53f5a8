PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/$(if $(filter Windows_NT,$(OS)),Scripts,bin)
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check
PYTEST := OMP_NUM_THREADS=1 $(BIN)/python -m pytest -q -n auto --dist loadfile $(WARNINGS)

.PHONY: demo test test-slow test-in-full test-lowest coverage notebooks docs links paper check clean

demo: $(VENV)/ready
	$(BIN)/sysid-trib identify --omega0 8.87 --quiet

test: $(VENV)/ready-dev
	$(PYTEST) -m "not slow and not in_full"

# Full searches, measured records, pages in a browser.
test-slow: $(VENV)/ready-dev
	$(PYTEST) -m "slow and not in_full"

# Statistics over many seeds, further draws of what generators write: before a release, no part of .ci/run.
test-in-full: $(VENV)/ready-dev
	$(PYTEST) -m in_full

# With the lowest version of each dependency that pyproject.toml allows. That they call what other packages have
# deprecated since is theirs to mend.
test-lowest:
	$(MAKE) VENV=.venv-lowest CONSTRAINTS=build/lowest.txt WARNINGS='-W ignore::DeprecationWarning' test

coverage: $(VENV)/ready-dev
	$(PYTEST) --cov --cov-report=term-missing:skip-covered --cov-fail-under=95

notebooks: $(VENV)/ready-notebooks
	$(BIN)/python notebooks/run.py

# Executes the notebooks, with shorter runs; what has not changed since is not executed again.
docs: $(VENV)/ready-docs
	@rm -rf build/docs
	OMP_NUM_THREADS=1 $(BIN)/python -m sphinx -b html -W --keep-going -E -q docs build/docs
	$(BIN)/python docs/check_pages.py build/docs
	@echo "Open build/docs/index.html"

# Links to other sites: needs a network. Dead links between pages fail `make docs`.
links: $(VENV)/ready-docs
	$(BIN)/python -m sphinx -b linkcheck -D nb_execution_mode=off -D suppress_warnings=myst-nb.lexer -E -q docs build/links

# The paper as a page; an unknown citation is an error.
paper:
	@command -v pandoc >/dev/null || { echo "pandoc is needed: install it, for example with apt-get install pandoc"; exit 1; }
	@mkdir -p build
	pandoc paper/paper.md --resource-path=paper --citeproc --mathml --standalone --fail-if-warnings -o build/paper.html
	@echo "Open build/paper.html"

check: $(VENV)/ready-dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy

clean:
	rm -rf .venv .venv-lowest .hypothesis .mypy_cache .pytest_cache .ruff_cache .coverage .coverage.* build dist docs/notebooks
	find . -name __pycache__ -prune -exec rm -rf {} +

$(VENV)/pyvenv.cfg:
	@$(PYTHON) -c 'import sys; sys.exit("Python 3.11 or newer is needed: make PYTHON=python3.12" if sys.version_info < (3, 11) else 0)'
	@$(PYTHON) -m venv $(VENV)

build/lowest.txt: pyproject.toml .ci/lowest.py
	@mkdir -p build
	@$(PYTHON) .ci/lowest.py > $@

$(VENV)/ready: pyproject.toml | $(VENV)/pyvenv.cfg
	@echo "Setting up $(VENV) (a few minutes the first time) ..."
	@$(PIP) --editable .
	@touch $@

$(VENV)/ready-dev: pyproject.toml $(CONSTRAINTS) | $(VENV)/pyvenv.cfg
	@echo "Setting up $(VENV) for tests (a few minutes the first time) ..."
	@$(PIP) --editable '.[dev]' $(addprefix --constraint ,$(CONSTRAINTS))
	@touch $@ $(VENV)/ready

$(VENV)/ready-notebooks: pyproject.toml | $(VENV)/pyvenv.cfg
	@echo "Setting up $(VENV) for the notebooks (a few minutes the first time) ..."
	@$(PIP) --editable '.[notebooks]'
	@touch $@ $(VENV)/ready

$(VENV)/ready-docs: pyproject.toml | $(VENV)/pyvenv.cfg
	@echo "Setting up $(VENV) for the documentation (a few minutes the first time) ..."
	@$(PIP) --editable '.[docs]'
	@touch $@ $(VENV)/ready
