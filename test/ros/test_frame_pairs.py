# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Frames of two topics are paired whatever order they come in, and none waits for ever."""

import numpy as np
from startracker_ros.ros import qos
from startracker_ros.ros.frame_pairs import FramePairs


def test_every_frame_is_paired_once_in_any_interleaving():
    rng = np.random.default_rng(5)
    for _ in range(50):
        pairs, used = FramePairs('a', 'b'), []
        queues = {'a': list(range(30)), 'b': list(range(30))}
        while queues['a'] or queues['b']:
            topic = str(rng.choice([name for name in queues if queues[name]]))
            stamp_ns = queues[topic].pop(0)
            pair = pairs.add(topic, stamp_ns, (topic, stamp_ns))
            if pair is not None:
                assert pair == (('a', stamp_ns), ('b', stamp_ns))
                used.append(stamp_ns)
        assert used == list(range(30)) and not pairs.unpaired


def test_what_has_no_partner_is_dropped_and_counted():
    pairs = FramePairs('a', 'b')
    for stamp_ns in (1, 2, 3):
        assert pairs.add('a', stamp_ns, stamp_ns) is None
    assert pairs.add('b', 2, 20) == (2, 20)
    assert pairs.unpaired == {'a': 1} and pairs.waits('a', 3) and not pairs.waits('a', 1)
    for stamp_ns in range(10, 10 + qos.LIST.depth):
        pairs.add('a', stamp_ns, stamp_ns)
    assert pairs.unpaired == {'a': 2} and not pairs.waits('a', 3)
    pairs.clear()
    assert pairs.add('b', 10, 0) is None
