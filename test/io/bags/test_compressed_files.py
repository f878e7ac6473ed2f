# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bags whose files are compressed as a whole, as rosbag2 does with --compression-mode file."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores
from startracker_ros.io.bags import storage
from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.bags.info import describe
from startracker_ros.io.bags.reader import read_messages, read_span_ns, read_topics
from startracker_ros.io.bags.writer import BagOptions, BagWriter
import zstandard

COUNT = 100


def numbers(path: Path, **options: object) -> list[int]:
    return [message.data[0] for message in read_messages(path, **options)]


@pytest.fixture
def packed(tmp_path: Path) -> Path:
    """Return a bag without metadata, of one file that is compressed as a whole."""
    folder, noise = tmp_path / 'run', np.random.default_rng(3)
    with BagWriter(folder, options=BagOptions(chunk_size_bytes=4096,
                                              compression='none')) as writer:
        writer.add_topic('/a', 'std_msgs/msg/Header')
        for number in range(COUNT):
            writer.write('/a', bytes([number]) + noise.bytes(5000), number * 10 ** 8, 0)
    (folder / 'metadata.yaml').unlink()
    file = folder / 'run_0.mcap'
    (folder / 'run_0.mcap.zstd').write_bytes(zstandard.compress(file.read_bytes()))
    file.unlink()
    return folder


def test_a_bag_of_another_writer_is_read(tmp_path: Path) -> None:
    folder, typestore = tmp_path / 'run', get_typestore(Stores.ROS2_JAZZY)
    writer = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.FILE, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection('/a', 'std_msgs/msg/Header', typestore=typestore)
        for number in range(COUNT):
            writer.write(connection, number, bytes([number]) * 200)
    assert [path.name for path in folder.iterdir() if '.mcap' in path.name] == ['run.mcap.zstd']
    assert numbers(folder) == list(range(COUNT))
    assert read_span_ns(folder) == (0, COUNT - 1)


def test_the_whole_file_is_read_by_folder_and_by_name(packed: Path) -> None:
    for path in (packed, packed / 'run_0.mcap.zstd'):
        assert numbers(path) == list(range(COUNT))
        assert read_topics(path)['/a'].message_count == COUNT
    result, problems = describe(packed)
    assert problems == [] and result.conditions['compression'] == 'zstd, whole files'


def test_what_is_left_of_a_cut_file_is_read(packed: Path) -> None:
    file = packed / 'run_0.mcap.zstd'
    content = file.read_bytes()
    file.write_bytes(content[:len(content) // 2])
    with pytest.raises(BagError, match='was not finished'):
        numbers(packed)
    problems: list[str] = []
    read = numbers(packed, tolerant=True, report=problems.append)
    assert read == list(range(len(read))) and 20 < len(read) < 60 and len(problems) == 1


@pytest.mark.parametrize('tolerant', [False, True])
def test_bytes_that_are_not_zstd_or_no_mcap_are_rejected(packed: Path, tolerant: bool) -> None:
    file = packed / 'run_0.mcap.zstd'
    content = bytearray(file.read_bytes())
    content[4:40] = b'\xff' * 36
    file.write_bytes(content)
    with pytest.raises(BagError, match='cannot unpack .*run_0'):
        numbers(packed, tolerant=tolerant)
    file.write_bytes(zstandard.compress(b'something else'))
    with pytest.raises(BagError, match="is not an MCAP file: it starts with b'somethin'"):
        numbers(packed, tolerant=tolerant)


def test_a_file_that_would_fill_the_disk_is_rejected(
        packed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(storage.shutil, 'disk_usage',
                        lambda folder: SimpleNamespace(free=20_000))
    with pytest.raises(BagError, match='cannot unpack .*half of the free space'):
        numbers(packed)
