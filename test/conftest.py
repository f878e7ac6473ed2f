# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What several tests use, and which of them run where."""

from collections.abc import Callable, Iterator
from concurrent.futures import Future
import gc
from importlib import import_module
from importlib.util import find_spec
import os
from pathlib import Path
import pickle
import signal
from types import ModuleType
from typing import Any

# Before NumPy is imported. Matrices are small here: two threads of BLAS, each of which waits in a
# loop for the other, take many times the processor time of one.
os.environ.update(OMP_NUM_THREADS='1', OPENBLAS_NUM_THREADS='1')
# The tests use more databases than a cache of the default size holds: it would drop each before
# another test needs it, and most of their processor time would be spent on building them again.
os.environ['STARTRACKER_CACHE_MB'] = '4000'

from browser import browser_page, find_chromium, Page  # noqa: E402, I100
from hypothesis import settings  # noqa: E402
import pytest  # noqa: E402

ROOT = Path(__file__).parent
SITE = ROOT.parent / 'build' / 'site'
# By the longest path that fits, unless a test is marked itself: core needs no nodes, dds starts
# some, slow takes seconds of a processor. A test of the core may be marked as slow, too. What is
# marked as long is not part of `make test`.
KINDS = {
    '': 'core',
    'io/bags/test_damage.py': 'slow',
    'native/test_native_cmake.py': 'slow',
    'docs': 'long',
    'evaluation/bench': 'slow',
    'evaluation/campaign': 'slow',
    'tools/datasheet/test_datasheet.py': 'slow',
    'nodes': 'dds',
    'nodes/test_closed_loop_demo.py': 'slow',
    'nodes/test_demo.py': 'slow',
    'nodes/test_faults.py': 'slow',
    'nodes/test_heads_demo.py': 'long',
    'nodes/test_soak.py': 'slow',
    'nodes/test_two_satellite_demo.py': 'slow',
    'package/test_install.py': 'slow',
    'package/test_lint.py': 'slow',
}
# Those that take longest, first: with several workers none is left alone with one of them.
LONGEST = (
    'nodes/test_lifecycle.py',
    'nodes/test_two_satellite_demo.py',
    'nodes/test_demo.py',
    'nodes/test_closed_loop_demo.py',
    'nodes/test_live.py',
    'nodes/test_tracking_nodes.py',
    'nodes/test_ready.py',
    'nodes/test_faults.py',
    'nodes/test_extended_grid_node.py',
    'nodes/test_paper_jpdaf.py',
    'nodes/test_bag_player.py',
    'nodes/test_managed.py',
    'nodes/test_soak.py',
    'nodes/test_false_lists.py',
    'nodes/test_fisheye_nodes.py',
    'package/test_install.py',
    'nodes/test_replay.py',
    'evaluation/campaign/test_quad_campaign.py',
    'evaluation/campaign/test_papers_campaign.py',
    'evaluation/campaign/test_hausdorff_campaign.py',
    'nodes/test_bad_input.py',
    'nodes/test_latency.py',
    'nodes/test_bad_images.py',
    'nodes/test_camera_calibrator.py',
    'nodes/test_launch_parameters.py',
    'nodes/test_target_locator.py',
    'nodes/test_attitude_fusion.py',
    'nodes/test_doctor_listens.py',
    'nodes/test_bag_recorder.py',
    'nodes/test_composition.py',
    'photographs/test_photographs.py',
    'photographs/test_solve.py',
    'core/stages/test_aberrated_stars.py',
    'core/stages/test_solution_pair.py',
    'core/camera/test_dark.py',
    'tools/catalogue/test_catalogue.py',
    'tools/report/test_page.py',
    'test_manners.py',
    'core/centroid/test_extraction.py',
    'evaluation/campaign/test_jpdaf_campaign.py',
    'evaluation/bench/test_identification_bench.py',
    'evaluation/bench/test_lost_in_space.py',
    'evaluation/campaign/test_integrity_campaign.py',
    'tools/datasheet/test_datasheet.py',
    'core/papers/test_hausdorff.py',
    'tools/reprocess/test_reprocess.py',
)
NOT_RUN = pytest.StashKey[str]()


