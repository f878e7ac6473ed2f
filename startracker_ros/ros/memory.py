"""How much memory a process takes: its shared memory, and what it gives back."""

from contextlib import suppress
import ctypes
import mmap
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
