# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The time from image to attitude, measured through real nodes."""

import time

import cv2
import numpy as np
import pytest
from skies import SMALL_CAMERA
from startracker_evaluation.harness import latency
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.ros.processes import HarnessError
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import SkySimulator


@pytest.fixture
def images(tmp_path):
    """Return a folder with images of one field."""
    folder = tmp_path / 'images'
    folder.mkdir()
    simulator = SkySimulator(
        SMALL_CAMERA, motion_from_options(MotionOptions(motion='inertial')),
        load_catalog(), 2026.5)
    for index in range(4):
        cv2.imwrite(str(folder / f'{index}.png'), simulator.frame(0.0).image)
    return folder


@pytest.mark.parametrize('composed', [pytest.param(False, marks=pytest.mark.long), True],
                         ids=['processes', 'composed'])
def test_every_stage_is_timed(images, tmp_path, monkeypatch, composed):
    monkeypatch.setattr(latency, '_LADDER_HZ', (5, 20))
    begin_s = time.monotonic()
    result = latency.measure(images, 12.0, tmp_path, composed=composed, rate_hz=10, count=30)
    whole_ms = 1e3 * (time.monotonic() - begin_s)
    assert list(result.stages_ms) == ['transport and decoding', *(
        ['all stages'] if composed else ['centroids', 'tracking', 'estimate'])]
    times_ms = np.array(list(result.stages_ms.values()))
    # Some are lost where other processes take the processors.
    assert times_ms.shape[1] > 0
    # The clock of DDS and ours are one: each stage takes some time, and their sum is the total.
    assert (times_ms > 0).all() and times_ms.max() < whole_ms
    np.testing.assert_allclose(times_ms.sum(axis=0), result.total_ms)
    assert len(result.camera_rate_ms) > 0 and (result.camera_rate_ms > 0).all()
    assert 0 < result.cpu_percent < 200
    # Of one process or four: more than Python with NumPy, less than twice what they have.
    assert 20 < result.memory_mib < 1000
    assert result.highest_hz in (0, 5, 10, 20)


def test_an_image_crosses_alone(images, tmp_path):
    begin_s = time.monotonic()
    times_ms = latency.crossing_ms(images, 12.0, tmp_path, rate_hz=20, count=20)
    assert 0 < len(times_ms) <= 20
    assert 0 < np.min(times_ms) <= np.max(times_ms) < 1e3 * (time.monotonic() - begin_s)


def test_a_rate_holds_where_all_come_through_at_the_pace_of_the_source():
    steady = {index: index * 100_000_000 for index in range(20)}
    assert latency._is_sustained(steady, 10, 20)
    assert not latency._is_sustained(steady, 10, 21), 'one is lost'
    slow = {index: index * 110_000_000 for index in range(20)}
    assert not latency._is_sustained(slow, 10, 20)
    late_start = {index: time_ns + 10 ** 9 * (index > 3) for index, time_ns in steady.items()}
    assert latency._is_sustained(late_start, 10, 20), 'a source makes up for a missed tick'


def test_without_nodes_there_is_a_reason(tmp_path, monkeypatch):
    monkeypatch.setattr(latency, '_START_TIMEOUT_S', 5.0)
    (tmp_path / 'images').mkdir()
    with pytest.raises(HarnessError, match='set_parameters_atomically: not within 5 s.*: see '):
        latency.measure(tmp_path / 'images', 12.0, tmp_path, composed=True, rate_hz=10, count=3)
