"""
Star images to spacecraft attitude: an open star tracker for ROS 2.

The public library, import startracker_ros as st: its names load when they are first used, and
need no ROS. docs/library.md.
"""

from importlib import import_module
from typing import Any, TYPE_CHECKING

if TYPE_CHECKING:
    from startracker_ros.calibration.estimate import Calibration
    from startracker_ros.camera.files import load_camera
    from startracker_ros.camera.model import Camera
    from startracker_ros.catalog.stars import load_catalog
    from startracker_ros.catalog.stars import StarCatalog
    from startracker_ros.centroid.centroids import Centroids
    from startracker_ros.centroid.extraction import Extraction
    from startracker_ros.identify.identification import Identification
    from startracker_ros.identify.one_frame import identify
    from startracker_ros.library.frame_result import Attitude
    from startracker_ros.library.frame_result import FrameResult
    from startracker_ros.library.images import calibrate
    from startracker_ros.library.images import extract
    from startracker_ros.library.images import solve
    from startracker_ros.library.simulator import SkySimulator
    from startracker_ros.library.star_tracker import StarTracker
    from startracker_ros.pipeline.solution import Solution

__version__ = '0.1.0'

_MODULES = {
    'Attitude': 'library.frame_result', 'Calibration': 'calibration.estimate',
    'Camera': 'camera.model', 'Centroids': 'centroid.centroids',
    'Extraction': 'centroid.extraction', 'FrameResult': 'library.frame_result',
    'Identification': 'identify.identification', 'SkySimulator': 'library.simulator',
    'Solution': 'pipeline.solution', 'StarCatalog': 'catalog.stars',
    'StarTracker': 'library.star_tracker', 'calibrate': 'library.images',
    'extract': 'library.images', 'identify': '', 'load_camera': 'camera.files',
    'load_catalog': 'catalog.stars', 'solve': 'library.images'}
# In full, for what reads the source alone.
__all__ = [
    'Attitude', 'Calibration', 'Camera', 'Centroids', 'Extraction', 'FrameResult',
    'Identification', 'SkySimulator', 'Solution', 'StarCatalog', 'StarTracker', 'calibrate',
    'extract', 'identify', 'load_camera', 'load_catalog', 'solve']


def __getattr__(name: str) -> Any:
    """Return a public name, loaded from its module."""
    if name not in _MODULES:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    if name == 'identify':
        # The folder of this name can be called.
        return import_module(f'{__name__}.{name}')
    value = getattr(import_module(f'{__name__}.{_MODULES[name]}'), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted({*globals(), *_MODULES})
