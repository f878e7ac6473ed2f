# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
A star camera from its sensor and lens: field, stars, exposure and accuracy, before it is built.

The closed formula is that of Liebe (IEEE Trans. Aerosp. Electron. Syst. 38, 2002, p. 587): with N
stars of centroid error E px in a field of A over n pixels the attitude has an error of
A E / (n sqrt(N)) across the boresight and atan(E / (0.3825 n)) / sqrt(N) about it. E is the
Cramer-Rao bound of the position of the stars, averaged by their information.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.deep import camera_catalog
from startracker_ros.core.centroid.extraction import ExtractionOptions
from startracker_ros.core.maths.rotation import ARCSEC
from startracker_ros.io.table import Result
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.tools.datasheet.bounds import limiting_magnitude, star_image
from startracker_ros.tools.datasheet.design_options import DesignOptions
from startracker_ros.tools.datasheet.estimates import (
    AXES, bias, EXACT, fov_spatial, pixel_spatial, temporal_noise)
from startracker_ros.tools.datasheet.instrument import DETECTOR, Instrument
from startracker_ros.tools.datasheet.single_images import image_errors, ImageErrors
from startracker_ros.tools.datasheet.sky_coverage import field_magnitudes
from startracker_ros.tools.figures.machine import machine
from startracker_ros.tools.parallel import parallel_trials

V0_PHOTONS_CM2_S_NM = 10_000.0
"""Photons of a star of V = 0 near 550 nm (Bessell, Castelli and Plez 1998)."""

EXPOSURES_S = np.geomspace(0.002, 1.0, 28).round(4)

_LONGEST_STREAK_PX = 30.0
_LIEBE_MEAN_RADIUS = 0.3825
_NEEDED_STARS = 4
_NEEDED_SHARE_PERCENT = 1.0


class DesignError(ValueError):
    """A sensor and lens from which no star camera follows; the text says why."""


def camera_of(options: DesignOptions) -> Camera:
    """Return the ideal camera; CameraError for a field that no lens of this kind has."""
    focal_px = 1e3 * options.focal_mm / options.pixel_um
    return Camera(options.width, options.height, focal_px, focal_px, (options.width - 1) / 2,
                  (options.height - 1) / 2)


def aperture_mm(options: DesignOptions) -> float:
    """Return the diameter of the aperture."""
    return options.focal_mm / options.f_number


def zero_flux_e_s(options: DesignOptions) -> float:
    """Return the electrons per second of a star of V = 0."""
    area_cm2 = np.pi / 4 * (aperture_mm(options) / 10) ** 2
    return float(V0_PHOTONS_CM2_S_NM * area_cm2 * options.bandwidth_nm * options.transmission
                 * options.qe)


def detector_of(options: DesignOptions, exposure_s: float) -> DetectorOptions:
    """Return the simulated detector; DesignError for what it cannot simulate."""
    try:
        return replace(
            DETECTOR, exposure_s=float(exposure_s), zero_flux_e_s=zero_flux_e_s(options),
            background_e=options.background_e_s * float(exposure_s),
            read_noise_e=options.read_noise_e, dark_current_e_s=options.dark_e_s,
            full_well_e=options.full_well_e, bit_depth=options.bit_depth,
            gain_e_per_dn=max(options.full_well_e / (2 ** options.bit_depth - 1), 0.25),
            bias_dn=min(64.0, 2 ** options.bit_depth / 16), psf_sigma_px=options.psf_sigma_px,
            pixel_pitch_um=options.pixel_um)
    except ValueError as error:
        raise DesignError(f'this sensor and lens cannot be simulated: {error}') from error


def streak_px_of(options: DesignOptions, exposure_s: float) -> float:
    """Return how far the stars move in an exposure."""
    return float(np.radians(options.rate_deg_s) * exposure_s / camera_of(options).pixel_rad)


@dataclass(frozen=True)
class Expectation:
    """
    What the closed formula expects at an exposure.

    limit and saturation are the V of the faintest star found and of the brightest not saturated;
    stars (N,) are counts of fields up to the limit; cross_rad and about_rad are medians over the
    fields with enough stars, infinite where more than 1 % have too few.
    """

    exposure_s: float
    streak_px: float
    limit: float
    saturation: float
    stars: np.ndarray
    cross_rad: float
    about_rad: float


