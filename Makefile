# Everything runs in .venv, set up on first use with the versions of constraints.txt. A target that
# needs more than the package itself depends on the stamp of an extra of pyproject.toml.
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
PYTEST := $(BIN)/python -m pytest -n auto -q
SEED := $(shell od -An -N4 -tu4 /dev/urandom | tr -d ' ')
PIP := $(BIN)/python -m pip --quiet --disable-pip-version-check

.PHONY: help reproduce animate notebooks pictures docs bench bench-against bench-fleet bench-world bench-flight bench-scale bench-open bench-map bench-time bench-mixed bench-objective bench-online bench-clients bench-show bench-bound test test-all lint format clean
.DEFAULT_GOAL := help

help: ## This list
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## /\1\t/' | expand -t 14

reproduce: $(READY) ## Run the paper's four examples, draw Figs 3 to 18, check its claims
	$(BIN)/drake-rho reproduce --figures figures

animate: $(READY) ## Show Example 4 in the browser
	$(BIN)/drake-rho show paper

notebooks: $(VENV)/.notebooks ## Open the notebooks in JupyterLab
	$(BIN)/jupyter lab notebooks

pictures: $(VENV)/.test ## Take the README's pictures of the swarm anew, still and moving (needs Chromium)
	@sh tools/setup-browser $(VENV)
	$(BIN)/python -m tests.screenshot figures

docs: $(VENV)/.docs ## Build the documentation into site/, and check its links (open site/index.html)
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet
	$(BIN)/python -m tools.site.links site

bench: $(VENV)/.bench .venv-openscvx/.ready ## Time it against others, and its growth (an hour, benchmarks/results)
	$(BIN)/python -m benchmarks

bench-against: $(VENV)/.bench ## Time it against an earlier version: COMMIT=48057a9; MISSIONS as for maps
	$(BIN)/python -m benchmarks against $(if $(COMMIT),--against "$(COMMIT)") $(if $(MISSIONS),--missions "$(MISSIONS)")

bench-fleet: $(VENV)/.bench ## The same for fleets (forty minutes); MISSIONS=folder of the LSC planner's
	$(BIN)/python -m benchmarks --fleets $(if $(MISSIONS),--missions "$(MISSIONS)")

bench-world: $(VENV)/.bench ## The same for worlds (an hour); WORLDS=folder of the LSC-DR planner's
	$(BIN)/python -m benchmarks --worlds $(if $(WORLDS),--missions "$(WORLDS)")

bench-flight: $(VENV)/.bench .venv-crazyflow/.ready .venv-ampyc/.ready ## The same for wind (an hour); MISSIONS as above
	$(BIN)/python -m benchmarks --flight $(if $(MISSIONS),--missions "$(MISSIONS)")

bench-scale: $(VENV)/.bench ## The same for large fleets and campaigns
	$(BIN)/python -m benchmarks --scale

bench-open: $(VENV)/.bench ## The same for requirements: links, formations, corridors (six minutes)
	$(BIN)/python -m benchmarks --open

bench-map: $(VENV)/.bench ## The same for maps (ten minutes); MISSIONS=folder of the LSC planner's OctoMaps
	$(BIN)/python -m benchmarks --maps $(if $(MISSIONS),--missions "$(MISSIONS)")

bench-time: $(VENV)/.bench .venv-casadi/.ready ## The same for least times; MISSIONS as for maps
	$(BIN)/python -m benchmarks --times $(if $(MISSIONS),--missions "$(MISSIONS)")

bench-mixed: $(VENV)/.bench $(VENV)/.test ## The same for random scenes, windows and files that mix everything
	$(BIN)/python -m benchmarks --mixed

bench-objective: $(VENV)/.bench $(VENV)/.test ## The same for costs: CVXPY, closed forms, IPOPT, all mixed (forty minutes)
	$(BIN)/python -m benchmarks --objective

bench-online: $(VENV)/.bench ## The same for missions that go on, seen in flight (three hours); MISSIONS as for maps
	$(BIN)/python -m benchmarks --online $(if $(MISSIONS),--missions "$(MISSIONS)")

bench-clients: $(VENV)/.bench $(VENV)/.test ## The same for files of other programs; FILES=folder of public ones
	$(BIN)/python -m benchmarks --clients $(if $(FILES),--files "$(FILES)")

bench-show: $(VENV)/.bench ## The same for shows
	$(BIN)/python -m benchmarks --shows

bench-bound: $(VENV)/.bench ## The same for global optima
	$(BIN)/python -m benchmarks --bounds

test: $(VENV)/.test ## Run the tests, but for slow ones (some five minutes on two cores)
	@sh tools/setup-browser $(VENV)
	$(PYTEST) -m "not slow"

test-all: $(VENV)/.test ## Run every test, then random ones from a fresh seed, which is printed
	@sh tools/setup-browser $(VENV)
	$(PYTEST)
	@echo "random tests from seed $(SEED): make test-all SEED=$(SEED) repeats them"
	$(PYTEST) -m hypothesis --hypothesis-profile=random --hypothesis-seed=$(SEED) || \
		{ echo "failed with seed $(SEED): make test-all SEED=$(SEED) repeats it"; exit 1; }

lint: $(VENV)/.dev $(VENV)/.pins ## Check format, style, types, the direction of imports, the pins
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(VENV)/.dev ## Put the code in the project's format
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

clean: ## Remove the environment and all caches
	rm -rf $(VENV) .venv-* build site .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(READY): pyproject.toml constraints.txt tools/setup
	@sh tools/setup $(VENV)
	@touch $@

# Each extra is installed when a target first asks for it.
EXTRAS := test docs dev notebooks bench
$(EXTRAS:%=$(VENV)/.%): $(VENV)/.%: $(READY)
	$(PIP) install --constraint constraints.txt --editable '.[$*]'
	@touch $@

# Looked at again only when a pin, or the oldest Python, is another.
$(VENV)/.pins: pyproject.toml constraints.txt tools/check-pins $(READY)
	@sh tools/check-pins $(BIN)/python
	@touch $@

# Peers that nothing else may share an environment with: each has its own, with an extra of its name.
.venv-crazyflow/.ready .venv-ampyc/.ready .venv-openscvx/.ready .venv-casadi/.ready: .venv-%/.ready: pyproject.toml $(READY)
	$(BIN)/python -m venv .venv-$*
	.venv-$*/bin/python -m pip --quiet --disable-pip-version-check install '.[$*]'
	@touch $@
