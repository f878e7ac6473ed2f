# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The table of a design: what the closed formula expects beside what the Monte Carlo finds."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from startracker_ros.core.catalog.deep import camera_catalog
from startracker_ros.core.maths.rotation import ARCSEC
from startracker_ros.io.table import Result
from startracker_ros.tools.datasheet.design import (
    aperture_mm, best_of, camera_of, Expectation, expectations, exposures_of, instrument_of,
    zero_flux_e_s)
from startracker_ros.tools.datasheet.design_options import DesignOptions
from startracker_ros.tools.datasheet.estimates import (
    AXES, bias, EXACT, fov_spatial, pixel_spatial, temporal_noise)
from startracker_ros.tools.datasheet.single_images import image_errors, ImageErrors
from startracker_ros.tools.datasheet.sky_coverage import field_magnitudes
from startracker_ros.tools.figures.machine import machine
from startracker_ros.tools.parallel import parallel_trials

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