# By the fixture that needs it: whether it is there, and how to get it.
NEEDS = {
    'site': (lambda: (SITE / 'index.html').exists(), 'of the built site: make docs'),
    'page': (lambda: find_chromium() is not None,
             'of pages, which need Chromium: apt-get install chromium'),
    'basilisk': (lambda: find_spec('Basilisk') is not None,
                 'of the closed loop, which need Basilisk: '
                 'pip install --no-deps -r requirements-gnc.txt'),
    'object_store': (lambda: None not in map(find_spec, ('moto', 's3fs')),
                     'of an object store, which need moto and s3fs: '
                     'pip install --no-deps -r requirements-s3.txt'),
}

# The machine that runs the tests is shared: no example fails for being slow, all are repeatable.
settings.register_profile('startracker', deadline=None, derandomize=True, print_blob=True)
settings.load_profile('startracker')


@pytest.fixture(scope='session')
def sky_data() -> Path:
    """Return the folder of real star images with known attitudes."""
    return ROOT / 'data'


@pytest.fixture(scope='session')
def site() -> Path:
    """Return the folder of the built site; tests that use it do not run where there is none."""
    return SITE


@pytest.fixture(scope='session')
def page() -> Iterator[Page]:
    """Return a tab of headless Chromium; tests that use it do not run where there is none."""
    with browser_page() as page:
        yield page


class InThisProcess:
    """An executor of processes that uses this one, where the package is imported already."""

    def __init__(self, *_: object, **__: object) -> None:
        pass

    def __enter__(self) -> 'InThisProcess':
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def submit(self, work: Callable, *piece: Any) -> Future:
        """Return the result of work that goes to it and comes back as to another process."""
        function, arguments = pickle.loads(pickle.dumps((work, piece)))
        done: Future = Future()
        done.set_result(pickle.loads(pickle.dumps(function(*arguments))))
        return done


@pytest.fixture(scope='module')
def one_process() -> Iterator[None]:
    """Run the pieces of campaigns and benches in this process; others test that of several."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr('startracker_ros.tools.parallel.Processes', InThisProcess)
        yield


@pytest.fixture(scope='session')
def basilisk() -> ModuleType:
    """Return the package of Basilisk, for the tests that need it."""
    return import_module('Basilisk')


def kind_of(path: Path) -> str:
    """Return the marker of a test file."""
    name = path.relative_to(ROOT).as_posix()
    return KINDS[max((part for part in KINDS if f'{name}/'.startswith(part and f'{part}/')),
                     key=len)]


@pytest.hookimpl(tryfirst=True, wrapper=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> Any:
    """Mark each test by its kind, the longest first; leave out what lacks a program."""
    ranks = {ROOT / name: rank for rank, name in enumerate(LONGEST)}
    items.sort(key=lambda item: ranks.get(item.path, len(ranks)))
    for item in items:
        if not any(item.get_closest_marker(kind) for kind in {*KINDS.values(), 'long'} - {'slow'}):
            item.add_marker(kind_of(item.path))
    result = yield
    lines = []
    for fixture, (is_there, text) in NEEDS.items():
        users = [item for item in items if fixture in getattr(item, 'fixturenames', ())]
        if users and not is_there():
            items[:] = [item for item in items if item not in users]
            config.hook.pytest_deselected(items=users)
            lines.append(f'not run: {len(users)} tests {text}')
    if lines:
        config.stash[NOT_RUN] = '\n'.join(lines)
        if hasattr(config, 'workeroutput'):
            config.workeroutput['not_run'] = config.stash[NOT_RUN]
    return result


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_collection() -> Any:
    """Let no collection of garbage search what the tests import, then or later: two seconds."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.collect()
        gc.freeze()
        gc.enable()


def pytest_configure(config: pytest.Config) -> None:
    """Take Ctrl-C: a shell starts `make test &` with it ignored, which processes inherit."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """Receive from a worker of xdist what was not run."""
    if 'not_run' in getattr(node, 'workeroutput', {}):
        node.config.stash[NOT_RUN] = node.workeroutput['not_run']


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """Report in one line what was not run, why, and how to get it."""
    if NOT_RUN in config.stash:
        terminalreporter.write_line(config.stash[NOT_RUN])
