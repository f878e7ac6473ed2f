# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
One interface to ours and its peers: a database, a solve call that is timed, an attitude.

tetra3rs (https://github.com/ssmichael1/tetra3rs) and cedar-solve
(https://github.com/smroid/cedar-solve) find attitudes by hashes of four-star patterns.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
import os
from pathlib import Path
import subprocess
import tempfile
from typing import Any

import numpy as np
from startracker_evaluation.bench import cedar_process
from startracker_evaluation.bench.cedar_process import measure
from startracker_evaluation.bench.corpus import EPOCH_YEAR, Frame, View
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.identify.methods import make_identifier
from startracker_ros.core.maths.rotation import conjugate, quaternion_from_pointing, rotate
from startracker_ros.tools.figures.machine import installed_version
from startracker_ros.tools.figures.timing import cpu_timed, garbage_collector_off

WARM_UP = 20
"""Frames that each solver solves before its time counts."""

# A database has to hold stars whose magnitude is noisy or in another band.
_MAGNITUDE_MARGIN = 0.3
WARM_UP_VIEW = View('W30', 512, 30.0, 4.5)
"""Its database is built first, for what is loaded once whatever the camera."""


@dataclass(frozen=True)
class Database:
    """The cost of a database: wall time of its build, file, peak growth of memory."""

    seconds: float
    file_mb: float
    memory_mb: float


class Solver(ABC):
    """Finds attitudes of one camera, whose focal length is uncertain."""

    @abstractmethod
    def build(self, view: View, camera: Camera, fov_error_percent: float = 0.5) -> None:
        """Build the database of a view, to solve its frames as those of camera, known so well."""

    @abstractmethod
    def store(self, folder: Path) -> None:
        """Write the database into a folder."""

    @abstractmethod
    def prepare(self, centroids: Centroids) -> Any:
        """Return the centroids in the form of this solver."""

    @abstractmethod
    def solve(self, prepared: Any) -> Any:
        """Return the result in the form of this solver: the call that is timed."""

    @abstractmethod
    def attitude(self, result: Any) -> np.ndarray | None:
        """Return q_icrf_from_sensor (4,) of a result, None without a solution."""


class Ours(Solver):
    """The identifier of this package with its default options."""

    def build(self, view: View, camera: Camera, fov_error_percent: float = 0.5) -> None:
        self._identifier = make_identifier(
            camera, EPOCH_YEAR, IdentificationOptions(
                magnitude_limit=view.magnitude_limit, fov_error_percent=fov_error_percent))

    def store(self, folder: Path) -> None:
        """Do nothing: build() has stored the database in the cache."""

    def prepare(self, centroids: Centroids) -> Any:
        return centroids

    def solve(self, prepared: Any) -> Any:
        return self._identifier.identify(prepared)

    def attitude(self, result: Any) -> np.ndarray | None:
        return None if result.attitude is None else result.attitude.quaternion


class Tetra3rs(Solver):
    """tetra3rs, with a pattern error tuned to the camera, else with its defaults."""

    def __init__(self, pattern_max_error: float | None = None) -> None:
        self._pattern_max_error = pattern_max_error

    def build(self, view: View, camera: Camera, fov_error_percent: float = 0.5) -> None:
        from tetra3rs import SolverDatabase
        tuned: dict[str, Any] = {} if self._pattern_max_error is None else {
            'star_max_magnitude': view.magnitude_limit + _MAGNITUDE_MARGIN,
            'pattern_max_error': self._pattern_max_error}
        self._database = SolverDatabase.generate_from_gaia(
            max_fov_deg=view.fov_deg, epoch_proper_motion_year=EPOCH_YEAR, **tuned)
        self.set_camera(camera)

    def set_camera(self, camera: Camera) -> None:
        """Solve frames of another camera of about the same field of view."""
        fov_deg = float(np.degrees(camera.fov_x_rad))
        tuned = self._pattern_max_error is not None
        self._center = [camera.cx, camera.cy]
        self._options: dict[str, Any] = {
            'fov_estimate_deg': fov_deg, 'image_width': camera.width,
            'image_height': camera.height,
            # An error of 1 px changes the scale of a small pattern by several per cent.
            'fov_max_error_deg': cedar_process.FOV_TOLERANCE * fov_deg if tuned else None}

    def store(self, folder: Path) -> None:
        self._database.save_to_file(str(folder / 'tetra3rs.bin'))

    def prepare(self, centroids: Centroids) -> Any:
        return np.column_stack([centroids.uv - self._center, centroids.flux])

    def solve(self, prepared: Any) -> Any:
        return self._database.solve_from_centroids(prepared, **self._options)

    def attitude(self, result: Any) -> np.ndarray | None:
        # It solves mirrored images as well, which this camera has not.
        if not result or result.parity_flip:
            return None
        w, x, y, z = result.quaternion
        return conjugate(np.array([x, y, z, w]))


TUNED = {'tetra3rs 0.003': 0.003, 'tetra3rs 0.005': 0.005}
"""tetra3rs tuned to the camera, by its pattern_max_error."""

CEDAR = 'cedar-solve'


class PeerError(RuntimeError):
    """A requested peer is not installed."""


def solvers() -> dict[str, Solver]:
    """Return ours and its installed peers, by name."""
    if not installed_version('tetra3rs'):
        return {'ours': Ours()}
    return {'ours': Ours(), 'tetra3rs': Tetra3rs(),
            **{name: Tetra3rs(error) for name, error in TUNED.items()}}


def timed_attitudes(solver: Solver, frames: list[Frame]
                    ) -> tuple[list[np.ndarray | None], np.ndarray]:
    """Return attitudes and process CPU times (N,) in s of all frames after the warm-up."""
    prepared = [solver.prepare(frame.centroids) for frame in frames]
    attitudes, times_s = [], []
    with garbage_collector_off():
        for each in prepared:
            cpu_s, result = cpu_timed(solver.solve, each)
            times_s.append(cpu_s)
            attitudes.append(solver.attitude(result))
    return attitudes[WARM_UP:], np.array(times_s[WARM_UP:])


def measure_database(name: str, view: View) -> Database:
    """Build the database of a solver; for a new process, whose memory has not grown yet."""
    solver = solvers()[name]
    solver.build(WARM_UP_VIEW, WARM_UP_VIEW.camera)
    with tempfile.TemporaryDirectory() as folder:
        # An empty cache: ours would load its database from a full one.
        os.environ['XDG_CACHE_HOME'] = folder
        _, seconds, memory_mb = measure(lambda: solver.build(view, view.camera))
        solver.store(Path(folder))
        size = sum(file.stat().st_size for file in Path(folder).rglob('*') if file.is_file())
    return Database(seconds, size / 1e6, memory_mb)


@dataclass(frozen=True)
class Cedar:
    """cedar-solve in the Python of a venv of its own, its databases in a folder."""

    python: str
    folder: str

    def version(self) -> str:
        """Return its version; PeerError when this Python has none."""
        code = f'from importlib import metadata; print(metadata.version({CEDAR!r}))'
        try:
            return subprocess.run([self.python, '-c', code], capture_output=True, text=True,
                                  check=True).stdout.strip()
        except (OSError, subprocess.CalledProcessError) as error:
            raise PeerError(f'{self.python} has no {CEDAR}: in a venv of its own, pip install '
                            f"{CEDAR} 'numpy<2'") from error

    def build(self, view: View) -> Database:
        """Build its database of a view from the stars of this package."""
        # cedar-solve knows the format by the stem.
        catalogue = Path(self.folder) / 'hip_main.dat'
        catalogue.write_text(_hip_main())
        printed = self._run('build', catalogue, self._database(view), view.fov_deg,
                            view.magnitude_limit + _MAGNITUDE_MARGIN, EPOCH_YEAR)
        seconds, memory_mb = map(float, printed.split())
        return Database(seconds, self._database(view).stat().st_size / 1e6, memory_mb)

    def detect(self, images: Sequence[np.ndarray]) -> list[tuple[np.ndarray, float]]:
        """Return u, v, flux (N, 3) of the stars of each image (H, W), and CPU times in s."""
        found = []
        with tempfile.TemporaryDirectory() as folder:
            image_file, outputs = Path(folder) / 'image.npy', Path(folder) / 'stars.npz'
            for image in images:
                np.save(image_file, image)
                self._run('detect', image_file, outputs)
                with np.load(outputs) as stars:
                    found.append((stars['stars'], float(stars['cpu_s'])))
        return found

    def directions(self, view: View, cameras: Sequence[Camera], lists: Sequence[Centroids]
                   ) -> list[tuple[np.ndarray | None, float]]:
        """Return the direction (3,) of the middle of each image, None if unsolved, and times."""
        attitudes, cpu_s = self._solved(view, cameras, lists, 0)
        return [(None if q is None else rotate(q, [0.0, 0.0, 1.0]), float(time_s))
                for q, time_s in zip(attitudes, cpu_s)]

    def timed_attitudes(self, view: View, camera: Camera, frames: list[Frame],
                        ) -> tuple[list[np.ndarray | None], np.ndarray]:
        """Return attitudes and CPU times from the process of this solver."""
        return self._solved(view, [camera] * len(frames),
                            [frame.centroids for frame in frames], WARM_UP)

    def _solved(self, view: View, cameras: Sequence[Camera], lists: Sequence[Centroids],
                warm_up: int) -> tuple[list[np.ndarray | None], np.ndarray]:
        with tempfile.TemporaryDirectory() as folder:
            inputs, outputs = Path(folder) / 'frames.npz', Path(folder) / 'results.npz'
            np.savez(inputs, uv=np.concatenate([centroids.uv for centroids in lists]),
                     count=[len(centroids) for centroids in lists],
                     size_px=[(camera.height, camera.width) for camera in cameras],
                     fov_deg=[np.degrees(camera.fov_x_rad) for camera in cameras],
                     warm_up=warm_up)
            self._run('solve', self._database(view), inputs, outputs)
            with np.load(outputs) as results:
                # Its roll is that of north from image up, ours of image up from north.
                attitudes = [None if np.isnan(ra) else
                             quaternion_from_pointing(*np.radians([ra, dec, -roll]))
                             for ra, dec, roll in results['pointing_deg']]
                return attitudes, results['cpu_s']

    def _database(self, view: View) -> Path:
        return Path(self.folder) / f'cedar-{view.name}.npz'

    def _run(self, *arguments: object) -> str:
        environment = {**os.environ, 'OMP_NUM_THREADS': '1', 'OPENBLAS_NUM_THREADS': '1'}
        environment.pop('PYTHONPATH', None)
        return subprocess.run(
            [self.python, '-W', 'ignore', cedar_process.__file__, *map(str, arguments)],
            env=environment, stdout=subprocess.PIPE, text=True, check=True).stdout


def _hip_main() -> str:
    """Return the catalogue as the columns of hip_main.dat that cedar-solve reads."""
    catalog = load_catalog()
    stars = zip(catalog.hip, catalog.magnitude, np.degrees(catalog.ra_rad),
                np.degrees(catalog.dec_rad), catalog.pm_ra_mas_yr, catalog.pm_dec_mas_yr)
    return ''.join(
        f'H|{hip}||||{magnitude:.2f}|||{ra:.8f}|{dec:.8f}|||{pm_ra:.2f}|{pm_dec:.2f}\n'
        for hip, magnitude, ra, dec, pm_ra, pm_dec in stars)
