# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What contaminates real images: options, and the record of what one image contains."""

from dataclasses import dataclass, field

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.maths.rotation import ARCSEC
from startracker_ros.core.options import option, Options
from startracker_ros.sim.sky.fixed_pattern import Defects, NO_DEFECTS
from startracker_ros.sim.sky.shake import Shaking, STILL
from startracker_ros.sim.sky.sources import false_stars, SceneStars

NO_TRAILS = np.zeros((0, 4))


@dataclass(frozen=True)
class ArtefactOptions(Options):
    """False light, defects of the sensor and faults of the read-out; all off by default."""

    trails: int = option(0, 'trails of satellites or aircraft across each image', low=0, high=100)
    trail_sigma_px: float = option(1.0, 'sigma of a trail across its direction', unit='px',
                                   low=0.3, high=20.0)
    trail_peak_e: float = option(1000.0, 'electrons per pixel on the centre line of a trail',
                                 unit='e-', low=0.0, high=1e7)
    star_like_spots: int = option(0, 'false stars in each image, at other pixels in every one',
                                  low=0, high=10000)
    star_like_spot_magnitudes: tuple[float, float] = option(
        (3.0, 7.0), 'V of the false stars: uniform between brightest and faintest', unit='mag',
        low=-10.0, high=15.0)
    debris: int = option(
        0, 'particles that drift across the image together: dust and chips of a spacecraft; one '
        'that leaves the image comes back on the other side', low=0, high=10000)
    debris_magnitudes: tuple[float, float] = option(
        (2.0, 5.0), 'V of the particles: uniform between brightest and faintest', unit='mag',
        low=-10.0, high=15.0)
    debris_sigma_px: float = option(3.0, 'sigma of the image of a particle: near ones are out of '
                                    'focus', unit='px', low=0.3, high=20.0)
    debris_drift_px_s: tuple[float, float] = option(
        (30.0, 15.0), 'their motion along u and v', unit='px/s', low=-10000.0, high=10000.0)
    ghost_ratio: float = option(
        0.0, 'flux of the ghost of each star, mirrored at the optical axis, relative to the '
        'star', low=0.0, high=1.0)
    double_exposure_share: float = option(
        0.0, 'share of the light of each star in a second image of it', low=0.0, high=1.0)
    double_exposure_shift_px: tuple[float, float] = option(
        (12.0, 5.0), 'second image minus first, along u and v', unit='px', low=-1000.0,
        high=1000.0)
    moon_e: float = option(0.0, 'electrons per pixel and exposure of the disc of the Moon; 0: no '
                           'Moon', unit='e-', low=0.0, high=1e9)
    moon_radius_deg: float = option(0.26, 'angular radius of the Moon', unit='deg', low=0.01,
                                    high=90.0)
    moon_distance_deg: float = option(3.0, 'angle from the boresight to the centre of the Moon',
                                      unit='deg', low=0.0, high=180.0)
    moon_angle_deg: float = option(
        -45.0, 'direction of the Moon in the image, from +u (right) towards +v (down)',
        unit='deg', low=-360.0, high=360.0)
    moon_softness_deg: float = option(0.01, 'width of the limb of the Moon', unit='deg',
                                      low=1e-4, high=10.0)
    earth_e: float = option(0.0, 'electrons per pixel and exposure of the disc of the Earth; 0: '
                            'no Earth', unit='e-', low=0.0, high=1e9)
    earth_radius_deg: float = option(64.0, 'angular radius of the Earth; 64 at 700 km',
                                     unit='deg', low=0.01, high=90.0)
    earth_distance_deg: float = option(
        68.0, 'angle from the boresight to the centre of the Earth', unit='deg', low=0.0,
        high=180.0)
    earth_angle_deg: float = option(
        90.0, 'direction of the Earth in the image, from +u (right) towards +v (down)',
        unit='deg', low=-360.0, high=360.0)
    earth_softness_deg: float = option(0.2, 'width of the limb of the Earth', unit='deg',
                                       low=1e-4, high=10.0)
    saturated_columns: int = option(
        0, 'columns at full well, whose charge spills into their neighbours; the same seed gives '
        'the same ones', low=0, high=100)
    saturated_rows: int = option(0, 'rows at full well, as saturated_columns', low=0, high=100)
    warm_columns: int = option(0, 'columns with warm_column_dn more than the others; the same '
                               'seed gives the same ones', low=0, high=1000)
    warm_column_dn: float = option(20.0, 'offset of the warm columns', unit='DN', low=0.0,
                                   high=10000.0)
    dead_columns: int = option(
        0, 'columns without charge; the same seed gives the same ones', low=0, high=100)
    dead_rows: int = option(0, 'rows without charge; the same seed gives the same ones', low=0,
                            high=100)
    torn_frame_probability: float = option(
        0.0, 'probability that the rows below a random one are those of the frame before',
        low=0.0, high=0.5)
    repeated_frame_probability: float = option(
        0.0, 'probability that a frame has the image of the frame before', low=0.0, high=0.5)
    stamp: str = option(
        'middle', 'the instant of the exposure that is stamped: middle is right, start and end '
        'are half an exposure wrong', choices=('middle', 'start', 'end'))
    stamp_jitter_ms: float = option(
        0.0, 'standard deviation of the stamps, each by another time: frames stamped on arrival',
        unit='ms', low=0.0, high=1000.0)
    time_offset_s: float = option(
        0.0, 'how late the stamps of the images are, in addition: the error of the clock of a '
        'head', unit='s', low=-1.0, high=1.0)

    def stamp_offset_s(self, exposure_s: float) -> float:
        """Return the stamp minus the middle of the exposure."""
        share = {'middle': 0.0, 'start': -0.5, 'end': 0.5}[self.stamp]
        return share * exposure_s + self.time_offset_s


