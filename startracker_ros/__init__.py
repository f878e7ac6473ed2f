"""Star images to spacecraft attitude: an open star tracker for ROS 2."""

__version__ = '0.1.0'