def expectation(options: DesignOptions, exposure_s: float, magnitudes: list[np.ndarray]
                ) -> Expectation:
    """Return the expectation from the magnitudes of the stars of random fields."""
    detector, streak_px = detector_of(options, exposure_s), streak_px_of(options, exposure_s)
    limit = limiting_magnitude(detector, streak_px, ExtractionOptions().threshold_sigma)
    image, camera = star_image(detector, round(streak_px, 2)), camera_of(options)
    scale_e = detector.zero_flux_e_s * detector.exposure_s
    saturation = float(-2.5 * np.log10(detector.full_well_e * image.pixels / 2 / scale_e))
    used = [each[(each <= limit) & (each >= saturation)][:ExtractionOptions().max_stars]
            for each in magnitudes]
    stars = np.array([np.count_nonzero(each <= limit) for each in magnitudes])
    errors = [_liebe(camera, _centroid_px(image.at(scale_e * 10 ** (-0.4 * each))), len(each))
              for each in used if len(each) >= _NEEDED_STARS]
    enough = 100 * (1 - len(errors) / max(len(used), 1)) <= _NEEDED_SHARE_PERCENT
    cross, about = np.median(errors, axis=0) if errors and enough else (np.inf, np.inf)
    return Expectation(float(exposure_s), streak_px, limit, saturation, stars, float(cross),
                       float(about))


def _centroid_px(information: np.ndarray) -> float:
    """Return the error per axis of stars of information (N, 2), along and across the motion."""
    return float(np.sqrt(np.mean(1 / information.mean(axis=0))))


def _liebe(camera: Camera, centroid_px: float, stars: int) -> tuple[float, float]:
    """Return the errors in rad across and about the boresight by the formula of Liebe."""
    pixels = min(camera.width, camera.height)
    field_rad = min(camera.fov_x_rad, camera.fov_y_rad)
    return (field_rad * centroid_px / (pixels * np.sqrt(stars)),
            float(np.arctan(centroid_px / (_LIEBE_MEAN_RADIUS * pixels)) / np.sqrt(stars)))


def exposures_of(options: DesignOptions) -> list[float]:
    """Return those of EXPOSURES_S whose streaks can be found; DesignError without any."""
    exposures_s = [float(each) for each in EXPOSURES_S
                   if streak_px_of(options, each) <= _LONGEST_STREAK_PX]
    if not exposures_s:
        raise DesignError(
            f'at {EXPOSURES_S[0]:g} s, the shortest exposure, stars already move by more than '
            f'{_LONGEST_STREAK_PX:g} px: a lower rate or a shorter focal length is needed')
    detector_of(options, exposures_s[-1])
    return exposures_s


def expectations(options: DesignOptions, magnitudes: list[np.ndarray]) -> list[Expectation]:
    """Return an expectation for each exposure; DesignError without any."""
    return [expectation(options, each, magnitudes) for each in exposures_of(options)]


def best_of(expected: list[Expectation]) -> Expectation:
    """Return the one of the smallest error; DesignError where no exposure shows enough stars."""
    best = min(expected, key=lambda one: one.cross_rad)
    if not np.isfinite(best.cross_rad):
        most = max(expected, key=lambda one: one.limit)
        raise DesignError(
            f'with any exposure more than {_NEEDED_SHARE_PERCENT:g} % of the sky has fewer than '
            f'{_NEEDED_STARS} stars in the field; the faintest star found is V {most.limit:.1f}, '
            f'at {most.exposure_s:g} s: a wider field or a larger aperture is needed')
    return best


def instrument_of(options: DesignOptions, exposure_s: float) -> Instrument:
    """Return the instrument at an exposure, its camera known exactly."""
    camera = camera_of(options)
    return Instrument(camera, camera, detector_of(options, exposure_s))


# --- the table: the closed formula next to the Monte Carlo ---

_SKY_FIELDS = 1000
_PART_FIELDS = 5
_SHOWN = 4


@dataclass(frozen=True)
class DesignRow:
    """A figure by formula or catalogue, and that of the Monte Carlo of the same settings."""

    case: str
    formula: float | None
    monte_carlo: float | None
    unit: str
    bound: str = ''
    holds: bool = True


