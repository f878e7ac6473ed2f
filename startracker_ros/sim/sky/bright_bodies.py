# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Sun, Moon and Earth at their positions of date: their discs in the image, and their glare."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from startracker_ros.core.astro.bodies import bright_bodies
from startracker_ros.core.astro.earth import in_range
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.maths.rotation import conjugate, rotate
from startracker_ros.core.options import option, Options
from startracker_ros.sim.sky.artefacts import ArtefactOptions
from startracker_ros.sim.sky.motion_state import MotionState


# --- stray light from one side of the image ---

def stray_light(camera: Camera, *, peak_e: float, angle_deg: float,
                falloff_deg: float) -> np.ndarray:
    """
    Return electrons (H, W) float32 that fall off exponentially away from the source.

    The source lies outside the image, in the direction angle_deg from +u towards +v. The image
    is brightest, peak_e, at the point nearest to it; over falloff_deg the light drops by a
    factor e.
    """
    if not peak_e:
        return np.zeros((camera.height, camera.width), np.float32)
    angle = np.radians(angle_deg)
    across = np.cos(angle) * np.arange(camera.width)
    down = np.sin(angle) * np.arange(camera.height)
    # The exponential of a sum is a product: one exponential for each row and column.
    columns, rows = (np.exp((towards - towards.max()) * camera.pixel_rad / np.radians(falloff_deg))
                     for towards in (across, down))
    return np.outer(peak_e * rows, columns).astype(np.float32)


# --- discs with a soft limb ---

class Disc(NamedTuple):
    """
    A disc with a soft limb, fixed on the sensor.

    distance_deg is the angle from the boresight to its centre, angle_deg the direction of the
    centre in the image from +u towards +v. Over softness_deg about radius_deg the brightness
    peak_e falls from 0.62 to 0.38 of that of the disc: a logistic curve.
    """

    peak_e: float
    radius_deg: float
    distance_deg: float
    angle_deg: float
    softness_deg: float


def pixel_directions(camera: Camera) -> np.ndarray:
    """Return the unit vectors (H, W, 3) of all pixels on sensor axes."""
    return camera.unproject(np.stack(
        np.meshgrid(np.arange(camera.width), np.arange(camera.height)), -1))


def disc_coverage(direction: np.ndarray, disc: Disc) -> np.ndarray:
    """
    Return the part (H, W) float32 of each pixel that a disc covers: 1 inside, 0 outside.

    direction (H, W, 3) are the pixel_directions() of the camera.
    """
    distance, angle = np.radians([disc.distance_deg, disc.angle_deg])
    centre = np.array([np.sin(distance) * np.cos(angle), np.sin(distance) * np.sin(angle),
                       np.cos(distance)])
    away_deg = np.degrees(np.arccos(np.clip(direction @ centre, -1, 1)))
    outside = np.clip((away_deg - disc.radius_deg) / disc.softness_deg, -80, 80)
    return (1 / (1 + np.exp(outside))).astype(np.float32)


def discs(options: ArtefactOptions) -> list[Disc]:
    """Return the discs of the Moon and the Earth that the options have."""
    moon = Disc(options.moon_e, options.moon_radius_deg, options.moon_distance_deg,
                options.moon_angle_deg, options.moon_softness_deg)
    earth = Disc(options.earth_e, options.earth_radius_deg, options.earth_distance_deg,
                 options.earth_angle_deg, options.earth_softness_deg)
    return [disc for disc in (moon, earth) if disc.peak_e]


# --- bodies at their positions of date ---

_FAINTEST_E = 0.1
_DISC_WELLS = 10.0
_ALL_FULL_WELLS = 3.0  # of glare at the near edge of the image, with which the far one is full
_FIELD_FALLOFF_DEG = 20.0  # over which the glare drops by a factor e within the image
_SOFTNESS_DEG = {'Sun': 0.01, 'Moon': 0.01, 'Earth': 0.2}


