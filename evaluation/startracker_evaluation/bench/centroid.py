# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Centroids of the same images by sep, photutils, tetra3rs: time, stars found, error."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

import cv2
import numpy as np
from rich.progress import track as progress
from scipy.spatial import cKDTree
from startracker_evaluation.bench import star_images
from startracker_evaluation.bench.star_images import star_image, StarImage
from startracker_evaluation.extras import peer_versions
from startracker_ros.core.centroid.extraction import CentroidExtractor
from startracker_ros.io.table import Result
from startracker_ros.tools.figures.machine import installed_version, machine, PACKAGE
from startracker_ros.tools.figures.rows import Check, combined
from startracker_ros.tools.figures.timing import cpu_timed, garbage_collector_off

SNRS = (7, 10, 30, 100, 300)
MATCH_PX = 1.5  # largest distance of a found star from its centroid
_FLOORS: dict[str, Callable[[np.ndarray], object]] = {
    'memcpy': np.ndarray.copy, 'np.max': np.max}
_BATCH = 10  # images in memory at a time
_WARM_UP = 3
_FWHM = 2.3548 * star_images.PSF_SIGMA_PX


class Peer(ABC):
    """Finds stars; package has to be installed for it."""

    package = PACKAGE

    @abstractmethod
    def extract(self, image: np.ndarray) -> Any:
        """Return the result in the form of the peer: the call that is timed."""

    @abstractmethod
    def uv(self, result: Any) -> np.ndarray:
        """Return the positions (N, 2) px of a result."""


class Ours(Peer):
    """The extractor of this package as it comes."""

    def __init__(self) -> None:
        self._extractor = CentroidExtractor()

    def extract(self, image: np.ndarray) -> Any:
        return self._extractor.measure(image)

    def uv(self, result: Any) -> np.ndarray:
        return result.centroids.uv


class Tetra3rs(Peer):
    """One of the two extractors of tetra3rs (https://github.com/ssmichael1/tetra3rs)."""

    package = 'tetra3rs'

    def __init__(self, name: str) -> None:
        self._function = getattr(import_module('tetra3rs'), name)

    def extract(self, image: np.ndarray) -> Any:
        return self._function(image, threads=1)

    def uv(self, result: Any) -> np.ndarray:
        # Its pixels count from the centre of the image.
        middle = (star_images.SIZE_PX - 1) / 2
        return np.array([(star.x, star.y) for star in result.centroids]).reshape(-1, 2) + middle


class Sep(Peer):
    """SExtractor as a library (https://github.com/sep-developers/sep), the way it documents."""

    package = 'sep'

    def __init__(self) -> None:
        self._sep = import_module('sep')

    def extract(self, image: np.ndarray) -> Any:
        data = image.astype(np.float32)
        background = self._sep.Background(data)
        return self._sep.extract(data - background, 1.5, err=background.globalrms)

    def uv(self, result: Any) -> np.ndarray:
        return np.stack([result['x'], result['y']], 1)


class DaoStarFinder(Peer):
    """DAOStarFinder of photutils (https://photutils.readthedocs.io), the way it documents."""

    package = 'photutils'

    def __init__(self) -> None:
        self._clipped = import_module('astropy.stats').sigma_clipped_stats
        self._finder = import_module('photutils.detection').DAOStarFinder

    def extract(self, image: np.ndarray) -> Any:
        _, median, deviation = self._clipped(image, sigma=3.0)
        return self._finder(threshold=5 * deviation, fwhm=_FWHM)(image - median)

    def uv(self, result: Any) -> np.ndarray:
        if result is None:
            return np.empty((0, 2))
        return np.stack([result['x_centroid'], result['y_centroid']], 1)


PEERS: dict[str, tuple[str, Callable[[], Peer]]] = {
    'ours': (Ours.package, Ours),
    'tetra3rs': (Tetra3rs.package, lambda: Tetra3rs('extract_centroids')),
    'tetra3rs fast': (Tetra3rs.package, lambda: Tetra3rs('extract_centroids_fast')),
    'sep': (Sep.package, Sep),
    'DAOStarFinder': (DaoStarFinder.package, DaoStarFinder)}
"""Ours and its peers: package and constructor."""


@dataclass
class Tally:
    """Totals of one extractor: times in s, squares of errors over the bound, stars."""

    cpu_s: list[float] = field(default_factory=list)
    square_ratio: list[np.ndarray] = field(default_factory=list)
    found: int = 0
    false: int = 0
    stars: int = 0

    def count(self, scene: StarImage, uv: np.ndarray) -> None:
        """Add the positions uv (N, 2) px found in an image."""
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
    """Return ours and the peers that are installed."""
    return {name: make() for name, (package, make) in PEERS.items()
            if installed_version(package)}


