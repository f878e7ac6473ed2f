"""When a frame is identified, and by which method: the identifier with its schedule."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.attitude.gyro import GyroErrorOptions
from startracker_ros.camera.model import Camera
from startracker_ros.centroid.centroids import Centroids
from startracker_ros.identify.extended_grid import (
    ExtendedGridIdentifier, ExtendedGridOptions, RecursiveIdentifier)
from startracker_ros.identify.identification import Identification, IdentificationOptions
from startracker_ros.identify.methods import make_identifier
from startracker_ros.options import option, Options


@dataclass(frozen=True)
class CheckOptions(Options):
    """How often the tracks are checked against an identification."""

    check_period_s: float = option(
        10.0, 'time between two frames that are identified lost-in-space while the star tracker '
        'tracks, so that it notices that it follows the wrong stars; 0 for never',
        unit='s', low=0.0, high=3600.0)


class IdentificationStage:
    """
    Identifies frames while the star tracker does not track, and checks it now and then.

    Method extended_grid identifies every frame: it predicts the attitude with the rates of a
    gyro, and only a fresh prediction identifies a field of two or three stars.
    """

    def __init__(self, camera: Camera, epoch_year: float,
                 options: IdentificationOptions = IdentificationOptions(),
                 check: CheckOptions = CheckOptions(),
                 grid: ExtendedGridOptions = ExtendedGridOptions(),
                 gyro: GyroErrorOptions = GyroErrorOptions()) -> None:
        self._check_period_ns = round(check.check_period_s * 1e9)
        self._gyro = gyro
        self.identifier = (
            ExtendedGridIdentifier(camera, epoch_year, options, grid=grid)
            if options.method == 'extended_grid' else make_identifier(camera, epoch_year, options))
        self.reset()

    def reset(self) -> None:
        """Forget the predicted attitude and when the last frame was identified."""
        self._identified_ns: int | None = None
        self._recursive = (RecursiveIdentifier(self.identifier, self._gyro)
                           if isinstance(self.identifier, ExtendedGridIdentifier) else None)

    @property
    def uses_rates(self) -> bool:
        """Whether the method predicts the attitude with the rates of a gyro."""
        return self._recursive is not None

    @property
    def has_rates(self) -> bool:
        """Whether rates of a gyro came."""
        return self._recursive is not None and self._recursive.has_rates

    @property
    def prediction(self) -> str:
        """Return what the last frame was identified with, in words; empty without prediction."""
        return '' if self._recursive is None else self._recursive.condition

    def add_rate(self, stamp_ns: int, rate_rad_s: np.ndarray) -> bool:
        """Use the rate (3,) about sensor axes measured up to a time; False if unusable."""
        return self._recursive is None or self._recursive.add_rate(stamp_ns, rate_rad_s)

    def rests(self, stamp_ns: int, tracking: bool, directed: bool = False) -> bool:
        """
        Return whether a frame needs no identification, as the star tracker tracks.

        A directed frame, of stars that the tracker predicted, is no check of its tracks.
        """
        if self._recursive is not None or not tracking:
            return False
        if not self._check_period_ns or directed:
            return True
        return (self._identified_ns is not None
                and abs(stamp_ns - self._identified_ns) < self._check_period_ns)

    def identify(self, stamp_ns: int, centroids: Centroids) -> Identification:
        """Identify the frame of a time."""
        self._identified_ns = stamp_ns
        if self._recursive is not None:
            return self._recursive.identify(stamp_ns, centroids)
        return self.identifier.identify(centroids)
