# trocar for people who have make; `pip install .` and `trocar sim` do without it.
#
#   make run ARGS="--rig psm"      hand arguments to trocar sim
#   make PYTHON=/opt/python3.12    choose the Python that .venv is built from

.DEFAULT_GOAL := help

# Windows has environments' programs elsewhere, and Git's bash for the recipes.
ifeq ($(OS),Windows_NT)
SHELL := bash
bin := Scripts
else
bin := bin
endif
BIN := .venv/$(bin)
comma := ,
ARGS ?=
# Without bytecode each of the programs that tests start compiles trocar anew.
unexport PYTHONDONTWRITEBYTECODE
# Tests run in this many processes; JOBS=0 runs them in one.
JOBS ?= 2
# The first Python that is new enough, the usual one before the others.
PYTHON ?= $(shell for python in python3 python3.13 python3.12 python3.11 python; do \
	"$$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null \
	&& { echo "$$python"; break; }; done)

# The Python that Debian's rospy is for.
ROS1_PYTHON ?= /usr/bin/python3

# What make run installs (the extra `all`, pip and the build backend) stands with hashes in
# requirements.txt; these are added to it for other targets. Only make skipped installs judges, one
# of which needs a proprietary wheel (docs/licences.md), and PyTorch, which may take gigabytes.
# Linux on ARM: no wheels of these (pip's index, for Python 3.11); built from sources with known
# hashes, which takes a C++ compiler.
SOURCES := $(if $(filter Linux-aarch64,$(shell uname -s)-$(shell uname -m)),\
	--no-binary glcontext$(comma)moderngl$(comma)ruckig)
EXTRAS_test := [test,browser]
EXTRAS_cad := [cad]
EXTRAS_docs := [docs]
EXTRAS_dev := [dev]
EXTRAS_judges := [dev,judges,learn,gpu]

# The browser draws in software and needs the machine for itself; pytest ends with 5 where ARGS
# chooses nothing. Side by side, processes with several BLAS threads each only wait for one another.
walk := tests/viewer/test_browser_controls.py
# The folder of browser tests, unless ARGS names tests: to collect all takes half a minute.
browsed := $(if $(findstring tests/,$(ARGS)),,tests/viewer)
define tests
$(BIN)/python -m pytest -m "browser and not slow" --durations=10 $(browsed) $(ARGS) || [ $$? = 5 ]
OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -m "not browser and not slow" -n $(JOBS) \
	--dist worksteal --durations=30 $(ARGS)
endef

# More robots and longer runs of what the other tests prove once.
define slow
$(BIN)/python -m pytest -m "browser and slow" --ignore=$(walk) $(browsed) $(ARGS) || [ $$? = 5 ]
OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -m "slow and not browser" -n $(JOBS) \
	--dist worksteal --durations=10 $(ARGS) || [ $$? = 5 ]
endef

# Kernels of OpenBLAS for three generations of processors, which round otherwise, each behind the
# instructions that it needs: OpenBLAS does not look, and a processor without them ends the process.
KERNELS := sse4_2:Nehalem avx2:Haswell avx512vl:SkylakeX

# pip's own output is hundreds of lines, and silence for a minute looks like a hang.
define pip
@{ $(1)/$(bin)/python -m pip install --progress-bar off $(2); echo "status $$?"; } | \
	while read -r word name rest; do case "$$word $$name" in \
		Collecting*) printf '%s ' "$${name%%[<>=!~;[(]*}";; \
		"Installing collected") printf '\nInstalling %s packages ...\n' "$$(($$(echo $$rest | wc -w) - 1))";; \
		status*) exit $$name;; \
	esac; done
endef

define install
@echo "Installing trocar$(2) into $(1) from pinned versions; this takes about a minute:"
$(call pip,$(1),--constraint constraints.txt --build-constraint constraints.txt --editable '.$(2)')
endef

.PHONY: help venv run quick test slow controls kernels check skipped lint bench speed attack cad docs dist hashes licences ros1-venv clean

help: ## say what can be made
	@sed -n 's/^\([a-z0-9-]*\):.*## \(.*\)/  make \1\t\2/p' Makefile | expand -t 18

venv: .venv/.ready-dev ## build the environment in .venv, with everything that make check needs

run: .venv/.ready-run ## open the full cart in the browser (ARGS="--rig psm" and the like)
	@echo "In another terminal, beside it: . .venv/bin/activate, and then for instance"
	@echo "  trocar --help                                 all commands; README.md has a tour of them"
	@echo "  trocar render -o scope.png                    the endoscope's picture"
	@echo "  trocar run examples/scripts/circle.py --speed max     a dVRK script, without ROS"
	@echo "  trocar sample samples                         small simulated files for replay, ..."
	@echo "  python examples/09_websocket_client.py        a WebSocket client that moves an arm"
	$(BIN)/trocar sim $(ARGS)

quick: .venv/.ready-test ## run the tests of what changed, within a minute (ARGS="tests/kinematics")
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest --quick -m "not browser and not slow" \
		-n $(JOBS) --dist loadfile --no-loadscope-reorder $(ARGS)

test: .venv/.ready-test ## run all tests but the slow ones (browser tests where there is a Chromium)
	$(tests)

slow: .venv/.ready-test ## run the slow tests
	$(slow)

controls: .venv/.ready-test ## try every control of the page in a Chromium, at three widths
	$(BIN)/python -m pytest $(walk) $(ARGS)