@dataclass(frozen=True)
class Artefacts:
    """
    What one image contains besides the light of its stars.

    trails (N, 4): a point u, v in px of each centre line and its unit direction along u, v.
    A torn frame has the rows from torn_row on, 0 for none, of the frame before. spots, debris,
    ghosts and second_images are numbers of sources in the image. Those of a torn frame are of the
    upper part.
    """

    trails: np.ndarray = field(default_factory=NO_TRAILS.copy)
    spots: int = 0
    debris: int = 0
    ghosts: int = 0
    second_images: int = 0
    cosmic_ray_hits: int = 0
    defects: Defects = NO_DEFECTS
    torn_row: int = 0
    repeated: bool = False
    stamp_offset_s: float = 0.0
    shaking: Shaking = STILL

    def counts(self) -> dict[str, float]:
        """
        Return the number of each kind by name, the torn row and the offset of the stamp.

        The last three describe a motion that is not uniform within the exposure: its mean pointing
        minus that at its middle, about sensor x and y, and the rms distance from the mean.
        """
        shaking = self.shaking
        x, y, rms = np.array([*shaking.mean_rad, shaking.rms_rad]) / ARCSEC
        return {
            'trails': len(self.trails), 'star_like_spots': self.spots, 'debris': self.debris,
            'ghosts': self.ghosts, 'second_images': self.second_images,
            'cosmic_ray_hits': self.cosmic_ray_hits,
            **self.defects.counts(), 'torn_row': self.torn_row,
            'repeated': int(self.repeated), 'stamp_offset_s': self.stamp_offset_s,
            'mean_pointing_x_arcsec': float(x), 'mean_pointing_y_arcsec': float(y),
            'pointing_rms_arcsec': float(rms)}


def draw_trails(camera: Camera, options: ArtefactOptions, rng: np.random.Generator) -> np.ndarray:
    """Return trails (N, 4) as in Artefacts: through uniform points, in uniform directions."""
    point = _uniform_pixels(camera, options.trails, rng)
    angle = rng.uniform(0, np.pi, options.trails)
    return np.column_stack([point, np.cos(angle), np.sin(angle)])


def draw_spots(camera: Camera, options: ArtefactOptions, rng: np.random.Generator
               ) -> SceneStars:
    """Return the false stars of one image."""
    brightest, faintest = sorted(options.star_like_spot_magnitudes)
    return false_stars(_uniform_pixels(camera, options.star_like_spots, rng),
                       rng.uniform(brightest, faintest, options.star_like_spots))


def draw_debris(camera: Camera, options: ArtefactOptions, rng: np.random.Generator,
                time_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return uv (N, 2) px and V (N,) of the particles at a time, the same for the same rng."""
    brightest, faintest = sorted(options.debris_magnitudes)
    uv = _uniform_pixels(camera, options.debris, rng) + 0.5
    moved = uv + np.multiply(options.debris_drift_px_s, time_s)
    return (moved % [camera.width, camera.height] - 0.5,
            rng.uniform(brightest, faintest, options.debris))


def _uniform_pixels(camera: Camera, count: int, rng: np.random.Generator) -> np.ndarray:
    return rng.random((count, 2)) * [camera.width, camera.height] - 0.5
