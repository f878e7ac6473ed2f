# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bags under test: damaged, read compared with the mcap library, played at a pace, recorded."""

from collections.abc import Callable, Iterator, Mapping, Sequence
import os
from pathlib import Path
import tempfile
import time
import tracemalloc

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
import numpy as np
from startracker_evaluation.bench.bag_fuzz import damage, fuzz_in_processes, sound_bags
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.bags.reader import read_messages
from startracker_ros.io.bags.writer import BagOptions, BagWriter
from startracker_ros.io.table import Result
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import SkySimulator
from startracker_ros.tools.figures.machine import machine
from startracker_ros.tools.figures.rows import Row

# --- whole bags read by our reader and by that of the mcap library ---

_READ_IMAGES = 100
_SMALL_MESSAGES = 50_000
_START_NS = 10 ** 18
_DAMAGED = 1000
# More than one chunk may unpack to.
_LARGE_BYTES = 300 * 2 ** 20

Reader = Callable[[Path, int], Iterator[bytes]]
"""Yields the data of the messages of a file from a log time on, in ns."""


def _ours(path: Path, start_ns: int) -> Iterator[bytes]:
    for message in read_messages(path, start_ns=start_ns):
        yield message.data


def _library(path: Path, start_ns: int) -> Iterator[bytes]:
    with open(path, 'rb') as file:
        for _, _, message in make_reader(file, validate_crcs=True).iter_messages(
                starting_at=start_ns):
            yield message.data


_READERS: Mapping[str, tuple[Reader, type[Exception]]] = {
    'ours': (_ours, BagError), 'mcap library': (_library, McapError)}


def read_figures(images: list[bytes], seed: int) -> Iterator[tuple[str, float, str]]:
    """Yield case, figure and unit; images are what the image bag repeats."""
    with tempfile.TemporaryDirectory() as folder:
        bags = {'images': _image_bag(Path(folder, 'images'), images),
                'small messages': _small_bag(Path(folder, 'small'))}
        large = _large_chunk(Path(folder, 'large.mcap'))
        for name, (read, error) in _READERS.items():
            for kind, path in bags.items():
                yield from _speed(f'{kind}, {name}', read, path)
            yield (f'300 MiB of zeros in one chunk, {name}: memory',
                   _peak_mb(read, large, error), 'MB')
            yield from _robustness(name, read, error, Path(folder, 'damaged.mcap'), seed)


def _speed(name: str, read: Reader, path: Path) -> Iterator[tuple[str, float, str]]:
    begin_s = time.process_time()
    sizes = [len(data) for data in read(path, 0)]
    spent_s = time.process_time() - begin_s
    yield f'{name}: read', len(sizes) / spent_s, 'messages/s'
    yield f'{name}: read', sum(sizes) / spent_s / 1e6, 'MB/s'
    middle_ns = _START_NS + len(sizes) // 2 * 10 ** 7
    first_s = []
    for _ in range(5):
        begin_s = time.process_time()
        next(read(path, middle_ns))
        first_s.append(time.process_time() - begin_s)
    yield f'{name}: first message from the middle', 1e3 * min(first_s), 'ms'
    yield f'{name}: memory', _peak_mb(read, path, BagError), 'MB'


def _peak_mb(read: Reader, path: Path, error: type[Exception]) -> float:
    tracemalloc.start()
    try:
        for _ in read(path, 0):
            pass
    except error:
        # The file is rejected; what it cost until then counts.
        pass
    peak_mb = tracemalloc.get_traced_memory()[1] / 1e6
    tracemalloc.stop()
    return peak_mb


def _robustness(name: str, read: Reader, error: type[Exception], path: Path, seed: int
                ) -> Iterator[tuple[str, float, str]]:
    rng = np.random.default_rng(seed)
    bags = sound_bags()

    def outcome(content: bytes) -> str:
        path.write_bytes(content)
        try:
            for _ in read(path, 0):
                pass
        except error:
            return 'rejected'
        except Exception:
            return 'other error'
        return 'read'
    sound = [outcome(bag) for bag in bags]
    yield f'{len(bags)} kinds of sound file, {name}: read', sound.count('read'), 'files'
    damaged = [outcome(damage(bags[number % len(bags)], rng)) for number in range(_DAMAGED)]
    yield f'{_DAMAGED} damaged files, {name}: rejected', damaged.count('rejected'), 'files'
    yield f'{_DAMAGED} damaged files, {name}: other errors', damaged.count('other error'), 'files'


def _image_bag(folder: Path, images: list[bytes]) -> Path:
    """Write images among ten rates each, 100 messages a second."""
    with BagWriter(folder) as writer:
        writer.add_topic('/image_raw', 'sensor_msgs/msg/Image')
        writer.add_topic('/rate', 'sensor_msgs/msg/Imu')
        for number in range(10 * _READ_IMAGES):
            stamp_ns = _START_NS + number * 10 ** 7
            if number % 10 == 0:
                writer.write('/image_raw', images[number // 10 % len(images)], stamp_ns, 0)
            writer.write('/rate', bytes(320), stamp_ns, 0)
    return next(folder.glob('*.mcap'))


def _small_bag(folder: Path) -> Path:
    with BagWriter(folder) as writer:
        writer.add_topic('/count', 'std_msgs/msg/String')
        for number in range(_SMALL_MESSAGES):
            writer.write('/count', b'%020d' % number, _START_NS + number * 10 ** 7, 0)
    return next(folder.glob('*.mcap'))


def _large_chunk(path: Path) -> Path:
    with open(path, 'wb') as file:
        writer = Writer(file, chunk_size=2 ** 30, compression=CompressionType.ZSTD)
        writer.start('ros2')
        writer.add_message(writer.register_channel('/zeros', 'cdr', 0), 1, bytes(_LARGE_BYTES), 1)
        writer.finish()
    return path


# --- the cases ---

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
                'bag_player sent them, next to the times of the recording',
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
