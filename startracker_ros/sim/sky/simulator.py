# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The simulated instrument: images, gyro rates and navigation along a motion."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np
from startracker_ros.core.astro.constants import YEAR_S
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import StarCatalog
from startracker_ros.core.maths.rotation import attitude_error, mean_attitude
from startracker_ros.sim.sky.artefacts import (
    ArtefactOptions, Artefacts, draw_debris, draw_spots, draw_trails, NO_TRAILS)
from startracker_ros.sim.sky.bright_bodies import BrightBodies, BrightBodyOptions
from startracker_ros.sim.sky.detector import Detector, DetectorOptions
from startracker_ros.sim.sky.exposure import image_paths
from startracker_ros.sim.sky.motion_state import Motion, MotionState
from startracker_ros.sim.sky.sensors import Gyro, GyroOptions, NavigationOptions
from startracker_ros.sim.sky.shake import ShakenMotion, STILL, uneven_instants
from startracker_ros.sim.sky.sources import SceneStars, Sky, SkyOptions
from startracker_ros.sim.sky.target import Target, TargetOptions

# Streams of random numbers.
_FRAMES, _GYRO, _NAVIGATION, _ARTEFACTS, _TRANSFER, _STAMPS, _DEBRIS = range(7)


@dataclass(frozen=True)
class Frame:
    """
    One image (H, W) and the true state at its stamp, by default the middle of the exposure.

    stars are the sources centred in the image at the middle of the exposure of their row,
    planets, satellites and star-like spots included; flux_dn (N,) is the flux of each in DN.
    artefacts are those of the image.
    """

    image: np.ndarray
    state: MotionState
    stars: SceneStars
    flux_dn: np.ndarray
    artefacts: Artefacts
    _mean_pointing: Callable[[], np.ndarray] = field(repr=False, compare=False)
    _mean_rate: Callable[[], np.ndarray] = field(repr=False, compare=False)

    @cached_property
    def q_mean(self) -> np.ndarray:
        """
        Attitude (4,) q_icrf_from_sensor of the mean pointing of an exposure about the stamp.

        That of state where the motion within it is uniform; computed when it is asked for.
        """
        return self._mean_pointing()

    @cached_property
    def mean_rate_rad_s(self) -> np.ndarray:
        """Mean rate (3,) of such an exposure about sensor axes: its turn over its time."""
        return self._mean_rate()


