"""
Nodes that note when each frame passes: python -m startracker_ros.harness.stage_times FILE NODE ...

Several nodes run composed in the one process. FILE becomes a .npy of (place, stamp, time).
"""

from collections.abc import Callable
from pathlib import Path
import sys
import time
from typing import Any

import numpy as np
from rclpy.utilities import remove_ros_args

from startracker_ros.bag.layouts import ns_from_stamp
from startracker_ros.ros.node import node_class_of, PipelineNode, run

PASSAGE_DTYPE = np.dtype([('place', 'U32'), ('stamp_ns', 'i8'), ('time_ns', 'i8')])
"""place is a node and what it takes, or what it is about to send."""


def timed(node_class: type[PipelineNode], passages: list[tuple[str, int, int]], file: Path
          ) -> type[PipelineNode]:
    """Return a node class that appends to passages, and writes them to a file when it ends."""
    # mypy knows no base class that is chosen at run time.
    class Timed(node_class):  # type: ignore[misc, valid-type]
        """Notes the time of what it takes and of the images that it sends."""

        def subscribe(self, message_type: type, topic: str, callback: Callable, profile: Any,
                      **how: Any) -> None:
            place = f'{self.get_name()} {topic}'

            def clocked(message: Any) -> None:
                passages.append((place, ns_from_stamp(message.header.stamp), time.time_ns()))
                callback(message)
            stamped = hasattr(message_type, 'header')
            super().subscribe(
                message_type, topic, clocked if stamped else callback, profile, **how)

        def publish_image(self, image: np.ndarray, camera: Any, header: Any) -> None:
            passages.append((f'{self.get_name()} sends', ns_from_stamp(header.stamp),
                             time.time_ns()))
            super().publish_image(image, camera, header)

        def close(self) -> None:
            np.save(file, np.array(passages, PASSAGE_DTYPE))
            super().close()

    Timed.__module__ = node_class.__module__
    return Timed


def main() -> int:
    """Run the nodes."""
    file, *names = remove_ros_args(sys.argv)[1:]
    passages: list[tuple[str, int, int]] = []
    return run([timed(node_class_of(name), passages, Path(file)) for name in names])


if __name__ == '__main__':
    sys.exit(main())
