# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Photographs with known answers: ours compared with tetra3rs, cedar-solve, astrometry.net, ASTAP.

Each solver is given the field of view with an error of up to 5 %, drawn for each image. Every
solver of star lists gets the stars of every detection: `nodes` is the list that nodes and `solve
--camera` use, `ours` the longest of those that `startracker solve` tries. `startracker solve`,
astrometry.net and ASTAP get the images, `blind` without the field of view. brightest_percent is
the share of the twelve brightest catalogue stars of each image that `startracker solve` solved
that a list has. `any of` counts an image as correct that at least one of the peers solves, each
with its own detection.
"""

from collections.abc import Callable, Iterator, Sequence
import csv
from dataclasses import dataclass
from pathlib import Path
import re
import sys
import tempfile

import numpy as np
from scipy.spatial import cKDTree
from startracker_evaluation.bench import astap, astrometry_net
from startracker_evaluation.bench.astap import ASTAP
from startracker_evaluation.bench.astrometry_net import ASTROMETRY_NET
from startracker_evaluation.bench.corpus import View
from startracker_evaluation.bench.peers import CEDAR, Cedar, Tetra3rs
from startracker_evaluation.campaign.lenses import accepted_lens, middle_of
from startracker_evaluation.extras import peer_versions
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.deep import camera_catalog
from startracker_ros.core.catalog.onboard import onboard_catalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.extraction import CentroidExtractor
from startracker_ros.core.identify.identification import (
    IdentificationOptions, Identifier, limit_for)
from startracker_ros.core.maths.rotation import rotate, unit_from_radec
from startracker_ros.io.images.images import read_image
from startracker_ros.io.table import Result
from startracker_ros.photographs.detections import Detections
from startracker_ros.photographs.ladder import LadderIdentifier
from startracker_ros.photographs.photograph import PhotographSolver
from startracker_ros.photographs.solution import Solution
from startracker_ros.tools.figures.machine import installed_version, machine
from startracker_ros.tools.figures.timing import cpu_timed

# --- photographs with known answers: folders with a solutions.csv ---

REPOSITORY_IMAGES = Path(__file__).parents[3] / 'test' / 'data'
"""Where a clone of the repository has its images; an installed package has none."""

CORRECT_OF_FIELD = 0.01
"""Largest error of the image centre of a correct solution, as a share of the field of view."""

_EPOCH_YEAR = 2019.5  # where the note of an image has none


class FolderError(ValueError):
    """A folder without images of known answers; the text names it."""


@dataclass(frozen=True)
class Photograph:
    """An image (H, W), its horizontal field of view and the direction (3,) of its centre."""

    group: str
    path: Path
    image: np.ndarray
    fov_deg: float
    centre: np.ndarray
    epoch_year: float

    def is_correct(self, direction: np.ndarray) -> bool:
        """Return whether a direction (3,) is that of the image centre."""
        limit_rad = CORRECT_OF_FIELD * np.radians(self.fov_deg)
        return bool(np.linalg.norm(direction - self.centre) < limit_rad)


def photographs(folders: Sequence[Path]) -> list[Photograph]:
    """
    Return the images of all solutions.csv below the folders that have a known answer.

    FolderError for a folder without any; ImageError for an unreadable image.
    """
    found = []
    for folder in folders:
        here = [image for table in sorted(folder.rglob('solutions.csv')) for image in _of(table)]
        if not here:
            raise FolderError(f'{folder}: no solutions.csv with known images')
        found += here
    return found


def _of(table: Path) -> Iterator[Photograph]:
    with table.open(newline='') as file:
        for row in csv.DictReader(file):
            if not row['ra_deg']:
                continue
            path = table.parent / row['file']
            epoch = re.search(r'epoch (\d+(\.\d+)?)', row.get('note', ''))
            yield Photograph(
                path.parent.name, path, read_image(path),
                float(row.get('hfov_deg') or row['fov_deg_about']),
                unit_from_radec(*np.radians([float(row['ra_deg']), float(row['dec_deg'])])),
                float(epoch[1]) if epoch else _EPOCH_YEAR)


# --- the bench ---

FOV_ERROR = 0.05
_MAX_STARS = 60
_OPTIONS = IdentificationOptions(fov_error_percent=100 * FOV_ERROR)
OURS, NODES, TETRA3RS, WHOLE = 'ours', 'nodes', 'tetra3rs', 'startracker solve'
ALL, BLIND = 'all', ', blind'
BRIGHTEST = 12
_EDGE_PX = 5.0  # of a catalogue star that has to be in an image
_NEAR_SHARE = 0.006  # of the width of the image: what a fitted lens leaves

Lists = list[Centroids]
Found = tuple[np.ndarray | None, float]
"""Direction (3,) of the image centre, None without a solution, and time in s."""


@dataclass(frozen=True)
class RealSkyRow:
    """One detection with one solver on the images of one camera, or of all; CPU times."""

    images: str
    detection: str
    solver: str
    correct: int
    wrong: int
    silent: int
    median_ms: float
    p99_ms: float
    brightest_percent: float | None = None


def given_camera(image: Photograph, rng: np.random.Generator) -> Camera:
    """Return the nominal camera of an image, its field of view up to 5 % off."""
    height, width = image.image.shape
    return Camera.from_fov(width, height, image.fov_deg * (1 + rng.uniform(-1, 1) * FOV_ERROR))


def detect_ours(image: np.ndarray) -> Centroids:
    """Return the longest of our lists of stars."""
    return max(Detections(image), key=len, default=Centroids.empty())


def detect_for_nodes(image: np.ndarray) -> Centroids:
    """Return the list that nodes use."""
    return CentroidExtractor().measure(image).centroids


def brightest_stars(solution: Solution, epoch_year: float) -> np.ndarray:
    """Return the px (N, 2) of the BRIGHTEST catalogue stars of an image, none if unsolved."""
    if solution.sky is None:
        return np.empty((0, 2))
    camera = solution.camera
    onboard = onboard_catalog(camera_catalog(camera), camera, epoch_year)
    uv = solution.sky.pixels(onboard.direction)
    return uv[camera.contains(uv, _EDGE_PX)][:BRIGHTEST]


def share_found(bright: Sequence[np.ndarray], lists: Lists, width: int) -> float:
    """Return the percentage of stars (N, 2) px of images that their lists have."""
    distances = [cKDTree(found.uv).query(uv)[0] for uv, found in zip(bright, lists)
                 if len(uv) and len(found)]
    total = sum(map(len, bright))
    near = sum(np.count_nonzero(distance < _NEAR_SHARE * width) for distance in distances)
    return 100 * float(near) / total if total else float('nan')


def detect_tetra3rs(image: np.ndarray) -> Centroids:
    """Return the stars of tetra3rs with its defaults, of any sharpness."""
    from tetra3rs import extract_centroids
    height, width = image.shape
    found = extract_centroids(image, max_centroids=_MAX_STARS, max_sharpness=None, threads=1)
    rows = np.array([(star.x, star.y, star.brightness) for star in found.centroids])
    return centroids_of(rows.reshape(-1, 3) + [(width - 1) / 2, (height - 1) / 2, 0])


def centroids_of(rows: np.ndarray) -> Centroids:
    """Return u, v, flux (N, 3) as centroids with errors of a fraction of a pixel."""
    rows = rows[np.argsort(-rows[:, 2], kind='stable')]
    count = len(rows)
    return Centroids(rows[:, :2], rows[:, 2], np.full(count, 10.0), np.full(count, 0.2))


def solve_ours(ladder: LadderIdentifier, centroids: Centroids) -> np.ndarray | None:
    """Return the direction of the image centre by our solver on one list of stars."""
    return middle_of(accepted_lens(ladder.identify([centroids]), FOV_ERROR))


def _whole(images: Sequence[Photograph], cameras: Sequence[Camera | None]
           ) -> tuple[list[Found], list[np.ndarray]]:
    """Return what `startracker solve` does with images, and the brightest stars of each."""
    found, bright = [], []
    for image, given in zip(images, cameras):
        solver = PhotographSolver(image.epoch_year, _OPTIONS)
        # Databases are built beforehand.
        solver.solve(image.image, given)
        time_s, solution = cpu_timed(solver.solve, image.image, given)
        found.append((unit_from_radec(*np.radians([solution.ra_deg, solution.dec_deg]))
                      if solution.solved else None, time_s))
        bright.append(brightest_stars(solution, image.epoch_year))
    return found, bright


def _ours(images: Sequence[Photograph], cameras: Sequence[Camera], lists: Lists) -> list[Found]:
    found = []
    for image, given, centroids in zip(images, cameras, lists):
        ladder = LadderIdentifier(given, image.epoch_year, _OPTIONS)
        solve_ours(ladder, centroids)
        time_s, direction = cpu_timed(solve_ours, ladder, centroids)
        found.append((direction, time_s))
    return found


def _view(images: Sequence[Photograph], cameras: Sequence[Camera]) -> View:
    fov_deg = max(np.degrees(camera.fov_x_rad) for camera in cameras)
    limit = limit_for(cameras[0], camera_catalog(cameras[0]), Identifier.stars_per_field)
    return View(images[0].group, cameras[0].width, float(fov_deg), limit)


def _tetra3rs(images: Sequence[Photograph], cameras: Sequence[Camera], lists: Lists
              ) -> list[Found]:
    """Return what tetra3rs finds, tuned to the camera of these images."""
    solver, found = Tetra3rs(0.005), []
    solver.build(_view(images, cameras), cameras[0])
    for given, centroids in zip(cameras, lists):
        solver.set_camera(given)
        time_s, result = cpu_timed(solver.solve, solver.prepare(centroids))
        attitude = solver.attitude(result)
        found.append((None if attitude is None else rotate(attitude, [0.0, 0.0, 1.0]), time_s))
    return found


def run_real_sky_bench(folders: Sequence[Path], *, seed: int = 1, cedar_python: str = ''
                       ) -> Result:
    """
    Solve all images below the folders, or those of the repository where none is given.

    FolderError for a folder without known images; PeerError for a Python without cedar-solve.
    """
    images = photographs(folders or [REPOSITORY_IMAGES])
    rng = np.random.default_rng(seed)
    cameras = [given_camera(image, rng) for image in images]
    rows: list[RealSkyRow] = []
    answers: dict[tuple[str, str], dict[int, Found]] = {}
    with tempfile.TemporaryDirectory() as folder:
        cedar = Cedar(cedar_python, folder) if cedar_python else None
        astap_database = Path(folder) / ASTAP
        if astap.is_installed():
            astap_database.mkdir()
            astap.write_database(astap_database)
        for group in dict.fromkeys((image.group, image.image.shape) for image in images):
            chosen = [k for k, image in enumerate(images)
                      if (image.group, image.image.shape) == group]
            group_images = [images[k] for k in chosen]
            for detection, solver, share, found in _group_answers(
                    group_images, [cameras[k] for k in chosen], cedar, astap_database):
                answers.setdefault((detection, solver), {}).update(zip(chosen, found))
                rows.append(_row(group_images, group_images[0].group, detection, solver, found,
                                 share))
                print(rows[-1], file=sys.stderr, flush=True)
        version = cedar.version() if cedar else 'absent: --cedar-python names its venv'
    of_all = {pair: [found[k] for k in range(len(images))] for pair, found in answers.items()}
    rows += [_row(images, ALL, *pair, found) for pair, found in of_all.items()]
    # Each with its own detection.
    peers = {solver: found for (detection, solver), found in of_all.items()
             if detection == solver and solver != OURS}
    if peers:
        rows.append(_row(images, ALL, 'any of', ', '.join(peers), [
            _best(image, found) for image, found in zip(images, zip(*peers.values()))]))
    return Result('bench real-sky', rows, {
        'machine': machine(),
        'given': f'the field of view, off by up to {FOV_ERROR:.0%}',
        'correct': f'image centre within {CORRECT_OF_FIELD:.0%} of the field of view',
        'times': 'process CPU time of detection and solution, databases in memory; of '
                 f'{ASTROMETRY_NET} and {ASTAP} that of their processes, at most '
                 f'{astrometry_net.CPU_LIMIT_S} s a search',
        **peer_versions(TETRA3RS), CEDAR: version, ASTROMETRY_NET: astrometry_net.version(),
        ASTAP: astap.version(),
        'seed': seed})


def _best(image: Photograph, found: Sequence[Found]) -> Found:
    """Return the best answer to an image, and the time of all."""
    directions = [direction for direction, _ in found if direction is not None]
    return (max(directions, key=image.is_correct, default=None),
            sum(time_s for _, time_s in found))


def _group_answers(images: Sequence[Photograph], cameras: Sequence[Camera], cedar: Cedar | None,
                   astap_database: Path) -> Iterator[tuple[str, str, float | None, list[Found]]]:
    """Yield detection, solver, brightest_percent and answers to the images of one camera."""
    whole, bright = _whole(images, cameras)
    yield WHOLE, OURS, None, whole
    yield WHOLE, OURS + BLIND, None, _whole(images, [None] * len(images))[0]
    if astrometry_net.is_installed():
        yield ASTROMETRY_NET, ASTROMETRY_NET, None, [
            astrometry_net.solve(image.image, _field_limits_deg(given))
            for image, given in zip(images, cameras)]
        yield ASTROMETRY_NET, ASTROMETRY_NET + BLIND, None, [
            astrometry_net.solve(image.image) for image in images]
    if astap.is_installed():
        yield ASTAP, ASTAP, None, [
            astap.solve(image.image, astap_database, float(np.degrees(given.fov_y_rad)))
            for image, given in zip(images, cameras)]
        yield ASTAP, ASTAP + BLIND, None, [
            astap.solve(image.image, astap_database) for image in images]
    detections: dict[str, list[tuple[float, Centroids]]] = {
        OURS: [cpu_timed(detect_ours, image.image) for image in images],
        NODES: [cpu_timed(detect_for_nodes, image.image) for image in images]}
    solvers: dict[str, Callable[[Lists], list[Found]]] = {
        OURS: lambda lists: _ours(images, cameras, lists)}
    if installed_version(TETRA3RS):
        detections[TETRA3RS] = [cpu_timed(detect_tetra3rs, image.image) for image in images]
        solvers[TETRA3RS] = lambda lists: _tetra3rs(images, cameras, lists)
    if cedar is not None:
        view = _view(images, cameras)
        cedar.build(view)
        detections[CEDAR] = [(time_s, centroids_of(stars)) for stars, time_s in
                             cedar.detect([image.image for image in images])]
        solvers[CEDAR] = lambda lists: cedar.directions(view, cameras, lists)
    for detection, seen in detections.items():
        detect_s, lists = [list(column) for column in zip(*seen)]
        share = share_found(bright, lists, cameras[0].width)
        for name, solve in solvers.items():
            yield detection, name, share, [
                (direction, time_s + more_s)
                for (direction, time_s), more_s in zip(solve(lists), detect_s)]


def _field_limits_deg(given: Camera) -> tuple[float, float]:
    fov_deg = float(np.degrees(given.fov_x_rad))
    return fov_deg / (1 + FOV_ERROR), fov_deg / (1 - FOV_ERROR)


def _row(images: Sequence[Photograph], name: str, detection: str, solver: str,
         found: Sequence[Found], brightest_percent: float | None = None) -> RealSkyRow:
    right = [image.is_correct(direction) for image, (direction, _) in zip(images, found)
             if direction is not None]
    times_ms = [1e3 * time_s for _, time_s in found]
    return RealSkyRow(name, detection, solver, sum(right), len(right) - sum(right),
                      len(images) - len(right), float(np.median(times_ms)),
                      float(np.percentile(times_ms, 99)), brightest_percent)
