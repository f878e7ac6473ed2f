"""Centroids beside sep, photutils and tetra3rs on the same images: time, stars found, error."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
import gc
from importlib import import_module, metadata
import os
import platform
import time
from typing import Any

import cv2
import numpy as np
from rich.progress import track as progress
from scipy.spatial import cKDTree
from startracker_ros.bench import star_images
from startracker_ros.bench.star_images import star_image, StarImage
from startracker_ros.centroid.extraction import CentroidExtractor
from startracker_ros.table import Result

SNRS = (7, 10, 30, 100, 300)
MATCH_PX = 1.5  # a star is found when a centroid is so near
_FLOORS: dict[str, Callable[[np.ndarray], object]] = {
    'memcpy': np.ndarray.copy, 'np.max': np.max}
_PIECE = 10  # images held at a time
_WARM_UP = 3
_FWHM = 2.3548 * star_images.PSF_SIGMA_PX

Row = dict[str, object]


class Peer(ABC):
    """Finds stars; package is what has to be installed for it."""

    package = 'startracker_ros'

    @abstractmethod
    def extract(self, image: np.ndarray) -> Any:
        """Return the peer's own answer: the call that is timed."""

    @abstractmethod
    def uv(self, answer: Any) -> np.ndarray:
        """Return the places (N, 2) of an answer."""


class Ours(Peer):
    """The extractor of this package as it comes."""

    def __init__(self) -> None:
        self._extractor = CentroidExtractor()

    def extract(self, image: np.ndarray) -> Any:
        return self._extractor.extract(image)

    def uv(self, answer: Any) -> np.ndarray:
        return answer.centroids.uv


class Tetra3rs(Peer):
    """One of the two extractors of tetra3rs (https://github.com/ssmichael1/tetra3rs)."""

    package = 'tetra3rs'

    def __init__(self, name: str) -> None:
        self._function = getattr(import_module('tetra3rs'), name)

    def extract(self, image: np.ndarray) -> Any:
        return self._function(image, threads=1)

    def uv(self, answer: Any) -> np.ndarray:
        # Its places count from the middle of the image.
        middle = (star_images.SIZE_PX - 1) / 2
        return np.array([(star.x, star.y) for star in answer.centroids]).reshape(-1, 2) + middle


class Sep(Peer):
    """SExtractor as a library (https://github.com/sep-developers/sep), the way it documents."""

    package = 'sep'

    def __init__(self) -> None:
        self._sep = import_module('sep')

    def extract(self, image: np.ndarray) -> Any:
        data = image.astype(np.float32)
        background = self._sep.Background(data)
        return self._sep.extract(data - background, 1.5, err=background.globalrms)

    def uv(self, answer: Any) -> np.ndarray:
        return np.stack([answer['x'], answer['y']], 1)


class DaoStarFinder(Peer):
    """DAOStarFinder of photutils (https://photutils.readthedocs.io), the way it documents."""

    package = 'photutils'

    def __init__(self) -> None:
        self._clipped = import_module('astropy.stats').sigma_clipped_stats
        self._finder = import_module('photutils.detection').DAOStarFinder

    def extract(self, image: np.ndarray) -> Any:
        _, median, deviation = self._clipped(image, sigma=3.0)
        return self._finder(threshold=5 * deviation, fwhm=_FWHM)(image - median)

    def uv(self, answer: Any) -> np.ndarray:
        if answer is None:
            return np.empty((0, 2))
        return np.stack([answer['x_centroid'], answer['y_centroid']], 1)


PEERS: dict[str, tuple[str, Callable[[], Peer]]] = {
    'ours': (Ours.package, Ours),
    'tetra3rs': (Tetra3rs.package, lambda: Tetra3rs('extract_centroids')),
    'tetra3rs fast': (Tetra3rs.package, lambda: Tetra3rs('extract_centroids_fast')),
    'sep': (Sep.package, Sep),
    'DAOStarFinder': (DaoStarFinder.package, DaoStarFinder)}
"""Ours and its peers: the package of each, and what makes it."""


@dataclass
class Tally:
    """What one extractor did: times in s, squares of errors over the bound, stars."""

    cpu_s: list[float] = field(default_factory=list)
    square_ratio: list[np.ndarray] = field(default_factory=list)
    found: int = 0
    false: int = 0
    stars: int = 0

    def count(self, scene: StarImage, uv: np.ndarray) -> None:
        """Add the places uv (N, 2) found in an image."""
        self.stars += len(scene.uv)
        if not len(uv):
            return
        distance, index = cKDTree(uv).query(scene.uv)
        near = distance < MATCH_PX
        self.found += int(np.count_nonzero(near))
        self.false += len(uv) - len(np.unique(index[near]))
        error = (uv[index] - scene.uv)[near] / scene.bound_px[near, None]
        self.square_ratio.append((error ** 2).ravel())

    @property
    def figures(self) -> dict[str, float]:
        """Return the columns of a row."""
        ratio = np.concatenate([*self.square_ratio, np.empty(0)])
        return {'found_percent': 100 * self.found / self.stars,
                'false_per_image': self.false / len(self.cpu_s),
                'rms_over_bound': float(np.sqrt(ratio.mean())) if len(ratio) else np.nan,
                'median_ms': 1e3 * float(np.median(self.cpu_s))}


