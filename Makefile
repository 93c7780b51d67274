# SPDX-License-Identifier: GPL-2.0-or-later
# make demo, make test: a fresh Debian or Ubuntu is enough; what is missing gets installed (sudo when not root).

SHELL := bash
SUDO := $(if $(filter 0,$(shell id -u)),,sudo)
CAPTURE ?=
DEMO := docs/first.pcapng
# As root, Wireshark 4.4 and later ignore Lua plugins without a word.
ORDINARY := $(if $(filter 0,$(shell id -u)),setpriv --reuid=65534 --regid=65534 --clear-groups env HOME=/tmp,)

.PHONY: demo test test-all unit unit-5.2 unit-5.4 unit-5.5 map e2e lint install uninstall dist release soak matrix \
  fuzz mutate bench screenshots regenerate \
  needs-tshark needs-python needs-hatchling needs-tests needs-bench

# $(call install-missing,commands that must be there,packages that bring them,another condition)
define install-missing
	@missing=; for command in $(1); do command -v $$command >/dev/null || missing=1; done; \
	$(or $(3),true) || missing=1; \
	if [ -n "$$missing" ]; then \
	  command -v apt-get >/dev/null && command -v $(or $(SUDO),true) >/dev/null && echo "Installing: $(2)" && \
	  $(SUDO) apt-get update -qq && $(SUDO) env DEBIAN_FRONTEND=noninteractive \
	    apt-get install -y -qq --no-install-recommends $(2) >/dev/null || { \
	      echo "This could not be installed: $(2)"; \
	      echo "Install it as root, on Debian and Ubuntu by: apt-get install --no-install-recommends $(2)"; \
	      exit 1; }; \
	fi
endef

needs-tshark:
	$(call install-missing,tshark,tshark)

needs-python:
	$(call install-missing,python3,python3)

# Debian's package is of the system's Python, whichever comes first in PATH.
needs-hatchling: needs-python
	$(call install-missing,python3,python3-hatchling,PATH=/usr/bin:$$PATH python3 -c 'import hatchling' 2>/dev/null)

needs-tests: needs-tshark
	$(call install-missing,lua5.2 lua5.4 luacheck pytest-3 candump zip localedef strace pip3 git,lua5.2 lua5.4 lua-check lua-unit \
	  python3-pytest python3-pytest-xdist python3-can python3-serial python3-hatchling can-utils zip locales strace python3-pip git,\
	  /usr/bin/python3 -c 'import xdist; import can; import serial; import hatchling' 2>/dev/null)

needs-gui: needs-tests
	$(call install-missing,wireshark Xvfb openbox xdotool xclip import tesseract,wireshark xvfb openbox xdotool xclip \
	  imagemagick tesseract-ocr)

## What all tests need, installed once as root: then `make test` asks for nothing, as whom it may run (the workflows)
needs-all: needs-tests needs-bench needs-gui needs-tools-packages

## The faults of a flight, and the first one decoded: docs/first.pcapng, or CAPTURE=file
demo: needs-tshark
	@tests/demo "$(or $(CAPTURE),$(DEMO))"

## What a developer runs after every change: each behaviour once, in three minutes on two idle cores
test: lint unit e2e

## What CI runs: everything on this machine's Wireshark with its memory checked (docs/reliability.md), the other ones of 4.0,
## 4.4 and 4.6, each by both loading routes, and some fuzzing: in twenty minutes.  What takes a night has targets of its own:
## soak, fuzz, mutate, YAPP_LEVEL=all tests/matrix
test-all:
	tests/anyone
	YAPP_STRICT=1 YAPP_LEVEL=all $(MAKE) test
	YAPP_LEVEL=route YAPP_ROUTE=plugin $(MAKE) e2e
	tests/matrix --rest
	$(MAKE) parity-viewer LEVEL=all CHROOT=$(wildcard $(or $(XDG_CACHE_HOME),$(HOME)/.cache)/yapp-matrix/trixie)
	$(MAKE) fuzz FRAMES=$(or $(FRAMES),20000)

## The code, and the pages: lengths, plain words, links.  All of its parts run, then it fails
lint: needs-tests
	@failed=0; luacheck -q . || failed=1; pytest-3 -q -rs -p no:cacheprovider tests/lint || failed=1; exit $$failed

# Wireshark has Lua 5.2 or 5.4; 5.5, which will come, is tried where it is.
unit: needs-tests
	@$(MAKE) --no-print-directory -j 2 --output-sync=target unit-5.2 unit-5.4 unit-5.5

unit-5.2 unit-5.4: unit-%:
	lua$* tests/unit/run.lua tests/unit/test_*.lua

unit-5.5:
	@if command -v lua5.5 >/dev/null; then lua5.5 tests/unit/run.lua tests/unit/test_*.lua; \
	else echo "Lua 5.5: left out, there is no lua5.5"; fi

## Which folder of modules requires which: the picture of CONTRIBUTING.md
map: needs-python
	@/usr/bin/env python3 tools/module_map.py

# YAPP_LEVEL=all: everything, see tests/e2e/levels.py.  One more than there are cores: some tests wait for a port.
e2e: needs-tests
	pytest-3 -q -rs -n $$(($$(nproc) + 1)) --dist loadgroup -p no:cacheprovider tests/e2e

## One test in the real Wireshark, under Xvfb
gui-smoke: needs-gui
	pytest-3 -q -rs -p no:cacheprovider tests/gui/test_gui.py -k "test_a_statistic_in_a_window"

## All of them
gui: needs-gui
	pytest-3 -q -rs -p no:cacheprovider tests/gui

