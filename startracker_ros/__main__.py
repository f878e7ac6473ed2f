# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The command line: `startracker`, and `python -m startracker_ros`."""

from startracker_ros.core.ctrl_c import end_at_once


def main() -> None:
    """Run a command; it ends at once by Ctrl-C, while it is imported too."""
    end_at_once()
    from startracker_ros.command_line import main as run
    run()


if __name__ == '__main__':
    main()
