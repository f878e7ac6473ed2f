"""How much memory a process takes: its shared memory, and what it gives back."""

from contextlib import suppress
import ctypes
import os
from pathlib import Path

_VARIABLE = 'FASTRTPS_DEFAULT_PROFILES_FILE'
_IMAGES, _LISTS = 'fastdds.xml', 'fastdds_lists.xml'


def choose_segment(sends_images: bool) -> None:
    """Take a small segment of shared memory for a process without images; before rclpy.init()."""
    profile = Path(os.environ.get(_VARIABLE, ''))
    if not sends_images and profile.name == _IMAGES and profile.with_name(_LISTS).is_file():
        os.environ[_VARIABLE] = str(profile.with_name(_LISTS))


def return_free_memory() -> None:
    """
    Give back what was used to build: the environment of the nodes makes the C library keep it.

    Without it a node keeps the largest memory that it has ever used.
    """
    # Of glibc only.
    with suppress(AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
