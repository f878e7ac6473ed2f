# make demo | demo-closed-loop | test | test-core | test-long | lint | docs | clean. Needs Python 3.11 or 3.12
# and a package index; ROS 2 comes as wheels.

SUPPORTED = import ensurepip, sys, venv; sys.exit(sys.version_info[:2] not in [(3, 11), (3, 12)])
PYTHON ?= $(shell for python in python3.12 python3.11 python3; do \
	"$$python" -c '$(SUPPORTED)' 2>/dev/null && echo "$$python" && break; done)

VENV := $(CURDIR)/.venv
# `/usr/bin/env python3` of the node scripts is to be the python of the venv, and what is run the
# package that is installed there, not the sources in this folder.
RUN := PATH="$(VENV)/bin:$$PATH" PYTHONSAFEPATH=1 $(VENV)/bin/python
PIP_LIBRARIES := $(VENV)/bin/python -m pip install --disable-pip-version-check --no-compile
PIP_INSTALL := $(VENV)/bin/python -m pip install -q --disable-pip-version-check
# Leftovers of a sourced ROS 2 or of another venv must not meet the wheels of this one.
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE LD_LIBRARY_PATH PYTHONPATH PYTHONHOME
unexport AMENT_PREFIX_PATH COLCON_PREFIX_PATH RMW_IMPLEMENTATION
# pip leaves byte code to the first use. Without any each process would translate NumPy, SciPy and
# numba again: two seconds of a processor.
unexport PYTHONDONTWRITEBYTECODE

# Folders are among them, so that a deleted file counts as a change.
SOURCES := pyproject.toml setup.py setup.cfg package.xml $(shell \
	find startracker_ros config launch resource -not -path '*/__pycache__*')

.PHONY: demo demo-closed-loop test test-core test-long lint docs clean

demo: .venv/package
	@echo '== demo: six nodes on the simulated sky, a minute of it once all are ready; a bag of some 320 MB in demo'
	$(RUN) -m startracker_ros demo

demo-closed-loop: .venv/package .venv/gnc
	$(RUN) -m startracker_ros demo closed-loop

PYTEST := $(RUN) -m pytest -q
# Three workers: tests of nodes wait half of their time. The order is that of test/conftest.py.
ON_BOTH_CORES := -n 3 --dist loadfile --no-loadscope-reorder
# What a change has to pass.
test: .venv/package .venv/tests .venv/gnc
	@$(PYTEST) $(ON_BOTH_CORES) -m 'not long' test

# What neither starts nodes nor takes long, to be run after each change.
test-core: .venv/package .venv/tests
	@$(PYTEST) $(ON_BOTH_CORES) -m core test

# The linters of ROS 2 packages, ruff and mypy: half a minute of a processor.
lint: .venv/package .venv/tests
	@$(PYTEST) test/package/test_lint.py

# The documents and the reference of the library as a site: build/site/index.html. A warning fails.
docs: .venv/package .venv/docs
	$(RUN) -m sphinx -q -W --keep-going -E -b html docs build/site

# More cases and larger sizes of what `make test` covers, and installs: before a release.
test-long: .venv/package .venv/tests .venv/gnc
	@$(PYTEST) $(ON_BOTH_CORES) -m long test

.venv/requirements: requirements.txt
	@"$(PYTHON)" -c '$(SUPPORTED)' 2>/dev/null || { \
		echo 'Python 3.11 or 3.12 with venv is needed: make PYTHON=/path/to/python3.12' >&2; \
		exit 1; }
	@echo '== libraries: a virtual environment in .venv; downloads some 270 MB, takes about a minute'
	"$(PYTHON)" -m venv .venv
	$(PIP_LIBRARIES) -r requirements.txt
	@touch $@
	@echo "== libraries: .venv has $$(du -sh .venv | cut -f 1)"

.venv/tests: requirements-test.txt .venv/requirements
	@echo '== libraries of the tests: downloads some 150 MB more'
	$(PIP_LIBRARIES) -r requirements-test.txt
	@touch $@
	@echo "== libraries of the tests: .venv has $$(du -sh .venv | cut -f 1)"

.venv/docs: requirements-docs.txt .venv/requirements
	$(PIP_LIBRARIES) -q -r requirements-docs.txt
	@touch $@

# Without what Basilisk asks for: its limits would replace matplotlib, pillow and sgp4 by older ones,
# and the loop imports none of the others.
.venv/gnc: .venv/requirements requirements-gnc.txt
	$(PIP_INSTALL) --no-deps -r requirements-gnc.txt
	touch $@

# Not editable: pip leaves config, launch files and node scripts out of an editable install.
.venv/package: .venv/requirements $(SOURCES)
	@echo '== package: installs it, then compiles its functions for this machine: a minute or two of processor time, once for the same sources'
	@rm -rf build/lib
	$(PIP_INSTALL) --no-deps --no-build-isolation .
	@$(RUN) -m startracker_ros.warm_up --install
	@touch $@
	@echo "== package: .venv has $$(du -sh .venv | cut -f 1)"

clean:
	rm -rf .venv build install log demo demo_closed_loop demo_heads *.egg-info .pytest_cache .mypy_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