kernels: .venv/.ready-test ## run the tests of fits as other x86-64 processors round
	@for kernel in $(KERNELS); do needs=$${kernel%:*} name=$${kernel#*:}; \
		grep -qsw "$$needs" /proc/cpuinfo || { echo "skips $$name: no $$needs here"; continue; }; \
		echo "OPENBLAS_CORETYPE=$$name"; \
		OPENBLAS_CORETYPE=$$name OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -q \
			-m "not browser and not slow" -n $(JOBS) --dist worksteal \
			tests/fitting tests/robot/calibration tests/robot/identification $(ARGS) || exit; \
	done

check: lint ## format, lint, types, then all tests, the slow ones and the wheel's among them
	$(tests)
	$(slow)

skipped: .venv/.ready-judges ## run what the last make test skipped, where all judges are installed
	$(BIN)/python -m pytest --skipped-before -m browser $(ARGS) || [ $$? = 5 ]
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest --skipped-before -m "not browser" -n $(JOBS) \
		--dist loadfile $(ARGS) || [ $$? = 5 ]

lint: .venv/.ready-dev ## format, lint and types alone
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/pyright --pythonpath $(BIN)/python

bench: .venv/.ready-run ## measure real-time factors beside bare MuJoCo
	$(BIN)/trocar bench $(ARGS)

speed: .venv/.ready-run ## compare with the last release: fails if 10 % slower (ARGS="COMMIT --only steps")
	$(BIN)/python -m benchmarks against --worst 1.10 $(ARGS)

attack: .venv/.ready-test ## attack a simulator for ten minutes in each way (ARGS="--only faults")
	$(BIN)/python -m benchmarks attack --seconds 600 --jobs 2 $(ARGS)

cad: .venv/.ready-cad ## draw the links' solids again (ARGS="--only psm")
	$(BIN)/python -m tools.cad -o src/trocar/descriptions/data/solids $(ARGS)

docs: .venv/.ready-docs ## build the documentation into site/, an API reference among it
	for page in command_line descriptions topics scenes learning_scenes errata calls; do $(BIN)/python tools/docs/$$page.py || exit; done
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict
	@echo "site/index.html is the documentation."

dist: .venv/.ready-run ## build wheel and sdist into dist/
	$(BIN)/python -m hatchling build --clean

hashes: .venv/.ready-run ## write requirements.txt again, after a change of constraints.txt
	$(BIN)/python -m pip install --quiet --constraint constraints.txt uv
	@printf '%s\n' pip hatchling editables | $(BIN)/uv pip compile --quiet --upgrade --universal \
		--python-version 3.11 --generate-hashes --only-binary :all: --no-annotate \
		--custom-compile-command "make hashes" --constraint constraints.txt \
		--extra all pyproject.toml - --output-file requirements.txt

licences: .venv/.ready-judges ## write docs/licences.md again, after a change of constraints.txt
	$(BIN)/python tools/docs/licences.py

ros1-venv: .venv-ros1/.ready ## build .venv-ros1 on the Python that has rospy, for trocar sim --ros1

clean: ## throw away .venv, .venv-ros1 and the caches
	rm -rf .venv .venv-ros1 .pytest_cache .ruff_cache .hypothesis

# Each stamp says for whom the environment is ready, and grows old with what it was made from.
.venv/.ready-run: .venv/.created pyproject.toml requirements.txt src/trocar/__init__.py
	@echo "Installing trocar into .venv from wheels with known hashes; this takes about a minute:"
	$(call pip,.venv,--require-hashes --only-binary :all: --requirement requirements.txt $(SOURCES))
	@$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation --editable .
	@touch $@

.venv/.ready-%: .venv/.ready-run constraints.txt
	$(call install,.venv,$(EXTRAS_$*))
	@touch $@

# rospy belongs to the system's Python; crtk_msgs, which nobody packages, is made for clients.
.venv-ros1/.ready: pyproject.toml constraints.txt src/trocar/__init__.py
	@$(ROS1_PYTHON) -c 'import rospy, genpy' 2>/dev/null || { echo "$(ROS1_PYTHON) has no rospy;" \
		"on Debian and Ubuntu: sudo apt install python3-rospy python3-rosmaster" >&2; exit 1; }
	@$(ROS1_PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "trocar needs" \
		"Python 3.11 or newer; $(ROS1_PYTHON) is $$($(ROS1_PYTHON) --version 2>&1)" >&2; exit 1; }
	$(ROS1_PYTHON) -m venv --system-site-packages --clear .venv-ros1
	.venv-ros1/bin/python -m pip install --quiet --upgrade --constraint constraints.txt pip
	$(call install,.venv-ros1,[record$(comma)export$(comma)scope])
	.venv-ros1/bin/python -m trocar.ros.transports.ros1.packages .venv-ros1/ros
	@touch $@

.venv/.created:
	@test -n "$(PYTHON)" || { echo "trocar needs Python 3.11 or newer, and none was found;" \
		"name one: make PYTHON=/path/to/python3.12 ..." >&2; exit 1; }
	@"$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "trocar needs" \
		"Python 3.11 or newer; $(PYTHON) is $$("$(PYTHON)" --version 2>&1)" >&2; exit 1; }
	@"$(PYTHON)" -c 'import ensurepip, venv' 2>/dev/null || { echo "$(PYTHON) cannot build an" \
		"environment; on Debian and Ubuntu: sudo apt install python3-venv" >&2; exit 1; }
	@echo "Creating .venv with $(PYTHON) ..."
	@$(BIN)/python -c 'import sys, pip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null \
		|| "$(PYTHON)" -m venv --clear .venv
	@touch $@
