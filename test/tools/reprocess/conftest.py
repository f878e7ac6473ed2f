# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A short flight, and the engine without processes."""

from collections import Counter
from contextlib import contextmanager
import shutil

import pytest
from startracker_ros.core.stages.parameters import StarTrackerOptions
from startracker_ros.sim.flights.bags import write_bag
from startracker_ros.sim.flights.options import FlightOptions
from startracker_ros.tools.reprocess import run
from startracker_ros.tools.reprocess.output import chosen_topics
from startracker_ros.tools.reprocess.parameters import ParameterSet
from startracker_ros.tools.reprocess.plan import SegmentOptions

FLIGHT = FlightOptions(days=0.0015, bag_hours=1.0, heads=1, magnitude_limit=5.5, fov_deg=15.0,
                       start_utc_s=1_767_225_600.0)
calls: Counter[str] = Counter()


@pytest.fixture(scope='session')
def flight(tmp_path_factory):
    """Return the folder of a flight of 130 s with one head and truth."""
    folder = tmp_path_factory.mktemp('flight')
    write_bag(folder, FLIGHT, 1, 0)
    return folder


@contextmanager
def no_cluster(workers, scheduler=''):
    yield workers


def in_reverse(client, function, tasks):
    """Run the tasks here; with two workers in reverse order, as they may end."""
    order = list(enumerate(tasks))
    for number, task in order[::-1] if client > 1 else order:
        calls[function.__name__] += 1
        try:
            yield number, function(*task)
        except Exception as error:
            yield number, error


@pytest.fixture(scope='session')
def reprocess():
    """Return a function that reprocesses bags into a folder, in this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, 'cluster', no_cluster)
        patch.setattr(run, 'completed', in_reverse)

        def call(bags, folder, workers=1, segment_s=60.0, sets=None, **options):
            settings = {'bag_topics': chosen_topics(['*']), 'smooth': False, 'source': '',
                        **options}
            return run.reprocess(run.Request(
                [str(bag) for bag in bags], folder,
                segments=SegmentOptions(segment_s=segment_s, overlap_s=15.0),
                sets=sets or [ParameterSet('', StarTrackerOptions(), {})], **settings),
                workers=workers)
        yield call


@pytest.fixture(scope='session')
def finished_run(flight, reprocess, tmp_path_factory):
    """Return the folder and the result of a run with smoothing."""
    folder = tmp_path_factory.mktemp('run')
    result = reprocess([flight], folder, smooth=True)
    return folder, result


@pytest.fixture
def copied_run(finished_run, tmp_path):
    """Return a copy of that run, to be damaged."""
    return shutil.copytree(finished_run[0], tmp_path / 'copy')
