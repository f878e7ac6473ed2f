# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Simulated photographs of uncalibrated lenses: how many are solved, and whether any wrongly.

Each draw has a lens of its own: a field of 5 to 70 deg, k1 of -0.4 to 0.2, a principal point and a
pixel ratio off, noise of 0.1 to 1 px, a tenth of the stars missing and five false ones. The solver
is given the field of view to 5 % and nothing else.
"""

from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from startracker_ros.core.camera.model import Camera, CameraError
from startracker_ros.core.catalog.onboard import onboard_catalog, OnboardCatalog
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.maths.rotation import multiply, random_attitude, rotate
from startracker_ros.io.table import Result
from startracker_ros.photographs.estimated_lens import estimate_lens, EstimatedLens
from startracker_ros.photographs.ladder import Attempt, LadderIdentifier
from startracker_ros.tools.figures.machine import machine
from startracker_ros.tools.figures.rows import Row
from startracker_ros.tools.parallel import parallel_trials

WIDTH, HEIGHT = 1024, 768
FOV_DEG, K1, CENTRE, RATIO = (5.0, 70.0), (-0.4, 0.2), 0.05, (0.9, 1.1)
NOISE_PX, MISSING, FALSE, FOV_ERROR = (0.1, 1.0), 0.1, 5, 0.05
EPOCH_YEAR = 2026.5
_STARS = 40.0  # of a field on average
_CORRECT_PX = 5.0  # error of the direction of the middle of the image
_PART_TRIALS = 25


@dataclass(frozen=True)
class LensField:
    """A lens, the nominal camera that is given, the stars and the middle (3,) in ICRS."""

    camera: Camera
    given: Camera
    centroids: Centroids
    middle: np.ndarray


@dataclass(frozen=True)
class LensOutcome:
    """Whether each field (N,) is solved correctly or wrongly; its field of view and its k1."""

    correct: np.ndarray
    wrong: np.ndarray
    fov_deg: np.ndarray
    k1: np.ndarray


def draw_lens_field(rng: np.random.Generator) -> LensField:
    """Return a field of a random lens."""
    def draw() -> Camera:
        fov_deg = rng.uniform(*FOV_DEG)
        focal = WIDTH / 2 / np.tan(np.radians(fov_deg) / 2)
        shift = rng.uniform(-CENTRE, CENTRE, 2) * WIDTH
        return Camera(WIDTH, HEIGHT, focal, focal * rng.uniform(*RATIO),
                      (WIDTH - 1) / 2 + shift[0], (HEIGHT - 1) / 2 + shift[1],
                      (rng.uniform(*K1), 0.0, 0.0, 0.0, 0.0))
    camera = unfolded(draw)
    q, _, centroids, _ = draw_stars(rng, camera, _STARS, NOISE_PX, missing=MISSING, false=FALSE)
    given = Camera.from_fov(
        WIDTH, HEIGHT, np.degrees(camera.seen_x_rad) * (1 + rng.uniform(-1, 1) * FOV_ERROR))
    middle = camera.unproject(np.array([(WIDTH - 1) / 2, (HEIGHT - 1) / 2]))
    return LensField(camera, given, centroids, rotate(q, middle))


def unfolded(draw: Callable[[], Camera]) -> Camera:
    """Return the first drawn camera that does not fold its image."""
    while True:
        with suppress(CameraError):
            return draw()


def draw_stars(rng: np.random.Generator, camera: Camera, stars: float,
               noise_px: tuple[float, float], *, missing: float, false: int
               ) -> tuple[np.ndarray, OnboardCatalog, Centroids, np.ndarray]:
    """
    Return a random attitude (4,), a catalogue, and the centroids of a camera with their hip (N,).

    stars is how many the camera sees on average, noise_px the range of their errors.
    """
    q = random_attitude(rng)
    share = camera.fov_x_rad * camera.fov_y_rad / (4 * np.pi)
    catalog = load_catalog()
    limit = float(catalog.magnitude[min(int(stars / share), len(catalog) - 1)])
    onboard = onboard_catalog(catalog, camera, EPOCH_YEAR, limit)
    return q, onboard, *star_list(
        onboard, camera, q, rng.uniform(*noise_px), rng, missing=missing, false=false,
        brightest_false=limit - 3)


def solve_lens_fields(trials: int, seed: int) -> LensOutcome:
    """Solve so many fields."""
    rng = np.random.default_rng(seed)
    options = IdentificationOptions(fov_error_percent=100 * FOV_ERROR, time_limit_s=5.0)
    rows = []
    for _ in range(trials):
        field = draw_lens_field(rng)
        ladder = LadderIdentifier(field.given, EPOCH_YEAR, options)
        found = middle_of(accepted_lens(ladder.identify([field.centroids]), FOV_ERROR))
        error_px = (np.inf if found is None else
                    np.linalg.norm(found - field.middle) / field.camera.pixel_rad)
        rows.append((error_px < _CORRECT_PX, _CORRECT_PX <= error_px < np.inf,
                     np.degrees(field.camera.fov_x_rad), field.camera.distortion[0]))
    return LensOutcome(*(np.array(column) for column in zip(*rows)))


def accepted_lens(attempts: Iterable[Attempt], error: float) -> EstimatedLens | None:
    """Return the first lens accepted of solved attempts, or None; error as estimate_lens()."""
    lenses = (estimate_lens(attempt, error) for attempt in attempts
              if attempt.identification.attitude is not None)
    return next((lens for lens in lenses if not lens.rejected), None)


def middle_of(lens: EstimatedLens | None) -> np.ndarray | None:
    """Return the direction (3,) of the middle of an image, None if it is not solved."""
    return None if lens is None else rotate(
        multiply(lens.attitude.quaternion, lens.camera.middle_axes), [0.0, 0.0, 1.0])


def run_lenses_campaign(*, trials: int, seed: int, scheduler: str = '') -> Result:
    """Run the draws and count."""
    outcome, = parallel_trials(solve_lens_fields, [()], trials, _PART_TRIALS, seed,
                               title='lenses', scheduler=scheduler)
    rows = [Row('solved', 100 * float(np.mean(outcome.correct)), '%', least=98),
            Row('wrong', float(np.sum(outcome.wrong)), 'fields', exactly=0)]
    for low, high in ((5, 20), (20, 45), (45, 70)):
        chosen = (outcome.fov_deg >= low) & (outcome.fov_deg < high)
        if chosen.any():
            rows.append(Row(f'solved, {low} to {high} deg',
                            100 * float(np.mean(outcome.correct[chosen])), '%'))
    return Result('campaign lenses', rows, {
        'machine': machine(),
        'lens': f'{WIDTH} x {HEIGHT} px, {FOV_DEG[0]:g} to {FOV_DEG[1]:g} deg, k1 {K1[0]:g} to '
                f'{K1[1]:g}, centre off by {CENTRE:.0%} of the width, fy / fx {RATIO[0]:g} to '
                f'{RATIO[1]:g}',
        'stars': f'{_STARS:g} a field on average, noise {NOISE_PX[0]:g} to {NOISE_PX[1]:g} px, '
                 f'{MISSING:.0%} missing, {FALSE} false',
        'given': f'the field of view to {FOV_ERROR:.0%}',
        'wrong': f'middle of the image off by more than {_CORRECT_PX:g} px',
        'trials': trials, 'seed': seed})
