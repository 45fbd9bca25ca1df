# Type `make` for the list of targets. Each one sets up .venv first where that is still to do.
# Another interpreter: make setup PYTHON=python3.12

PYTHON ?= python3
JOBS ?= 2
BIN := .venv/bin
READY := .venv/.ready
ROOMS ?= some
NOTEBOOKS := $(wildcard notebooks/*.ipynb)

.DEFAULT_GOAL := help
.PHONY: help setup reproduce test test-browser check lint format ledger bench bench-rooms rooms book course clean

help:  ## this list
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  make \1|\2/p' Makefile | column -t -s '|' 2>/dev/null \
		|| sed -n 's/^\([a-z-]*\):.*## \(.*\)/  make \1: \2/p' Makefile

setup: $(READY)  ## create .venv with the exact versions of requirements.lock

$(READY): requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "occlib needs Python 3.11 or newer: make setup PYTHON=python3.11")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --disable-pip-version-check --quiet -r requirements.lock
	$(BIN)/python -m pip install --disable-pip-version-check --quiet --no-deps --no-build-isolation -e .
	@touch $@

reproduce: $(READY)  ## run the notebooks that changed: figures and metrics.csv in figures/
	$(BIN)/occlib reproduce --jobs $(JOBS)

test: lint  ## lint, then all tests, as many at a time as JOBS says
	$(BIN)/python -m pytest -n $(JOBS)

check: lint  ## lint, then the tests that are not slow: within a minute, for daily use
	$(BIN)/python -m pytest -n $(JOBS) -m 'not slow'

test-browser: $(READY)  ## the explorable, the book and JupyterLab in Chromium, after make book
	@test -f docs/_build/html/index.html || { echo 'test-browser: there is no book; first: make book'; exit 1; }
	OCCLIB_BROWSER=1 $(BIN)/python -m pytest tests/browser

lint: $(READY)  ## ruff, mypy, who imports whom, spelling, and no outputs stored in notebooks
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo --no-cache
	$(BIN)/codespell
	$(if $(NOTEBOOKS),$(BIN)/nbstripout --keep-id --verify $(NOTEBOOKS))

format: $(READY)  ## format the code and strip the notebooks
	$(BIN)/ruff check --fix
	$(BIN)/ruff format
	$(if $(NOTEBOOKS),$(BIN)/nbstripout --keep-id $(NOTEBOOKS))

ledger: $(READY)  ## write the tables of the paper's verdicts in README and docs from docs/claims.yaml and metrics.csv
	@$(BIN)/python -m occlib.course --ledger

bench: $(READY)  ## cost of the pipeline, of the matching measures and of the broadcast
	$(BIN)/python tests/bench_pipeline.py
	$(BIN)/python tests/bench_matching.py
	$(BIN)/python tests/bench_broadcast.py

bench-rooms: $(READY)  ## every profile on every room and real recording at hand: what has changed, and docs/rooms.md
	$(BIN)/python -m occlib.study.rooms --jobs $(JOBS)

rooms: $(READY)  ## render random rooms to the cache: ten of those that are reported; ROOMS=all for the 60 of both lists
	$(BIN)/python -m occlib.lab $(ROOMS)

book: $(READY)  ## make the book from the results of make reproduce, in docs/_build/html
	@$(BIN)/python -m occlib.course.book
	@echo 'Open  docs/_build/html/index.html'

course: $(READY)  ## make the student copies, without solutions, in course/; a copy with work in it is kept
	@$(BIN)/python -m occlib.course
	@echo 'Open the chapters:  $(BIN)/jupyter lab notebooks      the student copies:  $(BIN)/jupyter lab course'

clean:  ## remove .venv, runs and caches; figures/ and course/ stay
	rm -rf .venv runs .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
