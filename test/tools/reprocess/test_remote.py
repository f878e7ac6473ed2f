# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bags at URLs are read where they are, no more of them than is needed; failures name the URL."""

import struct

import fsspec
from mcap.writer import CompressionType, Writer
import pytest
from startracker_evaluation.bench.constellation import write_sparse_bag
from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.bags.mcap_file import McapFile
from startracker_ros.io.bags.reader import read_messages, read_topics
from startracker_ros.io.bags.remote import counted, remote_bags, StoreError
from startracker_ros.tools.reprocess.plan import bag_names, find_bags
from test_reprocess import errors, hashes


@pytest.fixture
def memory(flight):
    system = fsspec.filesystem('memory')
    folder, = flight.glob('flight_*')
    for path in folder.iterdir():
        system.pipe(f'/flight/{folder.name}/{path.name}', path.read_bytes())
    system.pipe('/flight/two/two_0.mcap', b'no bag')
    system.pipe('/flight/two/notes.doc', b'text')
    yield system
    system.rm('/flight', recursive=True)


@pytest.mark.slow
def test_a_flight_in_a_store_is_that_of_a_folder(memory, flight, reprocess, finished_run,
                                                 tmp_path):
    result = reprocess(['memory://flight'], tmp_path, smooth=True)
    assert hashes(tmp_path) == hashes(finished_run[0])
    assert [row['bag'] for row in errors(tmp_path)] == ['two']
    assert result.conditions['not_processed'] == 'two'
    size = sum(path.stat().st_size for path in flight.glob('flight_*/*.mcap'))
    # As a whole for the plan, three times, and for each of the segments; metadata.yaml as often.
    assert 6 * size < 1e6 * result.conditions['store_mb'] < 7 * size + 8 * 5000
    again = reprocess(['memory://flight'], tmp_path, smooth=True)
    assert again.records[0]['reused'] == 3
    bag, = flight.glob('flight_*')
    memory.pipe(f'/flight/{bag.name}/{bag.name}_0.mcap', next(bag.glob('*.mcap')).read_bytes())
    assert reprocess(['memory://flight'], tmp_path, smooth=True).records[0]['reused'] == 0


def test_bags_of_a_folder_a_pattern_a_list_and_a_file(memory, tmp_path):
    one, two = find_bags(['memory://flight'])
    assert {file.name for file in one.files} == {f'{one.name}_0.mcap', 'metadata.yaml'}
    assert [file.name for file in two.files] == ['two_0.mcap']
    assert bag_names([one, two]) == [one.name, 'two']
    assert find_bags(['memory://flight/t*']) == [two]
    (tmp_path / 'local').mkdir()
    (tmp_path / 'local' / 'a.mcap').write_text('')
    (tmp_path / 'all.list').write_text('memory://flight/two\n\nlocal\n')
    assert [bag.name for bag in find_bags([str(tmp_path / 'all.list')])] == ['local', 'two']
    file, = find_bags([f'file://{tmp_path}/local/a.mcap'])
    assert file.name == 'a.mcap' and not file.is_dir()


@pytest.mark.parametrize('url', ['memory://nothing', 'memory://flight/x*', 'nosuch://a/b',
                                 'file:///nowhere/at/all'])
def test_a_url_without_a_bag_is_named(memory, url):
    with pytest.raises(BagError, match=url.replace('*', r'\*')):
        find_bags([url])


def test_a_store_that_fails_is_not_damage(memory, reprocess, tmp_path, monkeypatch):
    def fail(*_, **__):
        raise TimeoutError('no answer')
    bag, _ = find_bags(['memory://flight'])
    messages = read_messages(bag, tolerant=True)
    next(messages)
    monkeypatch.setattr(type(memory), 'cat_file', fail)
    with pytest.raises(StoreError, match='flight_.*no answer'):
        next(read_messages(bag, tolerant=True))
    with pytest.raises(OSError, match='nothing to process: .*no answer'):
        reprocess(['memory://flight'], tmp_path)


def test_a_file_that_is_another_one_by_now_is_not_damage(memory):
    bag, _ = find_bags(['memory://flight'])
    memory.pipe(f'/flight/{bag.name}/{bag.name}_0.mcap', b'short')
    with pytest.raises(StoreError, match='not the file that was listed'):
        read_topics(bag)


@pytest.mark.slow
def test_of_50_gb_only_the_index_and_the_chunks_of_the_star_tracker_are_read(
        flight, reprocess, finished_run, tmp_path):
    bag, = flight.glob('flight_*')
    path = tmp_path / 'sparse' / bag.name / f'{bag.name}_0.mcap'
    path.parent.mkdir(parents=True)
    images = write_sparse_bag(next(bag.glob('*.mcap')), path, 50 * 10 ** 9, 10 ** 7)
    assert path.stat().st_size > 50 * 10 ** 9
    assert read_topics(path.parent)['/camera/image_raw'].message_count == images
    result = reprocess([f'file://{tmp_path}/sparse'], tmp_path / 'run', smooth=True)
    assert hashes(tmp_path / 'run') == hashes(finished_run[0])
    assert result.conditions['store_mb'] < 20


@pytest.fixture
def chunks(tmp_path):
    """Return a file of three chunks with a message and a metadata record before each."""
    with open(tmp_path / 'a.mcap', 'wb') as file:
        writer = Writer(file, compression=CompressionType.NONE, chunk_size=1)
        writer.start()
        channel = writer.register_channel('/a', 'cdr', 0)
        for k in range(3):
            writer.add_metadata(f'{k}', {'a': 'b' * 70_000})
            writer.add_message(channel, 10 + k, bytes(100_000), 10 + k)
        writer.finish()
    return tmp_path / 'a.mcap'


def blocks(path):
    bag, = remote_bags(f'file://{path}')
    with McapFile(bag) as file, counted() as traffic:
        messages = [(m.log_time_ns, len(m.data)) for m in file.intact_messages(lambda _: None)]
        return file.is_sound, file.blocks_ns, messages, traffic.bytes


def test_blocks_by_the_index_are_those_of_the_heads(chunks):
    sound, spans, messages, size = blocks(chunks)
    with McapFile(chunks) as file:
        assert sound and file.is_sound and spans == file.blocks_ns
    assert messages == [(10 + k, 100_000) for k in range(3)] and size < 1e6


@pytest.mark.parametrize('wrong', [0, 5, 2 ** 63])
def test_an_index_that_is_wrong_is_damage_or_not_used(chunks, wrong):
    data = bytearray(chunks.read_bytes())
    with McapFile(chunks) as file:
        length = file._blocks[1].length + 9
    # The length of the second chunk in its record of the index, and no CRC.
    at = data.rindex(struct.pack('<Q', length))
    data[at:at + 8] = struct.pack('<Q', wrong)
    data[-12:-8] = bytes(4)
    chunks.write_bytes(data)
    sound, _, messages, _ = blocks(chunks)
    assert not sound or messages == [(10 + k, 100_000) for k in range(3)]