@dataclass(frozen=True)
class BrightBodyOptions(Options):
    """What Sun, Moon and Earth do to images; angles are those between boresight and limb."""

    bright_bodies: bool = option(
        False, 'Sun, Moon and Earth at their positions of date: full pixels on their discs, and '
        'glare around them')
    sun_glare_deg: float = option(
        25.0, 'angle at which the Sun fills the pixels at the edge of the image that is nearest '
        'to it; 0: no glare', unit='deg', low=0.0, high=180.0)
    moon_glare_deg: float = option(
        5.0, 'the same of the Moon', unit='deg', low=0.0, high=180.0)
    earth_glare_deg: float = option(
        15.0, 'the same of the limb of the Earth', unit='deg', low=0.0, high=180.0)
    glare_falloff_deg: float = option(
        0.5, 'angle over which the glare drops by a factor e', unit='deg', low=0.01, high=20.0)


@dataclass(frozen=True)
class BodyLight:
    """Electrons (H, W) by bright bodies, and the part (H, W) or (1, 1) that discs leave clear."""

    light_e: np.ndarray
    clear: np.ndarray


class BrightBodies:
    """
    Discs and glare for the images of a camera.

    The glare of a body falls exponentially with the angle of its limb from the boresight: what a
    baffle lets through. full_well_e is that of the detector.
    """

    def __init__(self, camera: Camera, options: BrightBodyOptions, full_well_e: float) -> None:
        self._camera = camera
        self._options = options
        self._full_well_e = full_well_e
        self._glare_deg = {'Sun': options.sun_glare_deg, 'Moon': options.moon_glare_deg,
                           'Earth': options.earth_glare_deg}

    def light(self, year: float, state: MotionState) -> BodyLight | None:
        """Return the light at a Julian year UTC; None where no body is near, or unknown then."""
        if not (self._options.bright_bodies and in_range(year)):
            return None
        light_e: np.ndarray | float = 0.0
        covering = []
        bodies = bright_bodies(year, state.position_m)
        earth, earth_rad = bodies['Earth']
        for name, (direction, radius_rad) in bodies.items():
            if name != 'Earth' and direction @ earth > np.cos(earth_rad):
                # Behind the Earth.
                continue
            x, y, z = rotate(conjugate(state.q_icrf_from_sensor), direction)
            away_deg = float(np.degrees(np.arccos(np.clip(z, -1, 1))))
            angle_deg, radius_deg = np.degrees([np.arctan2(y, x), radius_rad])
            light_e = light_e + self._glare(name, away_deg - radius_deg, angle_deg)
            if away_deg - radius_deg < np.degrees(self._camera.corner_angle_rad):
                covering.append(Disc(_DISC_WELLS * self._full_well_e, radius_deg, away_deg,
                                     angle_deg, _SOFTNESS_DEG[name]))
        clear = np.ones((1, 1), np.float32)
        # Within glare that fills all pixels no disc can be seen.
        for disc in covering if np.min(light_e) < self._full_well_e else ():
            coverage = disc_coverage(self._directions, disc)
            light_e = light_e + disc.peak_e * coverage
            clear = clear * (1 - coverage)
        return None if isinstance(light_e, float) else BodyLight(light_e, clear)

    def _glare(self, name: str, limb_deg: float, angle_deg: float) -> np.ndarray | float:
        """Return the glare (H, W) of a body in electrons, 0.0 where there is none."""
        glare_deg = self._glare_deg[name]
        if not glare_deg:
            return 0.0
        wells = np.exp(min((glare_deg - limb_deg) / self._options.glare_falloff_deg,
                           np.log(_ALL_FULL_WELLS)))
        peak_e = wells * self._full_well_e
        if peak_e < _FAINTEST_E:
            return 0.0
        if wells >= _ALL_FULL_WELLS * (1 - 1e-9):
            return np.full((self._camera.height, self._camera.width), peak_e, np.float32)
        return stray_light(self._camera, peak_e=peak_e, angle_deg=angle_deg,
                           falloff_deg=_FIELD_FALLOFF_DEG)

    @cached_property
    def _directions(self) -> np.ndarray:
        return pixel_directions(self._camera)
