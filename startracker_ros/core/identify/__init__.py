"""Which star is which: pattern database, search, verification."""

import sys
from types import ModuleType
from typing import Any, TYPE_CHECKING

if TYPE_CHECKING:
    from startracker_ros.core.identify.identification import Identification


class _Stage(ModuleType):
    """This folder, which the library offers as a function of the same name."""

    def __call__(self, *args: Any, **kwargs: Any) -> 'Identification':
        from startracker_ros.core.identify.one_frame import identify
        return identify(*args, **kwargs)


sys.modules[__name__].__class__ = _Stage
