# Every target works in a fresh clone: it makes .venv and installs what it needs, again only when
# pyproject.toml or the page's sources have changed. Another Python: make demo PYTHON=python3.12

PYTHON ?= python3
OUT ?= out/beam
SITE ?= out/site
KERNELS ?=
FUZZ_SECONDS ?= 10
PYTEST_ARGS ?= -n auto --dist loadfile --no-loadscope-reorder

VENV := .venv
# Without byte code of all modules: a module is compiled to it when it is imported first, and it is kept.
unexport PYTHONDONTWRITEBYTECODE
INSTALL = $(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check
PAGE := $(shell find page -name node_modules -prune -o -type f -print) hatch_build.py
BIN := $(VENV)/bin
SPHINX := $(BIN)/python -m sphinx --fail-on-warning --keep-going --quiet --doctree-dir out/site-cache/doctrees

# Draw off-screen, without a display.
export PYVISTA_OFF_SCREEN ?= true
export MPLBACKEND ?= Agg
# The tests run side by side already; threads of linear algebra beside them only wait for each other, and
# threads of one test that spin longer stall those of another.
docs fuzz test test-all test-slow test-release: export OPENBLAS_NUM_THREADS ?= 1
docs fuzz test test-all test-slow test-release: export GOMP_SPINCOUNT ?= 1000
ifeq ($(shell uname -s),Linux)
export VTK_DEFAULT_OPENGL_WINDOW ?= vtkEGLRenderWindow
endif

.DEFAULT_GOAL := help
.PHONY: help demo docs films links test test-all test-slow release programs test-release fuzz wheels check-wheels
.PHONY: lint style types layers words clean

help: ## show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "make %-12s %s\n", $$1, $$2}' $(firstword $(MAKEFILE_LIST))

demo: $(VENV)/.installed-demo ## reproduce the paper's beam into out/beam
	$(BIN)/palpate reproduce beam --out $(OUT)
	@echo "The error of the reduced models over their number of modes, Figure 3 of the paper:"
	@echo "  $(abspath $(OUT))/figure3_error.png"
	@echo "Next, press and pull that beam on a page in the browser:"
	@echo "  $(BIN)/palpate view beam"
	@echo "The same page without palpate, for any web server:"
	@echo "  $(BIN)/palpate export beam --web $(OUT)/page"

films: $(VENV)/.installed-demo ## make the films of the docs, in some minutes
	$(BIN)/python docs/films.py

test: $(VENV)/.installed-test ## run the quick tests; the first time compiles for some minutes
	$(BIN)/python -m pytest -m "not slow and not lint" $(PYTEST_ARGS)

test-all: $(VENV)/.installed-test ## run the tests of a change: the quick ones, then the slow ones
	$(BIN)/python -m pytest -m "not release and not lint" $(PYTEST_ARGS)

test-slow: $(VENV)/.installed-test ## run the tests of a change that make test leaves out
	$(BIN)/python -m pytest -m "slow and not release and not lint" $(PYTEST_ARGS)

# One after the other, also with -j: each keeps all cores busy, and check-wheels needs what wheels has built.
release: $(VENV)/.installed-dev programs ## check what a version needs beyond .ci/run: other processors, all laws, wheels
	@failed=; for step in test-release fuzz wheels check-wheels; do \
	  echo "== make $$step"; $(MAKE) $$step || failed="$$failed $$step"; done; \
	[ -z "$$failed" ] || { echo "failed:$$failed"; exit 1; } >&2

test-release: $(VENV)/.installed-test
	$(BIN)/python -m pytest -m release $(PYTEST_ARGS)

fuzz: $(VENV)/.installed-test
	$(BIN)/python validation/fuzz.py all --seconds $(FUZZ_SECONDS) --seed $$(date +%j)

PROGRAMS := aarch64-linux-gnu-gcc clang cmake g++ mcs mono qemu-aarch64
programs:
	@missing=; for program in $(PROGRAMS); do command -v $$program >/dev/null || missing="$$missing $$program"; done; \
	[ -z "$$missing" ] || { echo "make release needs$$missing. On Debian or Ubuntu: apt-get install clang cmake g++" \
	  "gcc-aarch64-linux-gnu libc6-dev-arm64-cross mono-mcs mono-runtime qemu-user"; exit 1; } >&2

docs: $(VENV)/.installed-docs ## build the site into out/site, with its tutorials executed; warnings are errors
	$(SPHINX) -b html docs $(SITE)
	$(BIN)/python docs/check_links.py $(SITE)
	@echo "The site is $(abspath $(SITE))/index.html"

links: $(VENV)/.installed-docs ## check the external links of the site, over the network
	$(SPHINX) -b linkcheck docs out/links

wheels: $(VENV)/.installed-demo ## build the wheels of palpate and its compiled functions into dist, in some ten minutes
	$(BIN)/python kernels/fill.py $(KERNELS)
	@rm -rf dist
	$(BIN)/python -m pip wheel --quiet --no-deps --wheel-dir dist . ./kernels
	@ls dist

check-wheels: ## start from the wheels in dist, in a new environment, without compiling
	$(BIN)/python kernels/check.py dist

lint: style types layers words ## check style, formatting, types, import layers, names, words and pages of docs

style: $(VENV)/.installed-dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check

types: $(VENV)/.installed-dev
	$(BIN)/mypy

layers: $(VENV)/.installed-dev
	$(BIN)/lint-imports

words: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -m lint

clean: ## remove results, builds and caches, but not .venv
	rm -rf out build dist .mypy_cache .pytest_cache .ruff_cache .import_linter_cache
	find src tests validation benchmarks -name __pycache__ -prune -exec rm -rf {} + 2>/dev/null || true

# The demo's functions compile, in two processes, while the packages for pictures and the page install.
$(VENV)/.installed-demo: pyproject.toml $(PAGE) | $(VENV)/.installed-base
	@PYTHONPATH=src $(BIN)/python -P -m palpate.app.studies.compile beam >/dev/null 2>&1 & compiling=$$!; \
	trap 'kill $$compiling 2>/dev/null; exit 130' INT TERM; \
	echo "installing, and compiling the demo's functions meanwhile: a minute or two the first time ..."; \
	$(INSTALL) --editable '.[film,view]' || { kill $$compiling; exit 1; }; \
	wait $$compiling || true  # what is missing, the demo compiles
	@$(check_drawing)
	@touch $@

$(VENV)/.installed-base: pyproject.toml | $(BIN)/python
	@$(BIN)/python -c "import tomllib; project = tomllib.load(open('pyproject.toml', 'rb'))['project']; \
	  print(*project['dependencies'], sep='\n')" >$(VENV)/base.txt
	$(INSTALL) --requirement $(VENV)/base.txt
	@touch $@

$(VENV)/.installed-docs: EXTRAS := [docs]
$(VENV)/.installed-test: EXTRAS := [test]
$(VENV)/.installed-dev: EXTRAS := [dev]
$(VENV)/.installed-dev: ALSO := $(addprefix $(VENV)/.installed-,base demo docs test)
$(VENV)/.installed-%: pyproject.toml $(PAGE) | $(BIN)/python
	$(INSTALL) --editable '.$(EXTRAS)'
	@$(check_drawing)
	@touch $@ $(ALSO)

$(BIN)/python:
	@command -v $(PYTHON) >/dev/null || { echo "$(PYTHON) not found: install Python 3.11 or newer,"; \
	  echo "or name one: make PYTHON=/path/to/python3"; exit 1; } >&2
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "palpate needs Python 3.11 or newer; $(PYTHON) is $$($(PYTHON) --version 2>&1)."; \
	  echo "Name a newer one: make PYTHON=/path/to/python3"; exit 1; } >&2
	@$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); \
	  echo "$(PYTHON) -m venv failed. On Debian or Ubuntu: apt-get install python3-venv"; exit 1; } >&2

# VTK opens its graphics libraries only when it draws, and crashes where one is missing.
define check_drawing
(PYVISTA_OFF_SCREEN=true $(BIN)/python -c \
  'import pyvista; p = pyvista.Plotter(off_screen=True); p.add_mesh(pyvista.Sphere()); p.screenshot()'; \
  exit $$?) >/dev/null 2>&1 || { \
  echo "VTK cannot draw off-screen: it needs libEGL.so.1 and a Mesa driver."; \
  echo "On Debian or Ubuntu: apt-get install libegl1 libgl1 libgl1-mesa-dri"; exit 1; } >&2
endef
