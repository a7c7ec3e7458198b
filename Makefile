# `make demo` and `make test` need Python 3.11-3.13 with venv, git and make; the rest they install.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
SETUP := pyproject.toml constraints.txt

.PHONY: demo test lint types clean

demo: $(VENV)/.demo
	$(BIN)/adafusion demo runs/demo

test: $(VENV)/.dev
	$(BIN)/pytest -n 2 --dist worksteal $(ARGS)

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.dev
	$(BIN)/mypy

# Editable and in one environment, so that a developer's checkout and a newcomer's are the same.
$(VENV)/.demo: $(SETUP) | $(VENV)/.venv
	@echo "installing what the demo needs: minutes the first time, nothing later"
	$(BIN)/pip install --progress-bar on -c constraints.txt -e ".[map,report]"
	@touch $@

$(VENV)/.dev: $(SETUP) | $(VENV)/.venv
	@echo "installing what tests need: minutes the first time, nothing later"
	$(BIN)/pip install --progress-bar on -c constraints.txt -e ".[dev]"
	@touch $@ $(VENV)/.demo

$(VENV)/.venv:
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))' || \
		{ echo "need Python 3.11, 3.12 or 3.13: make PYTHON=/path/to/python3.12 ..."; exit 2; }
	$(PYTHON) -m venv $(VENV)
	@touch $@

clean:
	rm -rf $(VENV) runs .mypy_cache .ruff_cache