def installed() -> dict[str, Peer]:
    """Return ours and the peers that are there."""
    return {name: make() for name, (package, make) in PEERS.items() if version(package)}


def version(package: str) -> str:
    """Return the version of a package, empty when it is not installed."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return '' if package != Peer.package else 'this'


def _race(work: Callable[[np.ndarray], Any], scenes: Sequence[StarImage]
          ) -> Iterator[tuple[float, Any]]:
    """Yield the process CPU time in s and the answer of each image, after some to warm up."""
    gc.collect()
    gc.disable()
    try:
        for _ in range(_WARM_UP):
            work(scenes[0].image)
        for scene in scenes:
            start_s = time.process_time()
            answer = work(scene.image)
            yield time.process_time() - start_s, answer
    finally:
        gc.enable()


def measure(snr: float, trials: int, seed: int, peers: Mapping[str, Peer]) -> dict[str, Tally]:
    """Send the same images through one peer after another, a few at a time."""
    cv2.setNumThreads(1)
    rng = np.random.default_rng((seed, round(1000 * snr)))
    tallies = {name: Tally() for name in (*peers, *_FLOORS)}
    for begin in progress(range(0, trials, _PIECE), f'SNR {snr:g}', transient=True):
        scenes = [star_image(snr, rng) for _ in range(min(_PIECE, trials - begin))]
        for name, peer in peers.items():
            for scene, (cpu_s, answer) in zip(scenes, _race(peer.extract, scenes)):
                tallies[name].cpu_s.append(cpu_s)
                tallies[name].count(scene, peer.uv(answer))
        for name, work in _FLOORS.items():
            tallies[name].cpu_s += [cpu_s for cpu_s, _ in _race(work, scenes)]
    return tallies


def bounds(snr: float, figures: Mapping[str, Mapping[str, float]]) -> list[tuple[str, bool]]:
    """Return what ours is held against, and whether it holds."""
    ours = figures['ours']
    checks = [('<= 2 ms', ours['median_ms'] <= 2),
              ('false <= 0.1', ours['false_per_image'] <= 0.1)]
    if snr >= 10:
        checks += [('RMS <= 1.05', ours['rms_over_bound'] <= 1.05),
                   ('found >= 99.5 %', ours['found_percent'] >= 99.5)]
    # Its fast mode does not find the faint stars.
    peer = figures.get('tetra3rs')
    if peer:
        checks.append((f'<= {peer["median_ms"]:.3g} ms (tetra3rs)',
                       ours['median_ms'] <= peer['median_ms']))
    return checks


def rows(snr: float, tallies: Mapping[str, Tally]) -> Iterator[Row]:
    """Yield a row of each extractor, then the floors."""
    figures = {name: tally.figures for name, tally in tallies.items() if tally.stars}
    for name, own in figures.items():
        checks = bounds(snr, figures) if name == 'ours' else []
        yield {'snr': snr, 'extractor': name, **own,
               'bound': '; '.join(text for text, _ in checks),
               'holds': all(holds for _, holds in checks)}
    for name in _FLOORS:
        median_ms = 1e3 * float(np.median(tallies[name].cpu_s))
        yield {'snr': snr, 'extractor': name, 'found_percent': None, 'false_per_image': None,
               'rms_over_bound': None, 'median_ms': median_ms, 'bound': '', 'holds': True}


def run_centroid_bench(*, trials: int, seed: int, snrs: Sequence[float] = SNRS) -> Result:
    """Run all extractors at each SNR."""
    peers = installed()
    table = [row for snr in snrs for row in rows(snr, measure(snr, trials, seed, peers))]
    images = star_images
    versions = {package: version(package) or 'absent: pip install startracker_ros[bench]'
                for package in ('tetra3rs', 'sep', 'photutils')}
    return Result('bench centroid', table, {
        'machine': f'{platform.machine()}, {os.cpu_count()} cores, Python '
                   f'{platform.python_version()}, NumPy {np.__version__}',
        'images': f'{images.SIZE_PX} x {images.SIZE_PX} uint16, {images.STARS} stars of sigma '
                  f'{images.PSF_SIGMA_PX:g} px, sky {images.SKY_E:g} e- with a gradient of '
                  f'{images.SKY_GRADIENT:.0%}, read noise {images.READ_NOISE_E:g} e-, 1 e-/DN',
        'snr': 'F / sqrt(F + 4 pi sigma^2 (sky + read noise^2)), F the electrons of the star: '
               + ', '.join(f'{snr:g} is {images.flux_e(snr):.0f}' for snr in snrs),
        'rms_over_bound': 'of found stars, over the Cramer-Rao bound of each: x, y, flux free, '
                          'width and background known',
        'found': f'a centroid within {MATCH_PX:g} px',
        'times': 'process CPU time of the call, one thread, garbage collector off, each '
                 f'extractor alone over {_PIECE} images in turn',
        **versions, 'trials': trials, 'seed': seed})