def run_design(options: DesignOptions, *, trials: int, seed: int, scheduler: str = '') -> Result:
    """
    Return the table of a design; trials is the number of simulated fields.

    DesignError or CameraError where no star camera follows from the options.
    """
    camera = camera_of(options)
    # First: the catalogue takes seconds.
    exposures_of(options)
    deepest = float(camera_catalog(camera).magnitude.max())
    magnitudes = field_magnitudes(camera, deepest, _SKY_FIELDS, seed)
    expected = expectations(options, magnitudes)
    best = best_of(expected)
    errors, = parallel_trials(
        image_errors, [(instrument_of(options, best.exposure_s), options.rate_deg_s)], trials,
        _PART_FIELDS, seed, title='design', scheduler=scheduler)
    rows = [*_geometry(options), *_stars(best), *_exposures(expected, best),
            *_accuracy(options, best, errors)]
    return Result('design', rows, {
        'machine': machine(), 'formula': 'Liebe 2002, with the Cramer-Rao bound of each star; '
        'stars of the catalogue', 'monte carlo': f'{trials} random fields at the best exposure, '
        'noise of single images; the camera is known exactly',
        'wanted': f'{options.accuracy_arcsec:g} arcsec across the boresight at '
                  f'{options.rate_deg_s:g} deg/s',
        'catalogue': f'stars to V {deepest:.1f}', 'seed': seed})


def _geometry(options: DesignOptions) -> Iterator[DesignRow]:
    camera = camera_of(options)
    yield DesignRow('field of view, horizontal', float(np.degrees(camera.fov_x_rad)), None, 'deg')
    yield DesignRow('field of view, vertical', float(np.degrees(camera.fov_y_rad)), None, 'deg')
    yield DesignRow('pixel', camera.pixel_rad / ARCSEC, None, 'arcsec')
    yield DesignRow('aperture', aperture_mm(options), None, 'mm')
    yield DesignRow('star of V 0', zero_flux_e_s(options), None, 'e-/s')


def _stars(best: Expectation) -> Iterator[DesignRow]:
    yield DesignRow('best exposure for the rate', best.exposure_s, None, 's')
    yield DesignRow('motion of the stars in it', best.streak_px, None, 'px')
    yield DesignRow('limiting magnitude', best.limit, None, 'mag')
    yield DesignRow('brightest star that is not saturated', best.saturation, None, 'mag')
    for name, percentile in (('fewest', 0), ('1 % of the sky has fewer', 1), ('median', 50)):
        yield DesignRow(f'stars in the field, {name}',
                        float(np.percentile(best.stars, percentile)), None, 'stars')


def _exposures(expected: list[Expectation], best: Expectation) -> Iterator[DesignRow]:
    """Yield the expected error of some exposures around the best."""
    index = expected.index(best)
    for one in expected[max(index - _SHOWN, 0):index + _SHOWN + 1]:
        yield DesignRow(f'across the boresight at {one.exposure_s:g} s',
                        one.cross_rad / ARCSEC, None, 'arcsec')


def _accuracy(options: DesignOptions, best: Expectation, errors: ImageErrors
              ) -> Iterator[DesignRow]:
    formula = dict(zip(AXES, (best.cross_rad / ARCSEC, best.about_rad / ARCSEC)))
    total = {}
    for axis, columns in AXES.items():
        noise = temporal_noise(errors, columns)
        yield DesignRow(f'noise, {axis}, 1 sigma', formula[axis], noise.value, 'arcsec')
        yield DesignRow(f'Cramer-Rao bound, {axis}, 1 sigma', None, noise.bound, 'arcsec')
        others = [bias(EXACT, errors, columns).value, fov_spatial(EXACT, errors, columns).value,
                  pixel_spatial(errors, columns).value]
        total[axis] = float(np.linalg.norm([noise.value, *others]))
    cross = total['cross boresight']
    for axis, value in total.items():
        wanted = axis == 'cross boresight'
        yield DesignRow(f'all errors, {axis}, 1 sigma', None, value, 'arcsec',
                        f'<= {options.accuracy_arcsec:g}' if wanted else '',
                        cross <= options.accuracy_arcsec if wanted else True)
    identified = 100 * float(np.mean(errors.identified))
    yield DesignRow('single images identified', None, identified, '%', '>= 99', identified >= 99)
