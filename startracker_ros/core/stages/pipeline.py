"""
The star tracker as one object: centroids of a frame in, trusted attitude out.

The policy stands here once: the tracker processes every frame, its attitude goes out if its tracks
fit it, and a frame is identified unless the tracker tracks and no check is due. The nodes run
the same stages side by side, so theirs may use an identification some frames later.
"""

from dataclasses import dataclass

import numpy as np
from startracker_ros.core.astro.observer_motion import AberrationOptions, ObserverMotion
from startracker_ros.core.astro.state import State
from startracker_ros.core.attitude.gyro import GyroErrorOptions
from startracker_ros.core.attitude.protection import ProtectionOptions
from startracker_ros.core.attitude.validation import TrustedAttitude, ValidationOptions
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.band import BandOptions
from startracker_ros.core.catalog.deep import camera_catalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.extraction import ExtractionOptions
from startracker_ros.core.identify.icrf import icrf_identification
from startracker_ros.core.identify.identification import Identification, IdentificationOptions
from startracker_ros.core.stages.attitude import AttitudeStage
from startracker_ros.core.stages.extraction import ExtractionStage, SearchOptions
from startracker_ros.core.stages.identification import CheckOptions, IdentificationStage
from startracker_ros.core.stages.tracking import make_star_tracker
from startracker_ros.core.track.options import TrackerOptions
from startracker_ros.core.track.tracker import TrackerState
from startracker_ros.core.track.tracks import TrackedAttitude, Tracks


@dataclass(frozen=True)
class PipelineOptions:
    """The options of all stages, those of the nodes by default."""

    extraction: ExtractionOptions = ExtractionOptions()
    search: SearchOptions = SearchOptions()
    identification: IdentificationOptions = IdentificationOptions()
    check: CheckOptions = CheckOptions()
    tracker: TrackerOptions = TrackerOptions()
    gyro: GyroErrorOptions = GyroErrorOptions()
    validation: ValidationOptions = ValidationOptions()
    protection: ProtectionOptions = ProtectionOptions()
    aberration: AberrationOptions = AberrationOptions()
    band: BandOptions = BandOptions()


@dataclass(frozen=True)
class PipelineFrame:
    """
    The results of the stages for one frame; identification is None while the identifier rests.

    state is that of the tracker after the frame, trusted the attitude that goes out.
    """

    identification: Identification | None
    tracks: Tracks
    tracked: TrackedAttitude | None
    state: TrackerState
    reason: str
    trusted: TrustedAttitude


class Pipeline:
    """
    All stages in one process, each frame finished before the next one comes.

    Stars are identified by their directions without aberration; every attitude that goes out is
    fitted to the apparent directions of its stamp and is that of the sensor in ICRF.
    """

    def __init__(self, camera: Camera, epoch_year: float,
                 options: PipelineOptions = PipelineOptions()) -> None:
        self.extraction = ExtractionStage(options.extraction, options.search)
        self.identification = IdentificationStage(
            camera, epoch_year, options.identification, options.check, gyro=options.gyro,
            band=options.band)
        self.motion = ObserverMotion(options.aberration)
        self.tracker = make_star_tracker(
            camera, epoch_year, options.tracker, options.gyro, self.motion, options.band)
        self.attitude = AttitudeStage(
            camera, epoch_year, options.validation, self.motion,
            self.tracker.sky if _tracks_all_stars(camera, options) else None,
            options.protection)

    def reset(self) -> None:
        """Forget all state: lost, as after the start."""
        self.extraction.reset()
        self.identification.reset()
        self.tracker.reset()
        self.attitude.reset()

    def add_rate(self, stamp_ns: int, rate_rad_s: np.ndarray) -> None:
        """Use the rate (3,) in rad/s of a gyro about sensor axes, measured up to a time."""
        self.tracker.add_rate(stamp_ns, rate_rad_s)
        self.identification.add_rate(stamp_ns, rate_rad_s)

    def add_state(self, stamp_ns: int, state: State) -> None:
        """Use geocentric position and velocity for aberration; MotionError if impossible."""
        self.motion.add_state(stamp_ns, state)

    def update_image(self, stamp_ns: int, image: np.ndarray) -> PipelineFrame:
        """Process an image (H, W) uint8 or uint16, newer than the one before."""
        extraction = self.extraction.extract(stamp_ns, image, self.tracker.predicted)
        return self.update(stamp_ns, extraction.centroids, self.extraction.directed)

    def update(self, stamp_ns: int, centroids: Centroids, directed: bool = False
               ) -> PipelineFrame:
        """
        Process the centroids of a frame, newer than the one before.

        Where directed, only stars that the tracker predicted were measured: no check of it.
        """
        # As for the nodes, the state before the frame counts: both work on it at the same time.
        rests = self.identifier_rests(stamp_ns, directed)
        tracks = self.tracker.update(stamp_ns, centroids) or Tracks.empty()
        tracked = self.tracker.attitude
        trusted = self.attitude.from_tracks(stamp_ns, tracks, tracked)
        identification = None if rests else self.identify(stamp_ns, centroids)
        return PipelineFrame(identification, tracks, tracked, self.tracker.state,
                             self.tracker.reason, trusted)

    def identifier_rests(self, stamp_ns: int, directed: bool = False) -> bool:
        """Return whether the next frame needs no identification."""
        return self.identification.rests(
            stamp_ns, self.tracker.state is TrackerState.TRACKING, directed)

    def identify(self, stamp_ns: int, centroids: Centroids) -> Identification:
        """Identify a frame for the tracker."""
        identification, centroids = self.identification.identify(stamp_ns, centroids)
        self.tracker.identified(stamp_ns, centroids, identification.hip)
        identifier, sky = self.identification.identifier, self.attitude.sky
        sky.look_from(self.motion.at(stamp_ns))
        return icrf_identification(
            identification, centroids, identifier.camera, sky, identifier.options)


def _tracks_all_stars(camera: Camera, options: PipelineOptions) -> bool:
    """Return whether the star tracker has the stars of the catalogue, with their magnitudes."""
    faintest = camera_catalog(camera).magnitude.max()
    return options.band == BandOptions() and faintest <= options.tracker.magnitude_limit
