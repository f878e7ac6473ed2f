# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bags under test: damaged, read beside the mcap library, played at a pace, recorded."""

from collections.abc import Sequence
import os
from pathlib import Path
import tempfile
import time

import numpy as np
from startracker_evaluation.bench.bag_fuzz import fuzz_in_processes
from startracker_evaluation.bench.bag_read import read_figures
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.io.bags.writer import BagOptions, BagWriter
from startracker_ros.io.table import Result
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import SkySimulator
from startracker_ros.tools.figures.machine import machine
from startracker_ros.tools.figures.rows import Row

CASES = ('damage', 'read', 'pace', 'record')

_RATE_HZ = 100
_SECONDS = 20
_IMAGES = 50


def run_bag_bench(*, inputs: int, seed: int, only: Sequence[str] = CASES) -> Result:
    """Return the rows of the chosen cases."""
    rows: list[Row] = []
    if 'damage' in only:
        rows += _damage_rows(inputs, seed)
    if 'read' in only:
        rows += [Row(*figure) for figure in read_figures(_images(), seed)]
    if 'pace' in only:
        rows += _pace_rows()
    if 'record' in only:
        rows += _record_rows()
    return Result('bench bag', rows, {
        'machine': machine(f'load {os.getloadavg()[0]:.1f}'),
        'damage': 'strict and tolerant reading of each; times are process CPU time',
        'read': '100 images of 2.1 MB among 1000 rates, 50,000 messages of 20 bytes, zstd in '
                'chunks of 1 MiB; process CPU time, traced memory at its peak',
        'pace': f'{_RATE_HZ} messages a second of 20 bytes for {_SECONDS} s, stamped by DDS when '
                'bag_player sent them, beside the times of the recording',
        'record': '1024 x 1024 px, mono16 (12 bit), 12 deg field; process CPU time',
        'seed': seed})


def _damage_rows(inputs: int, seed: int) -> list[Row]:
    result = fuzz_in_processes(seed, inputs)
    for text in result.wrong[:20]:
        print(text)
    return [
        Row('damaged bags read', result.inputs, 'files'),
        Row('rejected, clear error', result.rejected, 'files'),
        Row('anything else went wrong', len(result.wrong), 'files', exactly=0),
        Row('slowest file', 1e3 * result.slowest_s, 'ms', most=1000),
        Row('growth of memory', result.memory_mb, 'MB', most=300)]


def _pace_rows() -> list[Row]:
    from startracker_evaluation.harness.bag_pace import playback_lateness_ms
    lateness_ms = playback_lateness_ms(_RATE_HZ, _SECONDS)
    p50, p95 = np.percentile(lateness_ms, (50, 95))
    count = _RATE_HZ * _SECONDS
    return [
        Row('played messages received', len(lateness_ms), 'messages', exactly=count),
        Row('pacing error, p50', p50, 'ms'),
        Row('pacing error, p95', p95, 'ms', most=2)]


def _images() -> list[bytes]:
    simulator = SkySimulator(Camera.from_fov(1024, 1024, 12.0),
                             motion_from_options(MotionOptions()), load_catalog(), 2026.7)
    return [simulator.frame(0.1 * number).image.tobytes() for number in range(5)]


def _record_rows() -> list[Row]:
    images, rows = _images(), []
    for compression in ('none', 'lz4', 'zstd'):
        with tempfile.TemporaryDirectory() as folder:
            bag = Path(folder, 'bag')
            with BagWriter(bag, options=BagOptions(compression=compression)) as writer:
                writer.add_topic('/image_raw', 'sensor_msgs/msg/Image')
                begin_s = time.process_time()
                for number in range(_IMAGES):
                    writer.write('/image_raw', images[number % len(images)], number * 10 ** 8, 0)
                spent_s = time.process_time() - begin_s
            size = sum(path.stat().st_size for path in bag.glob('*.mcap'))
        rows += [Row(f'{compression}: an image written', 1e3 * spent_s / _IMAGES, 'ms'),
                 Row(f'{compression}: size of an image', size / _IMAGES / 1e6, 'MB')]
    return rows
