PYTHON ?= python3
BIN := .venv/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check

.PHONY: demo test test-slow notebooks docs check clean

demo: .venv/ready
	$(BIN)/sysid-trib identify --omega0 8.87

test: .venv/ready-dev
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -q -n auto --dist loadfile -m "not slow"

# Full searches, measured records, calibration over many seeds, pages in a browser.
test-slow: .venv/ready-dev
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -q -n auto --dist loadfile -m slow

notebooks: .venv/ready-notebooks
	$(BIN)/python notebooks/run.py

docs: .venv/ready-docs
	OMP_NUM_THREADS=1 $(BIN)/python -m sphinx -b html -W --keep-going -E -q docs build/docs
	@echo "Open build/docs/index.html"

check: .venv/ready-dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy

clean:
	rm -rf .venv .hypothesis .mypy_cache .pytest_cache .ruff_cache build dist
	find . -name __pycache__ -prune -exec rm -rf {} +

$(BIN)/pip:
	@$(PYTHON) -c 'import sys; sys.exit("Python 3.11 or newer is needed: make PYTHON=python3.12" if sys.version_info < (3, 11) else 0)'
	@$(PYTHON) -m venv .venv

.venv/ready: pyproject.toml | $(BIN)/pip
	@echo "Setting up .venv (a few minutes the first time) ..."
	@$(PIP) --editable .
	@touch $@

.venv/ready-dev: pyproject.toml | $(BIN)/pip
	@echo "Setting up .venv for tests (a few minutes the first time) ..."
	@$(PIP) --editable '.[dev]'
	@touch $@ .venv/ready

.venv/ready-notebooks: pyproject.toml | $(BIN)/pip
	@echo "Setting up .venv for the notebooks (a few minutes the first time) ..."
	@$(PIP) --editable '.[notebooks]'
	@touch $@ .venv/ready

.venv/ready-docs: pyproject.toml | $(BIN)/pip
	@echo "Setting up .venv for the documentation (a few minutes the first time) ..."
	@$(PIP) --editable '.[docs]'
	@touch $@ .venv/ready
