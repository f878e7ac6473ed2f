"""Folders that the package writes to unasked."""

import os
from pathlib import Path
import tempfile


def cache_folder() -> Path:
    """Return the package's folder in the user's cache; XDG_CACHE_HOME is respected."""
    root = os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache'
    return Path(root) / 'startracker_ros'


def can_write(folder: Path) -> bool:
    """Return whether files can be made in a folder, by making one."""
    if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
        return False
    try:
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True
