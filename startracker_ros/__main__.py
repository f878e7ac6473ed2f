"""`python -m startracker_ros` is the console script `startracker`."""

from startracker_ros.tools.cli import main

main()
