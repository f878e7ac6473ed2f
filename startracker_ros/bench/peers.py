"""
Ours and its peers behind one door: a database, a solve call to be timed, an attitude.

tetra3rs (https://github.com/ssmichael1/tetra3rs) and cedar-solve
(https://github.com/smroid/cedar-solve) find attitudes by hashes of four-star patterns.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
import gc
from importlib import metadata
import os
from pathlib import Path
import subprocess
import tempfile
import time
from typing import Any

import numpy as np
from startracker_ros.bench import cedar_process
from startracker_ros.bench.cedar_process import measure
from startracker_ros.bench.corpus import EPOCH_YEAR, Frame, View
from startracker_ros.camera.model import Camera
from startracker_ros.catalog.stars import load_catalog
from startracker_ros.centroid.centroids import Centroids
from startracker_ros.identify.identification import IdentificationOptions
from startracker_ros.identify.methods import make_identifier
from startracker_ros.maths.rotation import conjugate, quaternion_from_pointing

WARM_UP = 20
"""Frames that each solver sees before its time counts."""

# Stars whose magnitude is noisy, or in another band, shall not be missing from a database.
_MAGNITUDE_MARGIN = 0.3


@dataclass(frozen=True)
class Database:
    """What it takes to build one: wall time, the file, how far memory grew at its peak."""

    seconds: float
    file_mb: float
    memory_mb: float


class Solver(ABC):
    """Finds attitudes of one camera; the camera may be told wrongly."""

    @abstractmethod
    def build(self, view: View, camera: Camera) -> None:
        """Make ready to solve frames of view, taken for those of camera."""

    @abstractmethod
    def store(self, folder: Path) -> None:
        """Write the database into a folder."""

    @abstractmethod
    def question(self, centroids: Centroids) -> Any:
        """Return the centroids in the form that this solver takes."""

    @abstractmethod
    def solve(self, question: Any) -> Any:
        """Return the solver's own answer: the call that is timed."""

    @abstractmethod
    def attitude(self, answer: Any) -> np.ndarray | None:
        """Return q_icrf_from_sensor (4,) of an answer, None when it is none."""


class Ours(Solver):
    """The identifier of this package with its default options."""

    def build(self, view: View, camera: Camera) -> None:
        self._identifier = make_identifier(
            camera, EPOCH_YEAR, IdentificationOptions(magnitude_limit=view.magnitude_limit))

    def store(self, folder: Path) -> None:
        """Nothing to do: the identifier has left its database in the cache."""

    def question(self, centroids: Centroids) -> Any:
        return centroids

    def solve(self, question: Any) -> Any:
        return self._identifier.identify(question)

    def attitude(self, answer: Any) -> np.ndarray | None:
        return None if answer.attitude is None else answer.attitude.quaternion


class Tetra3rs(Solver):
    """tetra3rs; with a pattern error it is tuned to the camera, else as it comes."""

    def __init__(self, pattern_max_error: float | None = None) -> None:
        self._pattern_max_error = pattern_max_error

    def build(self, view: View, camera: Camera) -> None:
        from tetra3rs import SolverDatabase
        tuned: dict[str, Any] = {} if self._pattern_max_error is None else {
            'star_max_magnitude': view.magnitude_limit + _MAGNITUDE_MARGIN,
            'pattern_max_error': self._pattern_max_error}
        self._database = SolverDatabase.generate_from_gaia(
            max_fov_deg=view.fov_deg, epoch_proper_motion_year=EPOCH_YEAR, **tuned)
        fov_deg = float(np.degrees(camera.fov_x_rad))
        self._center = [camera.cx, camera.cy]
        self._options: dict[str, Any] = {
            'fov_estimate_deg': fov_deg, 'image_width': camera.width,
            'image_height': camera.height,
            # A star off by 1 px changes the scale of a small pattern by per cents.
            'fov_max_error_deg': None if not tuned else cedar_process.FOV_TOLERANCE * fov_deg}

    def store(self, folder: Path) -> None:
        self._database.save_to_file(str(folder / 'tetra3rs.bin'))

    def question(self, centroids: Centroids) -> Any:
        return np.column_stack([centroids.uv - self._center, centroids.flux])

    def solve(self, question: Any) -> Any:
        return self._database.solve_from_centroids(question, **self._options)

    def attitude(self, answer: Any) -> np.ndarray | None:
        # It tries mirrored images as well; whoever knows the camera leaves those answers out.
        if not answer or answer.parity_flip:
            return None
        w, x, y, z = answer.quaternion
        return conjugate(np.array([x, y, z, w]))


