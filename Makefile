# make demo | demo-closed-loop | test | test-core | test-evaluation | test-oldest | test-newest | test-long | test-ros |
# lint | docs | wheels | clean.
# Needs Python 3.11 or 3.12, with ROS=kilted 3.12 or 3.13, and a package index; ROS 2 comes as wheels.

ROS ?= jazzy
PYTHONS := $(if $(filter kilted,$(ROS)),3.12 3.13,3.11 3.12)
SUPPORTED = import ensurepip, sys, venv; sys.exit("%d.%d" % sys.version_info[:2] not in "$(PYTHONS)".split())
PYTHON ?= $(shell for python in python3.12 python3.11 python3.13 python3; do \
	"$$python" -c '$(SUPPORTED)' 2>/dev/null && echo "$$python" && break; done)

VENV := .venv$(addprefix -,$(filter-out jazzy,$(ROS)))
# `/usr/bin/env python3` of the node scripts is to be the python of the venv, and what is run the
# package that is installed there, not the sources in this folder.
RUN := PATH="$(CURDIR)/$(VENV)/bin:$$PATH" PYTHONSAFEPATH=1 $(CURDIR)/$(VENV)/bin/python
PIP_LIBRARIES := $(CURDIR)/$(VENV)/bin/python -m pip install --disable-pip-version-check --no-compile
PIP_INSTALL := $(CURDIR)/$(VENV)/bin/python -m pip install -q --disable-pip-version-check
# Leftovers of a sourced ROS 2 or of another venv must not meet the wheels of this one.
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE LD_LIBRARY_PATH PYTHONPATH PYTHONHOME
unexport AMENT_PREFIX_PATH COLCON_PREFIX_PATH RMW_IMPLEMENTATION
# pip leaves byte code to the first use. Without any each process would translate NumPy and SciPy
# again: two seconds of a processor.
unexport PYTHONDONTWRITEBYTECODE

# Folders are among them, so that a deleted file counts as a change.
SOURCES := pyproject.toml setup.py setup.cfg package.xml MANIFEST.in $(shell \
	find startracker_ros native config launch resource evaluation -not -name '*.so' -not -path '*/__pycache__*' -not -path '*.egg-info*' \
	-not -path 'evaluation/build*')
# Of the native core: without isolation pip fetches none.
WITH_COMPILER = [ -n "$$CXX" ] || $(1) native/build.py --find > /dev/null 2>&1 || { \
	echo '== compiler: the machine has none; downloads ziglang, 100 MB'; \
	$(1) -m pip install -q --disable-pip-version-check ziglang; }
# What users install, and what measures it.
PACKAGES := . ./evaluation

.PHONY: demo demo-closed-loop test test-core test-evaluation test-oldest test-newest test-long test-ros lint docs wheels clean

demo: $(VENV)/package
	@echo '== demo: six nodes on the simulated sky, a minute of it once all are ready; a bag of some 320 MB in demo'
	$(RUN) -m startracker_ros demo

demo-closed-loop: $(VENV)/package $(VENV)/gnc
	$(RUN) -m startracker_ros demo closed-loop

PYTEST := $(RUN) -m pytest -q
# Three workers: tests of nodes wait half of their time. The order is that of test/conftest.py.
ON_BOTH_CORES := -n 3 --dist loadfile --no-loadscope-reorder
# What a change has to pass.
test: $(VENV)/package $(VENV)/tests $(VENV)/gnc
	@$(PYTEST) $(ON_BOTH_CORES) -m 'not long' test

# What neither starts nodes nor takes long, to be run after each change.
test-core: $(VENV)/package $(VENV)/tests
	@$(PYTEST) $(ON_BOTH_CORES) -m 'core and not slow' test

# Campaigns, benches, faults and the closed loop, at the smallest size that shows they work.
test-evaluation: $(VENV)/package $(VENV)/tests $(VENV)/gnc
	@$(PYTEST) $(ON_BOTH_CORES) -m 'not long' test/evaluation

# The core in an environment of its own: with the oldest supported versions of what it needs, or with
# the newest of the package index. Messages are those of the wheels.
CORE_ALONE = @PYTHONSAFEPATH=1 $(<D)/bin/python -m pytest -q $(ON_BOTH_CORES) -m core test
test-oldest: .venv-oldest/package
	$(CORE_ALONE)

test-newest: .venv-newest/package
	$(CORE_ALONE)

.venv-%/package: requirements-%.txt requirements-jazzy.txt $(SOURCES)
	"$(PYTHON)" -m venv .venv-$*
	.venv-$*/bin/python -m pip install -q --disable-pip-version-check -r requirements-$*.txt -r requirements-jazzy.txt
	@$(call WITH_COMPILER,.venv-$*/bin/python)
	.venv-$*/bin/python -m pip install -q --disable-pip-version-check --no-deps --no-build-isolation $(PACKAGES)
	@touch $@

