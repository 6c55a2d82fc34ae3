# make demo    set up, reconstruct a small made-up room with two sensors, and say where the report is
# make test    set up and run the tests in WORKERS processes of one thread each
# make check   set up and check what needs no run: lint, types, spelling, links, generated pages, unused code
# make fuzz    try damaged inputs on every parser and command for MINUTES
# make docs    write the generated pages of docs/
#
# On Linux pip fetches a PyTorch with GPU libraries (several GB). A smaller one can be chosen by its index:
# make demo TORCH_INDEX=<address of the index of CPU builds>

PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV ?= .venv
TORCH_INDEX ?=
DEMO ?= demo
MINUTES ?= 10
WORKERS ?= 2
FUZZ ?= fuzz-out

BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check install --quiet -c constraints.txt
STAMP := $(VENV)/.installed

.PHONY: demo test test-slow fuzz check lint types spelling links generated unused docs system
.DEFAULT_GOAL := test

demo: $(STAMP)
	$(BIN)/uncle demo --out $(DEMO)
	@echo "The report: $$(find $(DEMO) -name report.html | head -1)"

test: $(STAMP)
	OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1 $(BIN)/python -m pytest -n $(WORKERS) --dist loadfile

test-slow: $(STAMP)
	$(BIN)/python -m pytest -m slow

fuzz: $(STAMP)
	$(BIN)/python benchmarks/fuzz.py --minutes $(MINUTES) --out $(FUZZ)

check: lint types spelling links generated unused

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

# The folders are installed as uncle.recon, uncle.cli and uncle.datasets. mypy does not follow the import hook of an
# editable install, so that it is given a folder `uncle` with links to them (mypy_path in pyproject.toml).
types: $(STAMP)
	@mkdir -p build/types/uncle
	@for folder in recon cli datasets; do ln -sfn ../../../$$folder build/types/uncle/$$folder; done
	$(BIN)/mypy

spelling: $(STAMP)
	$(BIN)/codespell

links: $(STAMP)
	$(BIN)/python docs/check_links.py

generated: $(STAMP)
	$(BIN)/python docs/generate_cli.py --check
	$(BIN)/python docs/generate_config.py --check

unused: $(STAMP)
	$(BIN)/vulture

docs: $(STAMP)
	$(BIN)/python docs/generate_cli.py
	$(BIN)/python docs/generate_config.py

# The machine is asked first, because a missing library would show much later and say much less.
system:
	@test -n "$(PYTHON)" || { echo "no Python found; install it with: sudo apt-get install -y python3 python3-venv" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "$$($(PYTHON) --version) is too old, 3.11 is needed; name another one: make PYTHON=/path/to/python3.11" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || \
	  { echo "Python's venv is missing; install it with: sudo apt-get install -y $$(basename $(PYTHON))-venv" >&2; exit 1; }
	@$(PYTHON) -I recon/core/system_check.py

$(STAMP): pyproject.toml constraints.txt | system
	@echo 'Setting up $(VENV); the first time takes a few minutes.'
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@$(PIP) $(if $(TORCH_INDEX),--extra-index-url $(TORCH_INDEX)) torch
	@$(PIP) -e '.[dev]'
	@touch $@
