"""Errors of bags."""

CONVERT = 'on a ROS install `ros2 bag convert` makes an mcap bag of it, see docs/bags.md'
"""What to do with a bag of another storage."""


class BagError(OSError):
    """A bag cannot be written or read; the text names the file and the reason."""


class UnfinishedBagError(BagError):
    """A bag that was never closed: the process was killed or the disk was full."""
