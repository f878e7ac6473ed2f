"""The simulated instrument: images, gyro rates and navigation along a motion."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.camera.model import Camera
from startracker_ros.catalog.stars import StarCatalog
from startracker_ros.sky.detector import Detector, DetectorOptions
from startracker_ros.sky.exposure import image_paths
from startracker_ros.sky.gyro import Gyro, GyroOptions
from startracker_ros.sky.motion import Motion, MotionState
from startracker_ros.sky.navigation import NavigationOptions
from startracker_ros.sky.scene import SceneStars
from startracker_ros.sky.sources import Sky, SkyOptions
from startracker_ros.sky.target import Target, TargetOptions

_FRAMES, _GYRO, _NAVIGATION = 0, 1, 2


@dataclass(frozen=True)
class Frame:
    """
    One image (H, W) and the true state at the middle of the exposure.

    stars are the sources centred in the image at the middle of the exposure of their row,
    planets and satellites included; flux_dn (N,) is the flux of each in DN.
    """

    image: np.ndarray
    state: MotionState
    stars: SceneStars
    flux_dn: np.ndarray


class SkySimulator:
    """
    Simulates images, gyro rates and navigation; target is None when the options have none.

    A frame depends on seed and time alone, not on earlier frames. Stars have their barycentric
    ICRS directions of epoch_year, without parallax; aberration is an option.
    """

    def __init__(self, camera: Camera, motion: Motion, catalog: StarCatalog, epoch_year: float,
                 *, sky_options: SkyOptions = SkyOptions(),
                 detector_options: DetectorOptions = DetectorOptions(),
                 gyro_options: GyroOptions = GyroOptions(),
                 target_options: TargetOptions = TargetOptions(),
                 navigation_options: NavigationOptions = NavigationOptions(),
                 seed: int = 0) -> None:
        """Render the stars of the catalogue, all of them; it sets the magnitude limit."""
        self._camera = camera
        self._motion = motion
        self.target = Target(target_options, epoch_year) if target_options.target else None
        self._sky = Sky(catalog, epoch_year, motion, camera.corner_angle_rad, sky_options,
                        target=self.target, seed=seed)
        self._detector = Detector(camera, detector_options, seed=seed)
        self._gyro_options = gyro_options
        self._navigation_options = navigation_options
        self._seed = seed
        self._gyro_time_s = np.inf

    def frame(self, time_s: float) -> Frame:
        """Return the frame whose exposure is centred time_s >= 0 after the start."""
        state = self._motion.at(time_s)
        options, margin_px = self._detector.options, self._detector.margin_px
        exposure_s = options.exposure_s if options.motion_smear else 0.0
        line_time_s = options.line_time_us * 1e-6
        # Includes stars that enter the field before the last row is read, and distortion.
        turned_rad = float(np.linalg.norm(state.rate_rad_s)) * (
            exposure_s + self._camera.height * line_time_s) / 2
        radius_rad = min(np.pi, self._camera.corner_angle_rad + turned_rad
                         + 2 * margin_px * self._camera.pixel_rad)
        groups = self._sky.around(state, time_s, radius_rad)
        # Faster groups need more points along their streaks.
        parts, middle = [], []
        for sources in groups:
            paths, weight = image_paths(
                self._camera, self._motion, sources, time_s, exposure_s=exposure_s,
                step_px=self._detector.sharpest_px, line_time_s=line_time_s, margin_px=margin_px)
            parts.append((paths.reshape(-1, 2), np.tile(sources.magnitude, len(paths)),
                          np.repeat(weight, len(sources.hip))))
            middle.append((sources.hip, paths[len(paths) // 2], sources.magnitude))
        uv, magnitude, weight = map(np.concatenate, zip(*parts))
        image = self._detector.render(
            uv, magnitude, self._rng(_FRAMES, round(time_s * 1e9)), weight)
        scene = SceneStars(*map(np.concatenate, zip(*middle)))
        stars = scene.select(self._camera.contains(scene.uv))
        return Frame(image, state, stars, self._detector.flux_dn(stars.magnitude))

    def gyro(self, time_s: float) -> np.ndarray:
        """
        Return the measured rate (3,) in rad/s on sensor axes.

        The bias random walk covers the time since the last call. The same sequence of times
        gives the same rates; a step back in time restarts the sequence.
        """
        dt_s = time_s - self._gyro_time_s
        if dt_s <= 0:
            self._gyro = Gyro(self._gyro_options, rng=self._rng(_GYRO))
            dt_s = 1 / self._gyro_options.gyro_rate_hz
        self._gyro_time_s = time_s
        return self._gyro.measure(self._motion.at(time_s).rate_rad_s, dt_s)

    def navigation(self, time_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Return measured position (3,) in m and velocity (3,) in m/s."""
        state = self._motion.at(time_s)
        return self._navigation_options.measured(
            state.position_m, state.velocity_m_s, self._rng(_NAVIGATION, round(time_s * 1e9)))

    def _rng(self, *key: int) -> np.random.Generator:
        return np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=key))
