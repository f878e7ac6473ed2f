# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How much memory a process takes: its shared memory, and what it gives back."""

from contextlib import suppress
import ctypes
import mmap
import os
from pathlib import Path
import sys

PROFILE_VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
"""Of Fast DDS 2 (Jazzy) and 3 (Kilted and later)."""

_IMAGES, _LISTS = 'fastdds.xml', 'fastdds_lists.xml'


def profile_variable() -> str:
    """Return the variable that the installed Fast DDS reads; later ones warn of the older."""
    prefixes = (*os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep), sys.prefix)
    # The package of Fast DDS 2 is fastrtps.
    later = any(Path(prefix, 'share', 'fastdds').is_dir() for prefix in prefixes if prefix)
    return PROFILE_VARIABLES[later]


def choose_segment(sends_images: bool) -> None:
    """Take a small segment of shared memory for a process without images; before rclpy.init()."""
    for variable in () if sends_images else PROFILE_VARIABLES:
        profile = Path(os.environ.get(variable, ''))
        if profile.name == _IMAGES and profile.with_name(_LISTS).is_file():
            os.environ[variable] = str(profile.with_name(_LISTS))


def return_free_memory() -> None:
    """
    Give back what was used to load code and to build.

    The environment of the nodes makes the C library keep the largest memory that a node has ever
    used. LLVM, which has loaded the code, keeps most of its own 80 MB mapped.
    """
    library = ctypes.CDLL(None)
    # Of glibc only.
    with suppress(AttributeError):
        library.malloc_trim(0)
    # Code is never changed: where it is used all the same, it is mapped again from its file.
    with suppress(OSError), open('/proc/self/maps') as mappings:
        for mapping in mappings:
            if ' r-xp ' in mapping and 'libllvmlite' in mapping:
                begin, end = (int(address, 16) for address in mapping.split()[0].split('-'))
                library.madvise(ctypes.c_void_p(begin), ctypes.c_size_t(end - begin),
                                mmap.MADV_DONTNEED)