## Tests the tests: a wrong value in each thing that the plugin tells Wireshark, EACH=5 of each kind; and where nothing can be right
plant: needs-tests
	/usr/bin/env python3 tests/plant.py $(if $(EACH),--each $(EACH)) --seed $(or $(SEED),1)

blind: needs-tests
	/usr/bin/env python3 tests/blind.py

## The same generators, many more captures: 1,000 CAN captures and 1,000 streams
soak: needs-tests
	YAPP_LEVEL=all YAPP_SOAK_CAPTURES=1000 YAPP_SOAK_FRAMES=1000 YAPP_SOAK_STREAMS=1000 \
	  pytest-3 -q -s -rs -p no:cacheprovider tests/e2e/test_can_soak.py tests/e2e/test_streams.py

## Wireshark 4.0, 4.4 and 4.6, in chroots
matrix:
	tests/matrix

## Mutated captures: FRAMES=100000 SEED=1
fuzz: needs-tests
	/usr/bin/env python3 tests/fuzz.py --frames $(or $(FRAMES),100000) --seed $(or $(SEED),1)

## Faults put into the modules that need no Wireshark, EACH=20 in each, SEED=1: prints the share that the unit tests see
mutate: needs-tests
	/usr/bin/env python3 tests/mutate.py --each $(or $(EACH),20) --seed $(or $(SEED),1)

## Beside its peers, on this tshark and on 4.6 (tests/matrix makes its chroot), into docs/BENCH.md: RUNS=5, BASE=folder another version
bench: needs-bench
	/usr/bin/env python3 tests/bench/bench.py $(if $(RUNS),--runs $(RUNS)) $(if $(BASE),--base "$(BASE)")

needs-bench: needs-tshark
	$(call install-missing,python3 lua5.2 lua5.4,python3 python3-venv python3-can lua5.2 lua5.4,\
	  /usr/bin/python3 -c 'import can; import ensurepip' 2>/dev/null)

## What follows from the rows of the code and of the catalogue: pages, their samples, the picture of CONTRIBUTING.md, what the
## captures show.  It prints what changed: read the difference
regenerate: needs-tshark needs-tools
	@$(TOOLS)/python tools/regenerate.py

## Six changes, each made in a scratch clone as CONTRIBUTING.md's table says: a message, a rule, a column, ...
changes: needs-tests
	/usr/bin/env python3 tests/changes.py

screenshots:
	tests/screenshots

## For the user who runs it: plugin, live ports, profile; what was changed is kept.  And out of it; PURGE=1: what was changed, too
install: needs-tshark needs-python
	@/usr/bin/env python3 tools/install.py install

uninstall: needs-python
	@/usr/bin/env python3 tools/install.py uninstall $(if $(PURGE),--purge)

## What a release has: the zip for every desktop, the profile's, the samples', the wheel of yapp-tables, their sums
dist: needs-hatchling
	@/usr/bin/python3 tools/dist.py

## A release from its tag, TAG=v2.1.0, built twice: what the workflow does
release: needs-hatchling
	PATH=/usr/bin:$$PATH tools/release.sh "$(TAG)"

# The Python package has its own environment, so that nothing is installed into the system's Python.
TOOLS_VENV := $(HOME)/.cache/yapp-tools
TOOLS := $(TOOLS_VENV)/bin

needs-tools-packages:
	$(call install-missing,chromium chromedriver termshark,chromium chromium-driver termshark)

needs-tools: needs-tshark
	$(call install-missing,python3,python3 python3-venv,python3 -c 'import ensurepip' 2>/dev/null)
	@[ -x $(TOOLS)/python ] || python3 -m venv $(TOOLS_VENV)
	@$(TOOLS)/pip install -q -e './tools[test]'

## The Python package in tools/: ruff, mypy and its tests
test-tools: needs-tools needs-tools-packages
	$(TOOLS)/ruff check --config tools/pyproject.toml tools/src tests/tools
	$(TOOLS)/ruff format --check --config tools/pyproject.toml tools/src tests/tools
	$(TOOLS)/mypy --config-file tools/pyproject.toml tools/src
	$(TOOLS)/python -m pytest -q -rs -n auto --dist loadfile -p no:cacheprovider tests/tools

.PHONY: changes test-tools needs-tools needs-tools-packages needs-gui needs-all gui gui-smoke plant blind

# The viewer in the browser, docs/viewer.md.  Its packages stay in web/node_modules.
needs-viewer: needs-python
	$(call install-missing,node npm,nodejs npm)
	@[ web/node_modules/.package-lock.json -nt web/package-lock.json ] || \
	  (cd web && npm ci --ignore-scripts --silent && touch node_modules/.package-lock.json)

## The page that opens captures in any browser: dist/viewer for a web server, dist/viewer-offline for a double click
viewer: needs-viewer
	@node tools/viewer.mjs

## The same on http://127.0.0.1:8000, PORT=8000
viewer-serve: viewer
	@python3 -m http.server --bind 127.0.0.1 --directory dist/viewer $(or $(PORT),8000)

## The viewer beside tshark (see parity-viewer), and its page in Chromium
test-viewer: parity-viewer viewer
	$(call install-missing,$(or $(CHROMIUM),chromium),chromium)
	@node --test --test-reporter=dot tests/viewer/browser.test.mjs

## The viewer beside tshark, twenty captures; LEVEL=all CHROOT=folder of a Debian with tshark: all of them, that tshark
parity-viewer: needs-viewer needs-tshark
	@YAPP_VIEWER_LEVEL=$(LEVEL) YAPP_VIEWER_CHROOT=$(CHROOT) node --test --test-reporter=dot tests/viewer/parity.test.mjs


.PHONY: viewer viewer-serve test-viewer parity-viewer needs-viewer
