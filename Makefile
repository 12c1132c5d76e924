# make demo       install what is missing and turn a synthetic drive into depth maps
# make test       install what is missing; style, types, C++ tests and the fast Python tests
# make test-all   the same with sanitizers, slow tests, notebooks and the site
# make nightly    what takes too long for each change: more drives, every notebook, benchmarks
# make docs       install what is missing and build the site into build/site
#
# The first of them builds the C++ core, which takes about two minutes. Tests on real recordings run
# only where DOCDEPTH_KITTI_RAW names them; the tests end with a list of what they have left out.
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
SYSTEM := g++ make python3-venv python3-dev libeigen3-dev libnanoflann-dev doctest-dev \
          libosmesa6 libegl1 libgl1-mesa-dri libgl1 libgomp1 libusb-1.0-0

.PHONY: demo test test-all nightly docs install dev lint cpp-test sanitize lint-sanitize-docs pytest \
        pytest-all pytest-nightly stubs format wheel clean system

demo: install
	$(BIN)/docdepth demo -o demo

# One part after the other; at the end stands how long each took.
define run
	@took=""; trap 'printf "$$took"' EXIT; \
	for part in $(1); do \
	  begin=$$SECONDS; $(MAKE) --no-print-directory $$part; \
	  took+="$$part: $$((SECONDS - begin)) s\n"; \
	done
endef

test:
	$(call run,dev lint cpp-test pytest)

test-all:
	$(call run,dev cpp-test lint-sanitize-docs pytest-all)

# Each of them leaves a core idle for a while: mypy and sphinx have one process, compilers a last file.
lint-sanitize-docs: dev
	@$(MAKE) --no-print-directory -j3 lint sanitize docs

nightly: test-all
	$(call run,pytest-nightly)

# System packages by apt, where there is one; elsewhere CMake fetches the headers it needs. Only root
# installs them: everyone else is told the command.
system:
	@command -v dpkg-query >/dev/null || exit 0; \
	missing=$$(for p in $(SYSTEM); do \
	  dpkg-query -W -f='$${Status}' $$p 2>/dev/null | grep -q 'install ok' || echo $$p; done); \
	[ -z "$$missing" ] && exit 0; \
	if [ "$$(id -u)" != 0 ]; then \
	  echo "packages are missing; install them, or go on without them by: make SYSTEM= ..."; \
	  echo "sudo apt-get install --no-install-recommends "$$missing; exit 1; \
	fi; \
	echo "installing: "$$missing; \
	apt-get update -qq && \
	DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $$missing

$(BIN)/python: | system
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --upgrade pip
	$(BIN)/pip install --quiet scikit-build-core pybind11 cmake ninja

SOURCES := pyproject.toml CMakeLists.txt $(shell find cmake cpp python -type f \
             -name '*.[cht]*' -o -name '*.py' -path 'python/*')

# pip says nothing while it compiles, which takes a minute or two: show the packages that it collects
# and the files that the compiler is at. The whole log is kept beside the environment.
define progress
	2>&1 | tee $(VENV)/$(1).log | sed -unE \
	  -e 's/^ *Collecting ([A-Za-z0-9_.-]+).*/  package \1/p' \
	  -e 's,^ *(\[[0-9]+/[0-9]+\]) Building CXX object .*\.dir/(.*)\.o$$,  \1 \2,p' \
	  -e 's/^ *Successfully installed .*(docdepth-[0-9.]+).*/installed \1/p' \
	  -e 's/^ *(ERROR|error:)/\1/p' \
	  || { tail -n 40 $(VENV)/$(1).log; exit 1; }
endef

# A marker each, so that nothing is built again while no source has changed.
$(VENV)/installed: $(SOURCES) | $(BIN)/python
	@echo "installing docdepth[synth]: packages, then the C++ core, about two minutes"
	@$(BIN)/pip install --verbose '.[synth]' $(call progress,install)
	@touch $@

