# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The sky of the simulator is that of its first image."""

from types import SimpleNamespace

from startracker_ros.ros.nodes.sky_simulator import SkySimulatorNode

NOW_NS = 1_790_000_000_000_000_000


def test_a_sky_built_before_the_first_clock_is_built_again() -> None:
    built: list[tuple] = []
    node = SimpleNamespace(_built=('motion', 0), _build=lambda *built_of: built.append(built_of))
    SkySimulatorNode.before_first_image(node, NOW_NS)
    assert built == [('motion', NOW_NS)]
    node._built = 'motion', NOW_NS - 10 ** 9
    SkySimulatorNode.before_first_image(node, NOW_NS)
    assert len(built) == 1