TUNED = {'tetra3rs 0.003': 0.003, 'tetra3rs 0.005': 0.005}
"""tetra3rs tuned to the camera, by its pattern_max_error."""

CEDAR = 'cedar-solve'


class PeerError(RuntimeError):
    """A peer that was asked for is not there."""


def peer_version() -> str:
    """Return the version of tetra3rs, empty when it is not installed."""
    try:
        return metadata.version('tetra3rs')
    except metadata.PackageNotFoundError:
        return ''


def solvers() -> dict[str, Solver]:
    """Return ours and what is installed of its peers, by name."""
    if not peer_version():
        return {'ours': Ours()}
    return {'ours': Ours(), 'tetra3rs': Tetra3rs(),
            **{name: Tetra3rs(error) for name, error in TUNED.items()}}


def race(solver: Solver, frames: list[Frame]) -> tuple[list[np.ndarray | None], np.ndarray]:
    """Return attitudes, and the process CPU time (N,) in s, of all frames but the first 20."""
    questions = [solver.question(frame.centroids) for frame in frames]
    attitudes, cpu_s = [], []
    gc.collect()
    gc.disable()
    try:
        for question in questions:
            start_s = time.process_time()
            answer = solver.solve(question)
            cpu_s.append(time.process_time() - start_s)
            attitudes.append(solver.attitude(answer))
    finally:
        gc.enable()
    return attitudes[WARM_UP:], np.array(cpu_s[WARM_UP:])


def measure_database(name: str, view: View) -> Database:
    """Build the database of a solver; to be called in a fresh process."""
    solver = solvers()[name]
    with tempfile.TemporaryDirectory() as folder:
        # Ours would find its database in the cache.
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
        asked = f'from importlib import metadata; print(metadata.version({CEDAR!r}))'
        try:
            return subprocess.run([self.python, '-c', asked], capture_output=True, text=True,
                                  check=True).stdout.strip()
        except (OSError, subprocess.CalledProcessError) as error:
            raise PeerError(f'{self.python} has no {CEDAR}: in a venv of its own, pip install '
                            f"{CEDAR} 'numpy<2'") from error

    def build(self, view: View) -> Database:
        """Build its database of a view from the stars of this package."""
        # The stem names the format: cedar-solve takes it from there.
        catalogue = Path(self.folder) / 'hip_main.dat'
        catalogue.write_text(_hip_main())
        printed = self._run('build', catalogue, self._database(view), view.fov_deg,
                            view.magnitude_limit + _MAGNITUDE_MARGIN, EPOCH_YEAR)
        seconds, memory_mb = map(float, printed.split())
        return Database(seconds, self._database(view).stat().st_size / 1e6, memory_mb)

    def race(self, view: View, camera: Camera, frames: list[Frame],
             ) -> tuple[list[np.ndarray | None], np.ndarray]:
        """Run a race in the process of the solver, with the result of one in this process."""
        with tempfile.TemporaryDirectory() as folder:
            asked, answered = Path(folder) / 'frames.npz', Path(folder) / 'answers.npz'
            np.savez(asked, uv=np.concatenate([frame.centroids.uv for frame in frames]),
                     count=[len(frame.centroids) for frame in frames], size_px=camera.width,
                     fov_deg=np.degrees(camera.fov_x_rad), warm_up=WARM_UP)
            self._run('solve', self._database(view), asked, answered)
            with np.load(answered) as answers:
                # Its roll is that of north from image up, ours of image up from north.
                attitudes = [None if np.isnan(ra) else
                             quaternion_from_pointing(*np.radians([ra, dec, -roll]))
                             for ra, dec, roll in answers['pointing_deg']]
                return attitudes, answers['cpu_s']

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