$(VENV)/documented: $(SOURCES) | $(BIN)/python
	@echo "installing docdepth[docs]: packages, then the C++ core, about two minutes"
	@$(BIN)/pip install --verbose '.[docs]' $(call progress,install)
	@touch $@

# Packages of the tools come down while the C++ core and its tests compile, in one build tree.
BUILD := build/release
LAUNCHER := $(if $(shell command -v ccache),CMAKE_CXX_COMPILER_LAUNCHER=ccache)
$(VENV)/packages: pyproject.toml | $(BIN)/python
	@echo "installing packages of docdepth[dev]"
	@$(BIN)/python .ci/requirements.py dev > $(VENV)/requirements.txt
	@$(BIN)/pip install --no-compile -r $(VENV)/requirements.txt $(call progress,packages)
	@touch $@

$(VENV)/built: $(SOURCES) | $(BIN)/python
	@echo "building the C++ core and its tests, about two minutes"
	@rm -rf $(BUILD)/wheel
	@$(BIN)/pip wheel --verbose --no-deps --no-build-isolation --wheel-dir $(BUILD)/wheel \
	  -C build-dir=$(BUILD) -C cmake.define.DOCDEPTH_TESTS=ON -C cmake.define.DOCDEPTH_WERROR=ON \
	  $(addprefix -C cmake.define.,$(LAUNCHER)) . $(call progress,build)
	@touch $@

$(VENV)/developed: $(VENV)/packages $(VENV)/built
	@$(BIN)/pip install --quiet --no-index --no-deps --force-reinstall $(BUILD)/wheel/docdepth-*.whl
	@touch $@ $(VENV)/installed $(VENV)/documented

install: $(VENV)/installed
dev:
	@$(MAKE) --silent -j2 $(VENV)/developed

lint: dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/clang-format --dry-run --Werror $$(git ls-files '*.cpp' '*.hpp')

cpp-test: dev
	$(BUILD)/docdepth_tests

# The C++ tests under the address and undefined behaviour sanitizers, with the assertions of Eigen.
# With -O2 they take twice as long to compile.
sanitize: dev
	$(BIN)/cmake -S . -B build/sanitize -G Ninja -DCMAKE_MAKE_PROGRAM=$(abspath $(BIN)/ninja) \
	  -DDOCDEPTH_WERROR=ON -DDOCDEPTH_PYTHON=OFF -DDOCDEPTH_TESTS=ON -DDOCDEPTH_SANITIZE=ON \
	  -DCMAKE_BUILD_TYPE=RelWithDebInfo -DCMAKE_UNITY_BUILD=ON \
	  -DCMAKE_CXX_FLAGS_RELWITHDEBINFO="-O1 -g1" $(addprefix -D,$(LAUNCHER))
	MAKEFLAGS= $(BIN)/cmake --build build/sanitize  # ninja cannot read a make's list of free jobs
	build/sanitize/docdepth_tests

# A process a core.
PYTEST := $(BIN)/python -m pytest -n auto --dist worksteal --durations 10
pytest: dev
	$(PYTEST) -m "not slow"

pytest-all: dev
	DOCDEPTH_EXAMPLES=$${DOCDEPTH_EXAMPLES:-10} $(PYTEST) -m "not nightly"

pytest-nightly: dev
	$(PYTEST) -m nightly

# The site; what it warns of is an error.
docs: $(VENV)/documented
	$(BIN)/python -m sphinx -q -W --keep-going -d build/doctrees -c docs . build/site
	@echo "look at build/site/index.html"

# Type stubs of the compiled module, kept in git; a test says when they are out of date.
stubs: dev
	$(BIN)/pybind11-stubgen docdepth._core --output-dir build/stubs --ignore-all-errors
	cp build/stubs/docdepth/_core.pyi python/docdepth/_core.pyi

format: dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .
	$(BIN)/clang-format -i $$(git ls-files '*.cpp' '*.hpp')

wheel: | $(BIN)/python
	$(BIN)/pip wheel --no-deps --wheel-dir dist .

clean:
	rm -rf build dist demo $(VENV)
