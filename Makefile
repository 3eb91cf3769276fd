# treebake: everything a newcomer needs, from a bare clone. `make` lists the targets.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
TREEBAKE := $(BIN)/treebake
INSTALLED := $(VENV)/.installed
UV := uv==0.13.9

.DEFAULT_GOAL := help
.PHONY: help demo test check bench batch lock clean venv

help: ## this list
	@grep -hE '^[a-z]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z]+):.*## (.*)/make \1\t\2/' | expand -t 14

demo: $(INSTALLED) ## grow a chestnut, bake it, verify it, and name the report
	$(TREEBAKE) grow chestnut -o build/chestnut.glb
	$(TREEBAKE) bake build/chestnut.glb -o build --config configs/chestnut.toml
	$(TREEBAKE) verify build/chestnut --source build/chestnut.glb --config configs/chestnut.toml --set verify.azimuths=4

test: $(INSTALLED) ## run the tests (PYTEST="-k cluster" picks some)
	$(BIN)/python -m pytest $(PYTEST)

check: $(INSTALLED) ## lint, format, strict types and tests: what CI runs
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python -m pytest

bench: $(INSTALLED) ## measure every row into build/bench.json (ONLY=E1,I5 picks some)
	$(BIN)/python -m tests.bench $(if $(ONLY),--only $(ONLY))

# ---- batch: make batch TREES="a.glb b.glb" -j2 -------------------------------------------------------------------
# One work folder per tree, build/NAME. A tree's settings are configs/NAME.toml where that exists, or CONFIG=FILE.
# treebake itself skips a stage whose inputs are unchanged, so a target that make finds stale may still cost nothing.

batch: $(INSTALLED) $(foreach tree,$(TREES),build/$(basename $(notdir $(tree)))/report/passed) ## bake and verify TREES="a.glb b.glb", with -j2 two at a time
	@$(if $(TREES),:,echo 'make batch: name the trees, e.g. make batch TREES="a.glb b.glb" -j2' >&2; exit 2)

$(foreach tree,$(TREES),$(eval source_$(basename $(notdir $(tree))) := $(tree)))
config = $(or $(CONFIG),$(wildcard configs/$*.toml))

.SECONDEXPANSION:
.SECONDARY:

build/%/stages/source.npz: $$(source_$$*) $$(config)
	$(TREEBAKE) cluster $< -o build/$* $(addprefix --config ,$(config))

build/%/manifest.json: build/%/stages/source.npz $$(config)
	$(TREEBAKE) textures build/$* $(addprefix --config ,$(config))

build/%/report/passed: build/%/manifest.json $$(config)
	$(TREEBAKE) verify build/$* --source $(source_$*) $(addprefix --config ,$(config))
	@touch $@

# ---- the virtual environment -------------------------------------------------------------------------------------

venv: $(INSTALLED) ## install the locked dependencies and treebake into .venv, and see that OpenGL loads

$(INSTALLED): requirements.lock pyproject.toml tests/package-lock.json
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo 'treebake needs Python 3.11 or later: make PYTHON=python3.11 ...' >&2; exit 2; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@$(BIN)/python -c 'from treebake.gl.context import context; context()' 2>/dev/null || $(GL_INSTALL)
	@if command -v npm >/dev/null; then npm ci --prefix tests --silent --no-fund --no-audit; else \
		echo 'no npm: the tests that call the Khronos glTF validator will be skipped'; fi
	@touch $@

GL_PACKAGES := libegl1 libgl1 libgl1-mesa-dri
GL_INSTALL = if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
		apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $(GL_PACKAGES); \
	else echo 'OpenGL cannot be loaded; run this line, then make again: sudo apt-get install $(GL_PACKAGES)' >&2; exit 2; fi

lock: $(INSTALLED) ## renew requirements.lock from pyproject.toml
	$(BIN)/python -m pip install --quiet $(UV)
	$(BIN)/uv pip compile pyproject.toml --extra dev --universal --quiet --upgrade --no-header -o requirements.lock

clean: ## remove what was built; the virtual environment stays
	rm -rf build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
