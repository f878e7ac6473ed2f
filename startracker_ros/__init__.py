# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Star images to spacecraft attitude: an open star tracker for ROS 2.

The public library, import startracker_ros as st: its names load when they are first used, and
need no ROS. docs/library.md.
"""

from importlib import import_module
from typing import Any, TYPE_CHECKING

if TYPE_CHECKING:
    from startracker_ros.core.calibration.adjustment import CalibrationError
    from startracker_ros.core.calibration.estimate import Calibration
    from startracker_ros.core.camera.model import Camera
    from startracker_ros.core.camera.model import CameraError
    from startracker_ros.core.catalog.stars import load_catalog
    from startracker_ros.core.catalog.stars import StarCatalog
    from startracker_ros.core.centroid.centroids import Centroids
    from startracker_ros.core.centroid.extraction import Extraction
    from startracker_ros.core.frame_result import Attitude
    from startracker_ros.core.frame_result import FrameResult
    from startracker_ros.core.identify.identification import CandidateIdentifier
    from startracker_ros.core.identify.identification import Candidates
    from startracker_ros.core.identify.identification import Identification
    from startracker_ros.core.identify.one_frame import identify
    from startracker_ros.core.star_tracker import StarTracker
    from startracker_ros.io.images.camera_files import load_camera
    from startracker_ros.io.images.images import ImageError
    from startracker_ros.io.star_tables import CatalogueError
    from startracker_ros.photographs.arrays import calibrate
    from startracker_ros.photographs.arrays import extract
    from startracker_ros.photographs.arrays import solve
    from startracker_ros.photographs.sip import WcsError
    from startracker_ros.photographs.solution import NoSolutionError
    from startracker_ros.photographs.solution import Solution
    from startracker_ros.sim.simulator import SkySimulator

__version__ = '1.0.0'

_MODULES = {
    'Attitude': 'core.frame_result',
    'Calibration': 'core.calibration.estimate',
    'CalibrationError': 'core.calibration.adjustment',
    'Camera': 'core.camera.model',
    'CameraError': 'core.camera.model',
    'CandidateIdentifier': 'core.identify.identification',
    'Candidates': 'core.identify.identification',
    'CatalogueError': 'io.star_tables',
    'Centroids': 'core.centroid.centroids',
    'Extraction': 'core.centroid.extraction',
    'FrameResult': 'core.frame_result',
    'Identification': 'core.identify.identification',
    'ImageError': 'io.images.images',
    'NoSolutionError': 'photographs.solution',
    'SkySimulator': 'sim.simulator',
    'Solution': 'photographs.solution',
    'StarCatalog': 'core.catalog.stars',
    'StarTracker': 'core.star_tracker',
    'WcsError': 'photographs.sip',
    'calibrate': 'photographs.arrays',
    'extract': 'photographs.arrays',
    'identify': 'core.identify.one_frame',
    'load_camera': 'io.images.camera_files',
    'load_catalog': 'core.catalog.stars',
    'solve': 'photographs.arrays'}
# In full, for what reads the source alone.
__all__ = [
    'Attitude', 'Calibration', 'CalibrationError', 'Camera', 'CameraError', 'CandidateIdentifier',
    'Candidates', 'CatalogueError', 'Centroids', 'Extraction', 'FrameResult', 'Identification',
    'ImageError', 'NoSolutionError', 'SkySimulator', 'Solution', 'StarCatalog', 'StarTracker',
    'WcsError', 'calibrate', 'extract', 'identify', 'load_camera', 'load_catalog', 'solve']


def __getattr__(name: str) -> Any:
    """Return a public name, loaded from its module."""
    if name not in _MODULES:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    value = getattr(import_module(f'{__name__}.{_MODULES[name]}'), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted({*globals(), *_MODULES})
