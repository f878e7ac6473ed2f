"""
How functions are compiled, and where their machine code is kept.

The first call on a machine compiles, which takes seconds; warm_up.py does it beforehand.
Numba looks only at the file of a function to tell whether its machine code is still right,
not at the files of the functions that it calls. So the code is kept in a folder that is
named by the content of all these files.
"""

import hashlib
import os
from pathlib import Path
import tempfile
from typing import Any

from numba import config, njit

_PACKAGE = Path(__file__).parent


def _folders() -> list[Path]:
    """Return where the machine code may be kept: within the package, or with the user."""
    digest = hashlib.sha256()
    for file in sorted(_PACKAGE.rglob('*.py')):
        content = file.read_bytes()
        if b'startracker_ros.compiled' in content:
            digest.update(content)
    name = f'compiled-{digest.hexdigest()[:16]}'
    user = Path(os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache')
    return [_PACKAGE / '__pycache__' / name, user / 'startracker_ros' / name]


def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


# Numba gives its settings their names when it is loaded.
settings: Any = config
# What the user has set stays. Where nothing can be written each process compiles anew.
if not settings.CACHE_DIR:
    settings.CACHE_DIR = str(next(filter(_writable, _folders()), ''))
_kept = bool(settings.CACHE_DIR)

# Division by zero gives infinity or NaN, as in NumPy: without checks code is smaller and faster.
compiled = njit(cache=_kept, error_model='numpy')
# A product and a sum may be one instruction, rounded once: faster, but the last bits may differ
# between machines.
fused = njit(cache=_kept, error_model='numpy', fastmath={'contract'})
# Nor is the order of a sum fixed, so that several of its terms are added at once.
reordered = njit(cache=_kept, error_model='numpy', fastmath={'contract', 'reassoc'})
inlined = njit(cache=_kept, error_model='numpy', inline='always')
