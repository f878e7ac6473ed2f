"""Libraries of the extras in setup.py, imported where a command needs one."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class MissingLibraryError(RuntimeError):
    """The library of an extra is not installed; the text says how to install it."""


@contextmanager
def extra(name: str, library: str, purpose: str) -> Iterator[None]:
    """Turn the failed import of a library into a MissingLibraryError that names its extra."""
    try:
        yield
    except ImportError as error:
        raise MissingLibraryError(
            f"{purpose} needs {library}: pip install 'startracker_ros[{name}]'") from error


def new_figure(**options: Any) -> Any:
    """Return a matplotlib Figure, which saves PNG files without pyplot and without a display."""
    with extra('report', 'matplotlib', 'A picture'):
        from matplotlib.figure import Figure
    return Figure(layout='constrained', **options)