# launch_testing and the commands of ROS 2 on a full install, which is sourced; says what it leaves out.
test-ros:
	@python3 test/full_install/run.py

# The linters of ROS 2 packages, ruff, mypy and clang-tidy: a minute and a half of a processor.
lint: $(VENV)/package $(VENV)/tests
	@$(PYTEST) test/package/test_lint.py

# The documents and the reference of the library as a site: build/site/index.html. A warning fails, a
# dead link, and what is wider than its column on a phone or a screen.
docs: $(VENV)/package $(VENV)/docs $(VENV)/tests
	@rm -rf build/site
	$(RUN) -m sphinx -q -W --keep-going -E -b html -d build/doctrees docs build/site
	@$(PYTEST) test/docs

# More cases and larger sizes of what `make test` covers, and installs: before a release.
test-long: $(VENV)/package $(VENV)/tests $(VENV)/gnc $(VENV)/s3
	@$(PYTEST) $(ON_BOTH_CORES) -m long test

# For every Python and glibc 2.28 or later, and the sources they are of: dist. zig compiles them.
wheels: .venv-wheels/ready $(SOURCES)
	@rm -rf build/lib* dist
	@for processor in x86_64 aarch64; do \
		CXX="$(CURDIR)/.venv-wheels/bin/python -m ziglang c++ -target $$processor-linux-gnu.2.28" \
		.venv-wheels/bin/python -m pip wheel -q --disable-pip-version-check --no-deps --no-build-isolation -w dist \
			--config-settings=--build-option=--plat-name=manylinux_2_28_$$processor . || exit 1; done
	@.venv-wheels/bin/python -c 'from setuptools.build_meta import build_sdist; build_sdist("dist")' > /dev/null
	@ls -sh dist

.venv-wheels/ready:
	"$(PYTHON)" -m venv .venv-wheels
	.venv-wheels/bin/python -m pip install -q --disable-pip-version-check setuptools wheel ziglang
	@touch $@

$(VENV)/requirements: requirements.txt requirements-$(ROS).txt
	@"$(PYTHON)" -c '$(SUPPORTED)' 2>/dev/null || { \
		echo 'ROS 2 $(ROS) needs Python $(firstword $(PYTHONS)) or $(lastword $(PYTHONS)) with venv: make PYTHON=/path/to/python3.12$(if $(filter jazzy,$(ROS)),; with Python 3.13: make ROS=kilted)' >&2; \
		exit 1; }
	@echo '== libraries: a virtual environment in $(VENV); downloads some 270 MB, takes about a minute'
	"$(PYTHON)" -m venv $(VENV)
	$(PIP_LIBRARIES) -r requirements.txt -r requirements-$(ROS).txt
	@touch $@
	@echo "== libraries: $(VENV) has $$(du -sh $(VENV) | cut -f 1)"

$(VENV)/tests: requirements-test.txt $(VENV)/requirements
	@echo '== libraries of the tests: downloads some 200 MB more'
	$(PIP_LIBRARIES) -r requirements-test.txt
	@touch $@
	@echo "== libraries of the tests: $(VENV) has $$(du -sh $(VENV) | cut -f 1)"

$(VENV)/docs: requirements-docs.txt $(VENV)/requirements
	$(PIP_LIBRARIES) -q -r requirements-docs.txt
	@touch $@

# Without what Basilisk asks for: its limits would replace matplotlib, pillow and sgp4 by older ones,
# and the loop imports none of the others.
$(VENV)/gnc: $(VENV)/requirements requirements-gnc.txt
	$(PIP_INSTALL) --no-deps -r requirements-gnc.txt
	touch $@

# As well: python-dateutil of botocore would be an older one.
$(VENV)/s3: $(VENV)/requirements requirements-s3.txt
	$(PIP_INSTALL) --no-deps -r requirements-s3.txt
	touch $@

# Not editable: pip leaves config, launch files and node scripts out of an editable install.
$(VENV)/package: $(VENV)/requirements $(SOURCES)
	@echo '== package: builds its native core and installs it'
	@rm -rf build/lib* evaluation/build
	@$(call WITH_COMPILER,$(RUN))
	@$(RUN) native/build.py -o build/native/libstartracker.so
	$(PIP_INSTALL) --no-deps --no-build-isolation $(PACKAGES)
	@touch $@
	@echo "== package: $(VENV) has $$(du -sh $(VENV) | cut -f 1)"

clean:
	rm -rf .venv .venv-* build dist startracker_ros/core/libstartracker.so evaluation/build evaluation/*.egg-info install log demo demo_closed_loop demo_heads *.egg-info .pytest_cache .mypy_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
