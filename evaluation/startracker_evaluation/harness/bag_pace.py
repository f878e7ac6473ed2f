# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How punctually bag_player publishes."""

from pathlib import Path

import numpy as np
from startracker_ros.io.bags.writer import BagWriter
from startracker_ros.ros.rig import LogFolder, Rig
from std_msgs.msg import String

_TOPIC = '/pace'
_START_NS = 10 ** 18
_STRING_CDR = bytes([0, 1, 0, 0, 12, 0, 0, 0]) + b'a message..\0'
_QUEUE = 1000
_SLOWEST = 3.0
"""A playback takes this many times its length, plus the start, at most."""


def playback_lateness_ms(rate_hz: int, seconds: int) -> np.ndarray:
    """
    Return the lateness of the messages (N,) of a playback relative to the earliest one, in ms.

    Compares the source timestamps of DDS with the times in the bag, which is recorded at a
    constant rate. HarnessError when the playback does not end.
    """
    step_ns = 10 ** 9 // rate_hz
    sent_ns: list[int] = []

    def on_message(message: String, info: dict[str, int]) -> None:
        sent_ns.append(info['source_timestamp'])

    with LogFolder('pace') as folder, Rig(folder) as rig:
        bag = folder / 'bag'
        _write_bag(bag, rate_hz * seconds, step_ns)
        rig.probe.subscribe_with_info(String, _TOPIC, on_message, _QUEUE)
        player = rig.processes.start('bag_player', {'path': str(bag)})
        rig.probe.wait(lambda: player.poll() is not None, 'end of the playback',
                       _SLOWEST * seconds + 60.0)
        # Messages that were sent last.
        rig.probe.spin_for(1.0)
    lateness_ms = (np.array(sent_ns) - np.arange(len(sent_ns)) * step_ns) * 1e-6
    return lateness_ms - lateness_ms.min()


def _write_bag(bag: Path, count: int, step_ns: int) -> None:
    with BagWriter(bag) as writer:
        writer.add_topic(_TOPIC, 'std_msgs/msg/String')
        for number in range(count):
            writer.write(_TOPIC, _STRING_CDR, _START_NS + number * step_ns, 0)
