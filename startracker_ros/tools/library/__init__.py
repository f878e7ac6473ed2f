"""The public names of the package: import startracker_ros as st."""
