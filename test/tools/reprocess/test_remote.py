# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bags at URLs are copied, and each failure names its URL."""

import fsspec
import pytest
from startracker_ros.io.bags.errors import BagError
from startracker_ros.tools.reprocess.plan import fetch, find_bags


@pytest.fixture
def memory():
    system = fsspec.filesystem('memory')
    for name in ('flight/one/one_0.mcap', 'flight/one/metadata.yaml', 'flight/two/two_0.mcap',
                 'flight/two/notes.doc'):
        system.pipe(f'/{name}', name.encode())
    yield system
    system.rm('/flight', recursive=True)


def test_bags_of_a_folder_a_pattern_and_a_list_are_copied(memory, tmp_path):
    copies = tmp_path / 'copies'
    one, two = find_bags(['memory://flight'], copies)
    assert (one.name, two.name) == ('one', 'two')
    assert (one / 'one_0.mcap').read_text() == 'flight/one/one_0.mcap'
    assert (one / 'metadata.yaml').is_file() and not (two / 'notes.doc').exists()
    assert find_bags(['memory://flight/t*'], tmp_path / 'other')[0].name == 'two'
    (tmp_path / 'local').mkdir()
    (tmp_path / 'local' / 'a.mcap').write_text('')
    (tmp_path / 'all.list').write_text('memory://flight/two\n\nlocal\n')
    assert {bag.name for bag in find_bags([str(tmp_path / 'all.list')], copies)} == {
        'two', 'local'}
    file, = fetch(f'file://{tmp_path}/local/a.mcap', tmp_path / 'third')
    assert file.name == 'a.mcap'


def test_whole_copies_are_kept_and_others_made_again(memory, tmp_path):
    one, = find_bags(['memory://flight/one'], tmp_path)
    file = one / 'one_0.mcap'
    before = file.stat().st_mtime_ns
    find_bags(['memory://flight/one'], tmp_path)
    assert file.stat().st_mtime_ns == before
    file.write_text('cut')
    find_bags(['memory://flight/one'], tmp_path)
    assert file.read_text() == 'flight/one/one_0.mcap'


@pytest.mark.parametrize('url', ['memory://nothing', 'memory://flight/x*', 'nosuch://a/b',
                                 'file:///nowhere/at/all'])
def test_a_url_without_a_bag_is_named(memory, tmp_path, url):
    with pytest.raises(BagError, match=url.replace('*', r'\*')):
        find_bags([url], tmp_path)
