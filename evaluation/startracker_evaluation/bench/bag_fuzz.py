# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Thousands of damaged bags: for any bytes the reader ends soon, at most with a BagError."""

from contextlib import suppress
from dataclasses import dataclass
import os
from pathlib import Path
import tempfile
import time

from mcap.writer import CompressionType, Writer
import numpy as np
from startracker_evaluation.bench.cedar_process import status_mb
from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.bags.info import describe
from startracker_ros.io.bags.qos import QosProfile
from startracker_ros.io.bags.reader import decode, read_messages
from startracker_ros.io.bags.writer import BagOptions, BagWriter
from startracker_ros.tools.parallel import parallel_map, split_trials

_TYPE = 'diagnostic_msgs/msg/DiagnosticStatus'
# An empty DiagnosticStatus: level, three empty strings, no values.
_CDR = bytes([0, 1, 0, 0, 1, 0, 0, 0, *3 * (1, 0, 0, 0, 0, 0, 0, 0), 0, 0, 0, 0])
# Lengths and counts that overflow what they are multiplied or added to.
_WORDS = (0, 1, 2 ** 31 - 1, 2 ** 31, 2 ** 32 - 1, 2 ** 32, 2 ** 40, 2 ** 62, 2 ** 63, 2 ** 64 - 1)


@dataclass(frozen=True)
class FuzzResult:
    """
    Results of damaged inputs.

    rejected: number of inputs whose strict reading ended in a BagError; wrong: any other
    failure, one text for each input; slowest_s: CPU time of the slowest; memory_mb: growth of
    the resident memory of a process over all.
    """

    inputs: int
    rejected: int
    wrong: tuple[str, ...]
    slowest_s: float
    memory_mb: float


def sound_bags() -> list[bytes]:
    """Return small MCAP files of every kind: with and without chunks, compression and CRCs."""
    files = []
    with tempfile.TemporaryDirectory() as folder:
        for compression in ('none', 'lz4', 'zstd'):
            bag = Path(folder, compression)
            with BagWriter(bag, options=BagOptions(
                    compression=compression, chunk_size_bytes=4096)) as writer:
                writer.add_topic('/state', _TYPE, [QosProfile()])
                writer.add_topic('/other', 'no_msgs/msg/Such')
                for number in range(60):
                    topic = ('/state', '/other')[number % 2]
                    writer.write(topic, _CDR, 10 ** 9 + number * 10 ** 7, 0)
            files.append(next(bag.glob('*.mcap')).read_bytes())
        for chunking in (False, True):
            for summary in (False, True):
                # Without CRCs the reader has to find the damage itself.
                path = Path(folder, f'plain_{chunking}_{summary}.mcap')
                with open(path, 'wb') as file:
                    mcap = Writer(
                        file, chunk_size=600, compression=CompressionType.NONE,
                        use_chunking=chunking, use_statistics=summary, repeat_channels=summary,
                        repeat_schemas=summary, use_summary_offsets=summary, enable_crcs=False)
                    mcap.start('ros2')
                    schema = mcap.register_schema(_TYPE, 'ros2msg', b'byte level')
                    channels = [mcap.register_channel('/state', 'cdr', schema),
                                mcap.register_channel('/json', 'json', 0)]
                    for number in range(40):
                        mcap.add_message(channels[number % 2], number * 10 ** 7, _CDR, 0)
                    mcap.finish()
                files.append(path.read_bytes())
    return files


def damage(content: bytes, rng: np.random.Generator) -> bytes:
    """Return content with one to four kinds of damage."""
    data = bytearray(content)
    for _ in range(rng.integers(1, 5)):
        if not data:
            break
        at = int(rng.integers(len(data)))
        match int(rng.integers(7)):
            case 0:
                data[at] ^= 1 << int(rng.integers(8))
            case 1:
                data[at] = int(rng.integers(256))
            case 2:
                size = int(rng.choice((2, 4, 8)))
                word = _WORDS[int(rng.integers(len(_WORDS)))] % 2 ** (8 * size)
                data[at:at + size] = word.to_bytes(size, 'little')
            case 3:
                del data[at:]
            case 4:
                del data[at:at + int(rng.integers(1, 64))]
            case 5:
                data[at:at] = rng.bytes(int(rng.integers(1, 64)))
            case _:
                begin = int(rng.integers(len(data)))
                data[at:at] = data[begin:begin + int(rng.integers(1, 400))]
    return bytes(data)


def examine(path: Path) -> bool:
    """
    Read a file in every way; return whether strict reading rejected it.

    Raises every exception that is not a BagError.
    """
    rejected = False
    try:
        for message in read_messages(path):
            if message.type_name == _TYPE:
                _decode(message.data)
    except BagError as error:
        rejected = True
        if path.name not in str(error):
            raise AssertionError(f'an error that does not name the file: {error}') from error
    problems: list[str] = []
    try:
        for _ in read_messages(path, tolerant=True, report=problems.append):
            pass
        if rejected and not problems:
            raise AssertionError('rejected by strict reading, but no problem was reported')
        describe(path)
    except BagError as error:
        if 'is not an MCAP file' not in str(error):
            raise
    return rejected


def _decode(cdr: bytes) -> None:
    with suppress(BagError):
        decode(_TYPE, cdr)


def fuzz(seed: int, inputs: int) -> FuzzResult:
    """Examine damaged files made from a seed, in this process."""
    rng = np.random.default_rng(seed)
    bags = sound_bags()
    rejected, wrong, slowest_s = 0, [], 0.0
    # In memory if possible: the disk is not under test.
    shared = Path('/dev/shm')
    folder = shared if shared.is_dir() and os.access(shared, os.W_OK) else None
    with tempfile.TemporaryDirectory(dir=folder) as scratch:
        path = Path(scratch, 'damaged.mcap')
        for bag in bags:
            path.write_bytes(bag)
            examine(path)
        # Reset the peak, which includes the imports; psutil offers neither on Linux.
        Path('/proc/self/clear_refs').write_text('5')
        before_mb = status_mb('VmHWM')
        for number in range(inputs):
            path.write_bytes(damage(bags[number % len(bags)], rng))
            begin_s = time.process_time()
            try:
                rejected += examine(path)
            except Exception as error:
                wrong.append(f'seed {seed}, input {number}: {type(error).__name__}: {error}')
            slowest_s = max(slowest_s, time.process_time() - begin_s)
    return FuzzResult(inputs, rejected, tuple(wrong), slowest_s, status_mb('VmHWM') - before_mb)


def fuzz_in_processes(seed: int, inputs: int) -> FuzzResult:
    """Examine damaged files on all cores."""
    results: list[FuzzResult] = parallel_map(
        fuzz, [(part_seed, count) for count, part_seed in split_trials(inputs, 1000, seed)],
        title='damaged bags')
    return FuzzResult(
        sum(result.inputs for result in results), sum(result.rejected for result in results),
        sum((result.wrong for result in results), ()),
        max(result.slowest_s for result in results), max(result.memory_mb for result in results))
