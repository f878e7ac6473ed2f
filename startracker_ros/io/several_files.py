# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Work on several files: one that fails does not lose the results of the others."""

from collections.abc import Callable
from pathlib import Path
from types import TracebackType

from startracker_ros.core.extras import MissingLibraryError

# Their texts are for people; what else is raised is a fault of the program.
_NAMED = OSError, ValueError, MissingLibraryError


class OneOfSeveral:
    """
    Report why the work on one file failed, and go on after the block.

    Ctrl-C ends the work, in the native core too, and so does a reader that has left the output.
    """

    def __init__(self, report: Callable[[str], object]) -> None:
        """Take what is called with the text for a person."""
        self._report = report

    def __enter__(self) -> None:
        """Begin the work on the file."""

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 traceback: TracebackType | None) -> bool:
        """Return whether the error is reported."""
        if (not isinstance(error, Exception) or isinstance(error, BrokenPipeError)
                or isinstance(error.__cause__ or error.__context__, KeyboardInterrupt)):
            return False
        self._report(str(error) if isinstance(error, _NAMED) else _fault(error))
        return True


def _fault(error: Exception) -> str:
    """Return what to report of an error that should not be."""
    at = error.__traceback__
    while at is not None and at.tb_next is not None:
        at = at.tb_next
    place = '' if at is None else (
        f' in {Path(at.tb_frame.f_code.co_filename).name}, line {at.tb_lineno}')
    return f'a fault of startracker, please report it: {type(error).__name__}{place}: {error}'
