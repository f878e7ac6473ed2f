# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The queue in front of a bag: nothing is lost in silence."""

from pathlib import Path
import threading
import time

from limits import HANGS_S
import pytest
from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.bags.reader import read_messages
from startracker_ros.io.bags.recording import BackgroundWriter
from startracker_ros.io.bags.writer import BagWriter


class SlowWriter(BagWriter):
    """A bag on a disk that stands still until it is released, or that fails."""

    def __init__(self, folder: Path, *, fails: bool = False) -> None:
        super().__init__(folder)
        self.released = threading.Event()
        self.began = threading.Event()
        self._fails = fails

    def write(self, *message: object) -> None:
        self.began.set()
        assert self.released.wait(HANGS_S)
        if self._fails:
            raise BagError('the disk is full')
        super().write(*message)


def numbers(bag: Path, **options: object) -> list[int]:
    return [int.from_bytes(message.data[:4]) for message in read_messages(bag, **options)]


def send(writer: BackgroundWriter, number: int, size: int = 1000) -> bool:
    return writer.write('/a', number.to_bytes(4) + bytes(size - 4), number + 1, number + 1)


def test_what_finds_no_room_is_counted(tmp_path: Path) -> None:
    slow = SlowWriter(tmp_path / 'run')
    with BackgroundWriter(slow, queue_bytes=5000) as writer:
        writer.add_topic('/a', 'std_msgs/msg/Header')
        assert send(writer, 0)
        assert slow.began.wait(HANGS_S)
        # The one under way takes room, too.
        taken = [send(writer, number) for number in range(1, 10)]
        assert taken == [True] * 4 + [False] * 5
        assert writer.dropped == 5
        slow.released.set()
    assert numbers(tmp_path / 'run') == [0, 1, 2, 3, 4]


def test_a_message_larger_than_the_queue_goes_through(tmp_path: Path) -> None:
    with BackgroundWriter(BagWriter(tmp_path / 'run'), queue_bytes=10) as writer:
        writer.add_topic('/a', 'std_msgs/msg/Header')
        assert send(writer, 7)
    assert numbers(tmp_path / 'run') == [7]


def test_messages_reach_the_disk_while_no_others_follow(tmp_path: Path) -> None:
    with BackgroundWriter(BagWriter(tmp_path / 'run'), queue_bytes=10 ** 6) as writer:
        writer.add_topic('/a', 'std_msgs/msg/Header')
        for number in range(5):
            send(writer, number)
        deadline_s = time.monotonic() + HANGS_S
        while numbers(tmp_path / 'run', tolerant=True) != [0, 1, 2, 3, 4]:
            assert time.monotonic() < deadline_s
            time.sleep(0.02)


def test_a_failure_of_the_disk_is_told_and_the_rest_counted(tmp_path: Path) -> None:
    slow = SlowWriter(tmp_path / 'run', fails=True)
    with BackgroundWriter(slow, queue_bytes=10 ** 6) as writer:
        writer.add_topic('/a', 'std_msgs/msg/Header')
        for number in range(4):
            assert send(writer, number)
        slow.released.set()
        deadline_s = time.monotonic() + HANGS_S
        while writer.error is None:
            assert time.monotonic() < deadline_s
            time.sleep(0.01)
        assert str(writer.error) == 'the disk is full'
        assert not send(writer, 4)
        assert writer.dropped == 5


def test_wrong_times_do_not_stop_the_thread(tmp_path: Path) -> None:
    with BackgroundWriter(BagWriter(tmp_path / 'run'), queue_bytes=10 ** 6) as writer:
        writer.add_topic('/a', 'std_msgs/msg/Header')
        with pytest.raises(ValueError, match='are not UNIX times'):
            writer.write('/a', b'', -1, 1)
        send(writer, 3)
    assert numbers(tmp_path / 'run') == [3]
