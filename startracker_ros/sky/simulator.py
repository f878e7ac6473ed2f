"""The whole simulated instrument: what the simulator node and the campaigns call."""

from dataclasses import dataclass

import numpy as np

from startracker_ros.camera import Camera
from startracker_ros.catalog.stars import StarCatalog
from startracker_ros.sky.detector import Detector, DetectorOptions
from startracker_ros.sky.gyro import Gyro, GyroOptions
from startracker_ros.sky.motion import Motion, MotionState
from startracker_ros.sky.scene import SceneStars, visible_stars

_FRAMES, _GYRO = 0, 1


@dataclass(frozen=True)
class Frame:
    """One image (H, W) and the truth behind it, at the middle of the exposure.

    stars holds those whose centre lies in the image; flux_dn (N,) is the light of each.
    """

    image: np.ndarray
    state: MotionState
    stars: SceneStars
    flux_dn: np.ndarray


class SkySimulator:
    """Images and gyro rates along a motion.

    A frame depends on seed and time alone, not on the frames made before it. Stars stand at
    their barycentric ICRS places of epoch_year: no aberration, no parallax.
    """

    def __init__(self, camera: Camera, motion: Motion, catalog: StarCatalog, epoch_year: float,
                 *, detector_options: DetectorOptions = DetectorOptions(),
                 gyro_options: GyroOptions = GyroOptions(), seed: int = 0) -> None:
        """Stars fainter than those of the catalogue are not drawn; limit it to hide more."""
        self._camera = camera
        self._motion = motion
        self._catalog = catalog
        self._directions = catalog.directions(epoch_year)
        self._detector = Detector(camera, detector_options, seed=seed)
        self._gyro_options = gyro_options
        self._seed = seed
        self._gyro_time_s = np.inf

    def frame(self, time_s: float) -> Frame:
        """Return the frame whose exposure is centred time_s >= 0 after the start."""
        state = self._motion.at(time_s)
        stars = visible_stars(self._catalog, self._directions, self._camera,
                              state.q_icrf_from_sensor, self._detector.margin_px)
        image = self._detector.render(stars.uv, stars.magnitude,
                                      self._rng(_FRAMES, round(time_s * 1e9)))
        inside = stars.select(self._camera.contains(stars.uv))
        return Frame(image, state, inside, self._detector.flux_dn(inside.magnitude))

    def gyro(self, time_s: float) -> np.ndarray:
        """Return the measured rate (3,) in rad/s on sensor axes.

        The bias walks over the time since the measurement before; the same sequence of times
        gives the same rates, and a step back in time starts the sequence anew.
        """
        dt_s = time_s - self._gyro_time_s
        if dt_s <= 0:
            self._gyro = Gyro(self._gyro_options, rng=self._rng(_GYRO))
            dt_s = 1 / self._gyro_options.gyro_rate_hz
        self._gyro_time_s = time_s
        return self._gyro.measure(self._motion.at(time_s).rate_rad_s, dt_s)

    def _rng(self, *key: int) -> np.random.Generator:
        return np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=key))
