"""
Where the machine code of compiled functions is kept.

Numba looks only at the file of a function to tell whether its machine code is still right,
not at the files of the functions that it calls. So the code is kept in a folder that is
named by the content of all these files. Numba itself is not needed to know which: its import takes
longer than many a start.
"""

from functools import cache
import hashlib
import os
from pathlib import Path

from startracker_ros.folders import cache_folder, can_write

_PACKAGE = Path(__file__).parent


@cache
def machine_code_folder() -> str:
    """Return NUMBA_CACHE_DIR, or a folder that can be written; empty where there is none."""
    return os.environ.get('NUMBA_CACHE_DIR') or str(next(filter(_writable, _folders()), ''))


def cached_functions(folder: str) -> int:
    """Return of how many functions a folder holds the machine code."""
    return sum(1 for _ in Path(folder).rglob('*.nbi')) if folder else 0


def _folders() -> list[Path]:
    """Return where the machine code may be kept: within the package, or with the user."""
    digest = hashlib.sha256()
    for file in sorted(_PACKAGE.rglob('*.py')):
        content = file.read_bytes()
        if file.name == 'compiled.py' or b'startracker_ros.compiled' in content:
            digest.update(content)
    name = f'compiled-{digest.hexdigest()[:16]}'
    return [_PACKAGE / '__pycache__' / name, cache_folder() / name]


def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return can_write(folder)
