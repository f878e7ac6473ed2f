"""What killed nodes leave in shared memory is removed, what living ones hold is not."""

import fcntl
import os

from startracker_ros.ros.shared_memory import remove_left_behind


def make(folder, name, age_s):
    (folder / name).write_bytes(bytes(1000))
    lock = folder / f'{name}_el'
    lock.touch()
    os.utime(lock, times=(lock.stat().st_mtime - age_s,) * 2)
    return lock


def test_segments_of_the_dead_are_removed(tmp_path):
    living = make(tmp_path, 'fastrtps_0123456789abcdef', 100)
    make(tmp_path, 'fastrtps_1123456789abcdef', 100)
    make(tmp_path, 'fastrtps_2123456789abcdef', 1)
    make(tmp_path, 'fastrtps_port7411', 100)
    (tmp_path / 'another').touch()
    with open(living) as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        assert remove_left_behind(tmp_path) == 1000
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        'another', 'fastrtps_0123456789abcdef', 'fastrtps_0123456789abcdef_el',
        'fastrtps_2123456789abcdef', 'fastrtps_2123456789abcdef_el',
        'fastrtps_port7411', 'fastrtps_port7411_el']
