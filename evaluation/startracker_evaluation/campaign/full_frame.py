# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Calibration from star lists of a survey camera: a simulated twin of the full-frame images of TESS.

Ten fields of 12.2 deg on 2078 x 2136 px, 20.57 arcsec a pixel. The distortion is a polynomial of
the fifth order as SIP has it (Shupe et al. 2005): radial about an optical axis near the middle of
the chip, 10 px at the farthest corner, and 0.1 px of terms that no radial lens has. The brightest
fifth of the stars is saturated: its centroids are off along the columns by an error that is not
known.

The published figures are those of the tutorial of tetra3rs for ten images of one chip, with SIP of
the fifth and sixth order: 8.98 arcsec rms of the residuals, and 2.74 arcsec between the boresight
and that of the header. The noise of its centroids is not published; the noise here is a condition.
"""

from dataclasses import dataclass

import numpy as np
from startracker_ros.core.calibration.adjustment import CalibrationError
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.onboard import onboard_catalog, OnboardCatalog
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.maths.rotation import (
    ARCSEC, matrix_from_quaternion, random_attitude, rotate)
from startracker_ros.io.table import Result
from startracker_ros.photographs.calibrate import calibrate_lists
from startracker_ros.photographs.sip import evaluate
from startracker_ros.tools.figures.machine import machine
from startracker_ros.tools.figures.rows import CampaignRow

CAMERA = Camera.from_fov(2078, 2136, 11.87)
AXIS = np.array([0.49, 0.52])  # of width and height
PUBLISHED_TOTAL, PUBLISHED_ACROSS = 8.98, 2.74
EPOCH_YEAR = 2019.5
IMAGES = 10
CORNER_PX, OTHER_PX = 10.0, 0.1
NOISE_PX, SATURATED_PX = 0.2, (0.3, 1.0)
SATURATED, MISSING, FALSE = 0.2, 0.1, 5
_LIMIT_MAG, _ORDER = 8.5, 5


@dataclass(frozen=True)
class FullFrame:
    """A chip moves the pixels of an ideal camera by polynomials a and b (6, 6) of the offsets."""

    a: np.ndarray
    b: np.ndarray

    def pixels(self, sensor: np.ndarray) -> np.ndarray:
        """Return where directions (N, 3) on sensor axes are, in px (N, 2)."""
        uv = CAMERA.project(sensor)
        return uv + evaluate((self.a, self.b), _offset(uv))


def _offset(uv: np.ndarray) -> np.ndarray:
    """Return pixels as offsets from the middle, in half heights."""
    return (uv - [CAMERA.cx, CAMERA.cy]) / (CAMERA.height / 2)


def draw_chip(rng: np.random.Generator) -> FullFrame:
    """Return a chip, with other terms than radial of its own."""
    size = np.array([CAMERA.width, CAMERA.height])
    x0, y0 = _offset((AXIS * size)[None])[0]
    corners = _offset(np.array([[0, 0], [size[0], 0], [0, size[1]], size], float))
    largest = np.max(np.hypot(*(corners - [x0, y0]).T))
    third, fifth = CORNER_PX / largest ** 3 * np.array([1.3, -0.3]) / [1, largest ** 2]
    # On a grid: the radial terms are polynomials of the fifth order, which the fit returns.
    x, y = np.random.default_rng(0).uniform(-1, 1, (2, 200))
    r2 = (x - x0) ** 2 + (y - y0) ** 2
    shift = (third * r2 + fifth * r2 ** 2)[:, None] * np.stack([x - x0, y - y0], -1)
    powers = [(i, j) for i in range(_ORDER + 1) for j in range(_ORDER + 1 - i)]
    terms = np.linalg.lstsq(np.stack([x ** i * y ** j for i, j in powers], -1), shift,
                            rcond=None)[0]
    terms += rng.normal(0, OTHER_PX / np.sqrt(len(powers)), terms.shape)
    polynomials = np.zeros((2, _ORDER + 1, _ORDER + 1))
    for (i, j), term in zip(powers, terms):
        polynomials[:, i, j] = term
    return FullFrame(*polynomials)


def draw_list(chip: FullFrame, onboard: OnboardCatalog, q: np.ndarray, rng: np.random.Generator
              ) -> Centroids:
    """Return the centroids of an image at an attitude q (4,)."""
    near = onboard.within(rotate(q, [0.0, 0.0, 1.0]), 1.05 * CAMERA.corner_angle_rad)
    uv = chip.pixels(onboard.direction[near] @ matrix_from_quaternion(q))
    seen = CAMERA.contains(uv) & (rng.random(len(near)) >= MISSING)
    near, uv = near[seen], uv[seen]
    sigma = np.full(uv.shape, NOISE_PX)
    sigma[:int(SATURATED * len(uv))] = SATURATED_PX
    uv = uv + rng.normal(0, 1, uv.shape) * sigma
    magnitude = onboard.magnitude[near] + rng.normal(0, 0.1, len(near))
    uv = np.vstack([uv, rng.uniform(-0.5, [CAMERA.width - 0.5, CAMERA.height - 0.5], (FALSE, 2))])
    magnitude = np.append(magnitude, rng.uniform(_LIMIT_MAG - 3, _LIMIT_MAG, FALSE))
    count = len(uv)
    return Centroids(uv, 1e6 * 10 ** (-0.4 * magnitude), np.full(count, 1 / NOISE_PX),
                     np.full(count, NOISE_PX))


@dataclass(frozen=True)
class FullFrameOutcome:
    """
    Of each image (N,), in arcsec: residuals, rms over its stars, and error of the boresight.

    The residuals are those with the camera that the other images have; failed says why a chip
    was not calibrated.
    """

    total_arcsec: np.ndarray
    across_arcsec: np.ndarray
    failed: tuple[str, ...]


def calibrate_chips(trials: int, seed: int) -> FullFrameOutcome:
    """Calibrate so many chips, each from images of its own, with the field known to 5 %."""
    rng = np.random.default_rng(seed)
    onboard = onboard_catalog(load_catalog(), CAMERA, EPOCH_YEAR, _LIMIT_MAG)
    middle = CAMERA.unproject(np.array([CAMERA.cx, CAMERA.cy]))
    total, across, failed = [], [], []
    for _ in range(trials):
        chip = draw_chip(rng)
        truth = [random_attitude(rng) for _ in range(IMAGES)]
        lists = {i: draw_list(chip, onboard, q, rng) for i, q in enumerate(truth)}
        given = CAMERA.with_focal_ratio(1 + rng.uniform(-0.03, 0.03))
        try:
            used, found = calibrate_lists(lists, given, EPOCH_YEAR, None, (), {})
        except CalibrationError as error:
            failed.append(str(error))
            continue
        arcsec = found.camera.pixel_rad / ARCSEC
        seen = found.camera.unproject(chip.pixels(middle[None]))[0]
        for image, frame in used.items():
            residual = found.left_out_px[found.stars.frame == frame]
            total.append(arcsec * np.sqrt(np.mean(np.sum(residual ** 2, axis=1))))
            towards = rotate(found.adjustment.quaternions[frame], seen)
            across.append(np.linalg.norm(towards - rotate(truth[image], middle)) / ARCSEC)
    return FullFrameOutcome(np.array(total), np.array(across), tuple(failed))


def run_full_frame_campaign(*, trials: int, seed: int) -> Result:
    """Calibrate chips; the published figures are medians as ours are."""
    outcome = calibrate_chips(trials, seed)
    done = len(outcome.total_arcsec) / IMAGES / trials
    rows = [CampaignRow('images calibrated', 100 * done, None, '%', '= 100', done == 1)]
    for figure, values, paper in (
            ('residual, total', outcome.total_arcsec, PUBLISHED_TOTAL),
            ('boresight, across', outcome.across_arcsec, PUBLISHED_ACROSS)):
        median = float(np.median(values)) if len(values) else float('nan')
        rows.append(CampaignRow(figure, median, paper, 'arcsec', f'< {paper:g}', median < paper))
    return Result('campaign full-frame', rows, {
        'machine': machine(),
        'images': f'{IMAGES} of each chip, {CAMERA.width} x {CAMERA.height} px, '
                  f'{CAMERA.pixel_rad / ARCSEC:.2f} arcsec a pixel, V {_LIMIT_MAG:g}',
        'distortion': f'polynomial of order {_ORDER}, {CORNER_PX:g} px at the farthest corner, '
                      f'{OTHER_PX:g} px of it not radial',
        'noise': f'{NOISE_PX:g} px per axis; {SATURATED:.0%} of the stars saturated, '
                 f'{SATURATED_PX[0]:g} and {SATURATED_PX[1]:g} px, not known; {MISSING:.0%} '
                 f'missing, {FALSE} false',
        'residual': 'of each image with the camera of the others, rms over its stars, median',
        'failed': '; '.join(dict.fromkeys(outcome.failed)) or 'none',
        'trials': trials, 'seed': seed})
