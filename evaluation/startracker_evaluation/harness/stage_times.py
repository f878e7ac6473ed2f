# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Nodes that record frame times.

python -m startracker_evaluation.harness.stage_times FILE NODE ...
Several nodes run composed in the one process. FILE becomes a .npy array of EVENT_DTYPE.
"""

from collections.abc import Callable
from pathlib import Path
import sys
import time
from typing import Any

import numpy as np
from rclpy.utilities import remove_ros_args
from startracker_ros.io.bags.layouts import ns_from_stamp
from startracker_ros.ros.node import node_class_of, PipelineNode, run

EVENT_DTYPE = np.dtype([('endpoint', 'U32'), ('stamp_ns', 'i8'), ('time_ns', 'i8')])
"""A frame at an endpoint: NODE TOPIC when a message is received, NODE sends before an image is."""


def timed(node_class: type[PipelineNode], events: list[tuple[str, int, int]], file: Path
          ) -> type[PipelineNode]:
    """Return a node class that appends to events, and writes them to a file when it ends."""
    # mypy does not support a base class that is a variable.
    class Timed(node_class):  # type: ignore[misc, valid-type]
        """Records the times of messages received and of images sent."""

        def subscribe(self, message_type: type, topic: str, callback: Callable, profile: Any,
                      **how: Any) -> None:
            endpoint = f'{self.get_name()} {topic}'

            def recorded(message: Any) -> None:
                events.append((endpoint, ns_from_stamp(message.header.stamp), time.time_ns()))
                callback(message)
            has_stamp = hasattr(message_type, 'header')
            super().subscribe(
                message_type, topic, recorded if has_stamp else callback, profile, **how)

        def publish_image(self, image: np.ndarray, camera: Any, header: Any) -> None:
            events.append((f'{self.get_name()} sends', ns_from_stamp(header.stamp),
                           time.time_ns()))
            super().publish_image(image, camera, header)

        def close(self) -> None:
            np.save(file, np.array(events, EVENT_DTYPE))
            super().close()

    Timed.__module__ = node_class.__module__
    return Timed


def main() -> int:
    """Run the nodes."""
    file, *names = remove_ros_args(sys.argv)[1:]
    events: list[tuple[str, int, int]] = []
    return run([timed(node_class_of(name), events, Path(file)) for name in names])


if __name__ == '__main__':
    sys.exit(main())
