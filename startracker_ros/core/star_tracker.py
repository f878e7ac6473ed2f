"""The star tracker as one object, with options by keyword."""

from typing import Any

import numpy as np
from startracker_ros.core.astro.epoch import RESTART_NS
from startracker_ros.core.astro.state import State
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.extraction import check_image
from startracker_ros.core.frame_result import Attitude, FrameResult
from startracker_ros.core.stages.parameters import options_of_keywords
from startracker_ros.core.stages.pipeline import Pipeline, PipelineFrame
from startracker_ros.core.track.tracks import Tracks


class StarTracker:
    """
    Images or centroids of one camera in, attitude out: the stages of the nodes in one process.

    Frames come in the order of their stamps, UNIX time in ns of the middle of the exposure. A
    frame that is not newer than the one before is not used, and its result has the reason; one
    that is older by more than a second begins anew, as after reset().
    """

    def __init__(self, camera: Camera, epoch_year: float, **options: Any) -> None:
        """
        Take the camera, the Julian year of the catalogue, and node parameters by name.

        A name that several nodes have is set in all of them, unless it is another thing in each:
        star_identifier={'method': 'quad'} is that of one node. ValueError names what is wrong,
        and which names there are.
        """
        chosen = options_of_keywords(options)
        across, roll = chosen.tracker.acceleration_deg_s2, chosen.tracker.roll_acceleration_deg_s2
        self._acceleration_rad_s2 = np.radians([across, across, roll])
        self._camera = camera
        self._pipeline = Pipeline(camera, epoch_year, chosen)
        self._newest_ns: int | None = None

    def reset(self) -> None:
        """Forget all frames and rates: LOST, as after the start."""
        self._pipeline.reset()
        self._newest_ns = None

    def add_rate(self, stamp_ns: int, rate_rad_s: np.ndarray) -> None:
        """
        Use the rate (3,) in rad/s of a gyro about sensor axes, measured up to a time.

        Before the frame that follows it. ValueError for another shape.
        """
        self._pipeline.add_rate(stamp_ns, _vector('rate_rad_s', rate_rad_s))

    def add_observer(self, stamp_ns: int, position_m: np.ndarray, velocity_m_s: np.ndarray
                     ) -> None:
        """
        Use geocentric position (3,) m and velocity (3,) m/s on ICRF axes for aberration.

        It is propagated for ten minutes. ValueError for what is no orbit about the Earth.
        """
        self._pipeline.add_state(stamp_ns, State(
            _vector('position_m', position_m), _vector('velocity_m_s', velocity_m_s),
            np.zeros((3, 3))))

    def process(self, stamp_ns: int, image: np.ndarray) -> FrameResult:
        """
        Process an image (H, W) uint8 or uint16 of the camera.

        ValueError for another type or another size than that of the camera.
        """
        check_image(image)
        camera = self._camera
        if image.shape != (camera.height, camera.width):
            raise ValueError(f'image of {image.shape[1]} x {image.shape[0]} px, the camera has '
                             f'{camera.width} x {camera.height}')
        late = self._late(stamp_ns, Centroids.empty())
        if late is not None:
            return late
        stage = self._pipeline.extraction
        extraction = stage.extract(stamp_ns, image, self._pipeline.tracker.predicted)
        frame = self._pipeline.update(stamp_ns, extraction.centroids, stage.directed)
        return self._result(stamp_ns, extraction.centroids, frame, extraction.reason)

    def process_centroids(self, stamp_ns: int, centroids: Centroids) -> FrameResult:
        """Process the centroids of an image; ValueError for any other type."""
        if not isinstance(centroids, Centroids):
            raise ValueError(
                f'centroids are of type {type(centroids).__name__}, must be Centroids')
        late = self._late(stamp_ns, centroids)
        if late is not None:
            return late
        frame = self._pipeline.update(stamp_ns, centroids)
        return self._result(stamp_ns, centroids, frame, '')

    def _late(self, stamp_ns: int, centroids: Centroids) -> FrameResult | None:
        """Return the result of a frame that is not newer; forget all if time was set back."""
        newest_ns = self._newest_ns
        if newest_ns is not None and newest_ns - stamp_ns > RESTART_NS:
            self.reset()
        elif newest_ns is not None and stamp_ns <= newest_ns:
            return FrameResult(
                stamp_ns, centroids, None, Tracks.empty(), None, self._pipeline.tracker.state,
                f'stamp_ns = {stamp_ns} is not newer than that of the frame before, {newest_ns}')
        self._newest_ns = stamp_ns
        return None

    def _result(self, stamp_ns: int, centroids: Centroids, frame: PipelineFrame,
                extraction_reason: str) -> FrameResult:
        estimate, tracked = frame.trusted.attitude, frame.tracked
        if estimate is None or tracked is None:
            found = frame.identification
            reasons = [extraction_reason, frame.reason if tracked is None else
                       frame.trusted.reason]
            if found is not None and found.attitude is None:
                reasons.append(found.reason)
            return FrameResult(stamp_ns, centroids, found, frame.tracks, None, frame.state,
                               '; '.join(dict.fromkeys(filter(None, reasons))))
        return FrameResult(
            stamp_ns, centroids, frame.identification, frame.tracks,
            Attitude(stamp_ns, estimate.quaternion, estimate.covariance_sensor,
                     tracked.rate_rad_s, tracked.rate_covariance, self._acceleration_rad_s2,
                     frame.trusted.protection_rad),
            frame.state, '')


def _vector(name: str, value: np.ndarray) -> np.ndarray:
    """Return a value as float64 (3,); ValueError."""
    vector = np.asarray(value, float)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ValueError(f'{name} = {value} must be three finite numbers')
    return vector
