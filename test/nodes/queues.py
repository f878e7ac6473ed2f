# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Queues that hold every message of a test, however long a node is busy."""

DEPTH = 100


def deep_queues(*ends: str) -> dict[str, int]:
    """Return the parameters of deep queues at ends such as image_raw.subscription."""
    return {f'qos_overrides./{end}.depth': DEPTH for end in ends}