def _timed_calls(extract: Callable[[np.ndarray], Any], scenes: Sequence[StarImage]
                 ) -> Iterator[tuple[float, Any]]:
    """Yield the process CPU time in s and the result of each image, after a warm-up."""
    with garbage_collector_off():
        for _ in range(_WARM_UP):
            extract(scenes[0].image)
        for scene in scenes:
            yield cpu_timed(extract, scene.image)


def measure(snr: float, trials: int, seed: int, peers: Mapping[str, Peer]) -> dict[str, Tally]:
    """Run one peer after another on the same images, a batch at a time."""
    cv2.setNumThreads(1)
    rng = np.random.default_rng((seed, round(1000 * snr)))
    tallies = {name: Tally() for name in (*peers, *_FLOORS)}
    for begin in progress(range(0, trials, _BATCH), f'SNR {snr:g}', transient=True):
        scenes = [star_image(snr, rng) for _ in range(min(_BATCH, trials - begin))]
        for name, peer in peers.items():
            for scene, (cpu_s, result) in zip(scenes, _timed_calls(peer.extract, scenes)):
                tallies[name].cpu_s.append(cpu_s)
                tallies[name].count(scene, peer.uv(result))
        for name, floor in _FLOORS.items():
            tallies[name].cpu_s += [cpu_s for cpu_s, _ in _timed_calls(floor, scenes)]
    return tallies


def bounds(snr: float, figures: Mapping[str, Mapping[str, float]]) -> list[Check]:
    """Return the bounds of ours."""
    ours = figures['ours']
    checks = [('<= 2 ms', ours['median_ms'] <= 2),
              ('false <= 0.1', ours['false_per_image'] <= 0.1)]
    if snr >= 10:
        checks += [('RMS <= 1.05', ours['rms_over_bound'] <= 1.05),
                   ('found >= 99.5 %', ours['found_percent'] >= 99.5)]
    # Its fast mode misses the faint stars.
    peer = figures.get('tetra3rs')
    if peer:
        checks.append((f'<= {peer["median_ms"]:.3g} ms (tetra3rs)',
                       ours['median_ms'] <= peer['median_ms']))
    return checks


@dataclass(frozen=True)
class ExtractorRow:
    """One extractor at one SNR; a floor finds no stars."""

    snr: float
    extractor: str
    found_percent: float | None = None
    false_per_image: float | None = None
    rms_over_bound: float | None = None
    median_ms: float = np.nan
    bound: str = ''
    holds: bool = True


def rows(snr: float, tallies: Mapping[str, Tally]) -> Iterator[ExtractorRow]:
    """Yield a row of each extractor, then the floors."""
    figures = {name: tally.figures for name, tally in tallies.items() if tally.stars}
    for name, own in figures.items():
        bound, holds = combined(bounds(snr, figures) if name == 'ours' else [])
        yield ExtractorRow(snr, name, **own, bound=bound, holds=holds)
    for name in _FLOORS:
        yield ExtractorRow(snr, name, median_ms=1e3 * float(np.median(tallies[name].cpu_s)))


def run_centroid_bench(*, trials: int, seed: int, snrs: Sequence[float] = SNRS) -> Result:
    """Run all extractors at each SNR."""
    peers = installed()
    table = [row for snr in snrs for row in rows(snr, measure(snr, trials, seed, peers))]
    images = star_images
    return Result('bench centroid', table, {
        'machine': machine(),
        'images': f'{images.SIZE_PX} x {images.SIZE_PX} uint16, {images.STARS} stars of sigma '
                  f'{images.PSF_SIGMA_PX:g} px, sky {images.SKY_E:g} e- with a gradient of '
                  f'{images.SKY_GRADIENT:.0%}, read noise {images.READ_NOISE_E:g} e-, 1 e-/DN',
        'snr': 'F / sqrt(F + 4 pi sigma^2 (sky + read noise^2)), F the electrons of the star: '
               + ', '.join(f'{snr:g} is {images.flux_e(snr):.0f}' for snr in snrs),
        'rms_over_bound': 'of found stars, over the Cramer-Rao bound of each: x, y, flux free, '
                          'width and background known',
        'found': f'a centroid within {MATCH_PX:g} px',
        'times': 'process CPU time of the call, one thread, garbage collector off, each '
                 f'extractor alone over {_BATCH} images in turn',
        **peer_versions(Tetra3rs.package, Sep.package, DaoStarFinder.package),
        'trials': trials, 'seed': seed})
