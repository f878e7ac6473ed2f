# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""composed_pipeline [NODE ...]: nodes of the pipeline in one process, images never copied."""

import sys

from rclpy.utilities import remove_ros_args
from startracker_ros.ros.executables import NODES, STAGES, WRONG_USE
from startracker_ros.ros.node import log_fatal, node_class_of, run


def main(args: list[str] | None = None) -> None:
    """Run the named nodes, or the four stages behind a camera, in this order."""
    arguments = sys.argv if args is None else ['composed_pipeline', *args]
    try:
        names = remove_ros_args(arguments)[1:] or STAGES
        unknown = [name for name in names if name not in NODES]
        if unknown:
            raise ValueError(f'no node {unknown[0]!r}; there are {", ".join(NODES)}')
    except (RuntimeError, ValueError) as error:
        log_fatal('composed_pipeline', error)
        sys.exit(WRONG_USE)
    sys.exit(run([node_class_of(name) for name in names], args))


if __name__ == '__main__':
    main()
