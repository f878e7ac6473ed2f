# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What killed nodes leave in shared memory is removed, what living ones hold is not."""

import fcntl
import os

import pytest
from startracker_ros.ros.memory import remove_left_behind


def make(folder, name, age_s):
    (folder / name).write_bytes(bytes(1000))
    lock = folder / f'{name}_el'
    lock.touch()
    os.utime(lock, times=(lock.stat().st_mtime - age_s,) * 2)
    return lock


# Of Fast DDS 2 and 3.
@pytest.mark.parametrize('prefix', ['fastrtps', 'fastdds'])
def test_segments_of_the_dead_are_removed(tmp_path, prefix):
    living = make(tmp_path, f'{prefix}_0123456789abcdef', 100)
    make(tmp_path, f'{prefix}_1123456789abcdef', 100)
    make(tmp_path, f'{prefix}_2123456789abcdef', 1)
    make(tmp_path, f'{prefix}_port7411', 100)
    (tmp_path / 'another').touch()
    with open(living) as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        assert remove_left_behind(tmp_path) == 1000
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        'another', f'{prefix}_0123456789abcdef', f'{prefix}_0123456789abcdef_el',
        f'{prefix}_2123456789abcdef', f'{prefix}_2123456789abcdef_el',
        f'{prefix}_port7411', f'{prefix}_port7411_el']
