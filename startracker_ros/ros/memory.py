"""How much memory a process takes: its shared memory, and what it gives back."""

from contextlib import suppress
import ctypes
import os
from pathlib import Path

PROFILE_VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
"""Of Fast DDS 2 (Jazzy) and 3 (Kilted and later)."""

_IMAGES, _LISTS = 'fastdds.xml', 'fastdds_lists.xml'


def choose_segment(sends_images: bool) -> None:
    """Take a small segment of shared memory for a process without images; before rclpy.init()."""
    for variable in () if sends_images else PROFILE_VARIABLES:
        profile = Path(os.environ.get(variable, ''))
        if profile.name == _IMAGES and profile.with_name(_LISTS).is_file():
            os.environ[variable] = str(profile.with_name(_LISTS))


def return_free_memory() -> None:
    """
    Give back what was used to build: the environment of the nodes makes the C library keep it.

    Without it a node keeps the largest memory that it has ever used.
    """
    # Of glibc only.
    with suppress(AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
