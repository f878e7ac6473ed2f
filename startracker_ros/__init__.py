"""
Star images to spacecraft attitude: an open star tracker for ROS 2.

The public library, import startracker_ros as st: its names load when they are first used, and
need no ROS. docs/library.md.
"""

from importlib import import_module
from typing import Any, TYPE_CHECKING

if TYPE_CHECKING:
    from startracker_ros.core.calibration.estimate import Calibration
    from startracker_ros.core.camera.model import Camera
    from startracker_ros.core.catalog.stars import load_catalog
    from startracker_ros.core.catalog.stars import StarCatalog
    from startracker_ros.core.centroid.centroids import Centroids
    from startracker_ros.core.centroid.extraction import Extraction
    from startracker_ros.core.frame_result import Attitude
    from startracker_ros.core.frame_result import FrameResult
    from startracker_ros.core.identify.identification import Identification
    from startracker_ros.core.identify.one_frame import identify
    from startracker_ros.core.stages.solution import Solution
    from startracker_ros.core.star_tracker import StarTracker
    from startracker_ros.io.images.camera_files import load_camera
    from startracker_ros.sim.simulator import SkySimulator
    from startracker_ros.tools.photographs.arrays import calibrate
    from startracker_ros.tools.photographs.arrays import extract
    from startracker_ros.tools.photographs.arrays import solve

__version__ = '1.0.0'

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