class SkySimulator:
    """
    Simulates images, gyro rates and navigation; target is None when the options have none.

    A frame depends on seed and time alone, not on the calls before. Stars have their directions
    from the Earth at epoch_year, with aberration at the time of the frame by default; the true
    attitude is that of the sensor in ICRF.
    """

    def __init__(self, camera: Camera, motion: Motion, catalog: StarCatalog, epoch_year: float,
                 *, sky_options: SkyOptions = SkyOptions(),
                 body_options: BrightBodyOptions = BrightBodyOptions(),
                 detector_options: DetectorOptions = DetectorOptions(),
                 artefact_options: ArtefactOptions = ArtefactOptions(),
                 gyro_options: GyroOptions = GyroOptions(),
                 target_options: TargetOptions = TargetOptions(),
                 navigation_options: NavigationOptions = NavigationOptions(),
                 frame_rate_hz: float = 10.0, seed: int = 0) -> None:
        """
        Render the stars of the catalogue, all of them; it sets the magnitude limit.

        Torn and repeated frames need frame_rate_hz: frames are at its multiples. ValueError for
        a rolling shutter on a shaken motion, whose rows are not rendered at their own times.
        """
        if isinstance(motion, ShakenMotion) and detector_options.line_time_us:
            raise ValueError('vibration_arcsec and kick_arcsec are rendered with a global shutter '
                             'only: set line_time_us to 0')
        self._camera = camera
        self._motion = motion
        self.target = Target(target_options, epoch_year) if target_options.target else None
        self._sky = Sky(catalog, epoch_year, motion, camera.corner_angle_rad, sky_options,
                        target=self.target, seed=seed)
        self._detector = Detector(camera, detector_options, artefact_options, seed=seed)
        self._bodies = BrightBodies(camera, body_options, detector_options.full_well_e)
        self._epoch_year = epoch_year
        self._artefact_options = artefact_options
        self._gyro_options = gyro_options
        self._navigation_options = navigation_options
        self._frame_rate_hz = frame_rate_hz
        self._seed = seed
        self._gyro_time_s = np.inf

    def frame(self, time_s: float) -> Frame:
        """
        Simulate one frame; it depends on seed and time alone, not on the calls before.

        Args:
            time_s: Time of the middle of the exposure after the start, s, 0 or more.

        Returns:
            Frame with `image` (H, W) uint8 or uint16, and the truth: `state` with
            `q_icrf_from_sensor` (4,) and the rate, `stars` with pixels and HIP numbers.

        """
        frame = self._taken(time_s)
        options, index = self._artefact_options, round(time_s * self._frame_rate_hz)
        torn, repeated = options.torn_frame_probability, options.repeated_frame_probability
        if not (torn or repeated) or index == 0:
            return frame
        rng = self._rng(_TRANSFER, round(time_s * 1e9))
        # To the nanosecond, as frames are stamped.
        before_s = round((index - 1) / self._frame_rate_hz * 1e9) / 1e9
        if rng.random() < torn:
            return _torn(frame, self.frame(before_s), int(rng.integers(1, self._camera.height)))
        if rng.random() < repeated:
            before = self.frame(before_s)
            return replace(before, state=frame.state, _mean_pointing=frame._mean_pointing,
                           _mean_rate=frame._mean_rate,
                           artefacts=replace(before.artefacts, repeated=True))
        return frame

    def _taken(self, time_s: float) -> Frame:
        """Return the frame as the sensor takes it, before the transfer."""
        time_ns = round(time_s * 1e9)
        detector, options = self._detector, self._artefact_options
        offset_s = options.stamp_offset_s(detector.options.exposure_s)
        if options.stamp_jitter_ms:
            offset_s += 1e-3 * self._rng(_STAMPS, time_ns).normal(0, options.stamp_jitter_ms)
        scene, uv, magnitude, weight = self._sources(time_s - offset_s)
        trails, spots = NO_TRAILS, 0
        if options.trails or options.star_like_spots:
            rng = self._rng(_ARTEFACTS, time_ns)
            trails = draw_trails(self._camera, options, rng)
            false = draw_spots(self._camera, options, rng)
            spots, scene = len(false), scene.joined(false)
            uv, magnitude = np.vstack([uv, false.uv]), np.append(magnitude, false.magnitude)
            weight = np.append(weight, np.ones(spots))
        rng = self._rng(_FRAMES, time_ns)
        taken_s = time_s - offset_s
        debris = draw_debris(self._camera, options, self._rng(_DEBRIS), taken_s) if (
            options.debris) else None
        bodies = self._bodies.light(
            self._epoch_year + taken_s / YEAR_S, self._motion.at(taken_s))
        hits = detector.expose(uv, magnitude, rng, weight, trails, bodies, debris)
        stars = scene.select(detector.visible(scene.uv, bodies))
        ghosts, second_images = self._copies(scene)
        shaking = STILL
        if isinstance(self._motion, ShakenMotion) and detector.options.motion_smear:
            shaking = self._motion.shaking(time_s - offset_s, detector.options.exposure_s)
        artefacts = Artefacts(trails=trails, spots=spots, debris=options.debris,
                              ghosts=ghosts, second_images=second_images, cosmic_ray_hits=hits,
                              defects=detector.defects, stamp_offset_s=offset_s, shaking=shaking)
        return Frame(detector.read(rng), self._motion.at(time_s), stars,
                     detector.flux_dn(stars.magnitude), artefacts,
                     partial(self._mean_pointing, time_s), partial(self._mean_rate, time_s))

    def _mean_rate(self, time_s: float) -> np.ndarray:
        """Return the mean rate (3,) of an exposure about a time."""
        exposure_s = self._detector.options.exposure_s
        begin, end = (self._motion.at(time_s + half).q_icrf_from_sensor
                      for half in (-exposure_s / 2, exposure_s / 2))
        return attitude_error(end, begin) / exposure_s

    def _mean_pointing(self, time_s: float) -> np.ndarray:
        """Return q_icrf_from_sensor (4,) of the mean pointing of an exposure about a time."""
        options = self._detector.options
        if not options.motion_smear:
            return self._motion.at(time_s).q_icrf_from_sensor
        instants_s, _ = uneven_instants(options.exposure_s)
        return mean_attitude(np.array([
            self._motion.at(time_s + one).q_icrf_from_sensor for one in instants_s]))

    def _sources(self, time_s: float) -> tuple[SceneStars, np.ndarray, np.ndarray, np.ndarray]:
        """
        Return the sources of an exposure centred at time_s, and the points that they shed on.

        Points are uv (N, 2) px, V (N,) and share of the exposure (N,).
        """
        state = self._motion.at(time_s)
        options, margin_px = self._detector.options, self._detector.margin_px
        exposure_s = options.exposure_s if options.motion_smear else 0.0
        line_time_s = self._detector.line_time_s
        # Includes stars that enter the field before the last row is read, and distortion.
        turned_rad = float(np.linalg.norm(state.rate_rad_s)) * (
            exposure_s + self._camera.height * abs(line_time_s)) / 2
        if isinstance(self._motion, ShakenMotion):
            turned_rad += 2 * self._motion.reach_rad
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
        return SceneStars(*map(np.concatenate, zip(*middle))), uv, magnitude, weight

    def _copies(self, scene: SceneStars) -> tuple[int, int]:
        """Return how many ghosts and second images of the sources are in the image."""
        options, detector = self._artefact_options, self._detector
        ghosts, _ = detector.ghosts(scene.uv, detector.flux_e(scene.magnitude))
        second = scene.uv + options.double_exposure_shift_px
        if not options.double_exposure_share:
            second = second[:0]
        return (int(np.count_nonzero(self._camera.contains(ghosts))),
                int(np.count_nonzero(self._camera.contains(second))))

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


def _torn(frame: Frame, before: Frame, row: int) -> Frame:
    """Return a frame whose rows from row on are those of the frame before."""
    image = np.vstack([frame.image[:row], before.image[row:]])
    above, below = frame.stars.uv[:, 1] < row - 0.5, before.stars.uv[:, 1] >= row - 0.5
    stars = frame.stars.select(above).joined(before.stars.select(below))
    return replace(frame, image=image, stars=stars,
                   flux_dn=np.append(frame.flux_dn[above], before.flux_dn[below]),
                   artefacts=replace(frame.artefacts, torn_row=row))
