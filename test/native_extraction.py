# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Extraction of stars by the native core, images for it, and what Python found in them."""

import ctypes
from typing import NamedTuple

from native_core import kernels, ROOT
import numpy as np
from scipy.special import erf
from startracker_ros.core import native
from startracker_ros.core.centroid.extraction import (
    Extraction, ExtractionOptions, native_options)
from startracker_ros.core.centroid.image_tracker import KINDS
from startracker_ros.core.centroid.prediction import PredictedCentroids
from startracker_ros.core.stages.extraction import SearchOptions
from startracker_ros.io.images.images import read_image

REASONS = {0: 'ok', 100: 'too_small', 101: 'blank', 102: 'saturated', 103: 'too_many',
           104: 'no_stars', 105: 'no_stars', 106: 'torn', 107: 'repeated', 108: 'repeated',
           109: 'readout', 110: 'streak'}
ALIGNMENT = 64
NEAR = 0.02
RECORDED = ROOT / 'test' / 'golden' / 'extraction.npz'


class Found(NamedTuple):
    """
    What was found in an image, by the native core or by Python.

    rejected (11,) counts the spots left out by KINDS; figures (5,) are background and noise in DN,
    PSF sigma in px and the limits of the exposure in s; streak (3,) is u, v px and roll, NaN for
    points; centroids (N,) are of native.CENTROID.
    """

    status: str
    rejected: np.ndarray
    figures: np.ndarray
    streak: np.ndarray
    centroids: np.ndarray
    windowed: bool = False

    @classmethod
    def by_python(cls, extraction: Extraction, windowed: bool = False) -> 'Found':
        stars = extraction.centroids
        table = np.zeros(len(stars), native.CENTROID)
        table['u_px'], table['v_px'] = stars.uv.T
        for name, column in (('flux_dn', 'flux'), ('snr', 'snr'), ('sigma_px', 'sigma_px'),
                             ('delay_s', 'delay_s')):
            table[name] = getattr(stars, column)
        for axes, (i, j) in (('uu', (0, 0)), ('uv', (0, 1)), ('vv', (1, 1))):
            table[f'cov_{axes}_px2'] = stars.covariance[:, i, j]
            table[f'common_{axes}_px2'] = stars.common[:, i, j]
        return cls(extraction.status, np.array([extraction.rejected.get(kind, 0)
                                                for kind in KINDS]),
                   np.array([extraction.background_dn, extraction.noise_dn,
                             extraction.psf_sigma_px, *stars.exposure_s]),
                   np.full(3, np.nan) if extraction.streak is None
                   else np.array(extraction.streak[:3]), table, windowed)

    @classmethod
    def by_core(cls, extraction: np.ndarray, centroids: np.ndarray) -> 'Found':
        figures = ('background_dn', 'noise_dn', 'psf_sigma_px', 'exposure_least_s',
                   'exposure_most_s')
        return cls(REASONS[int(extraction['reason']['code'])], extraction['rejected_by_kind'],
                   np.array([extraction[name] for name in figures]),
                   np.array([extraction[f'streak_{name}'] for name in (
                       'u_px', 'v_px', 'roll_rad')]), centroids, bool(extraction['windowed']))


def assert_same(found: Found, expected: Found) -> None:
    """
    Assert that both found the same.

    The filtered image is float32. The record rounds a product and its sum once, the core each, so
    that the noise, in steps of 1/256 DN, may come out a step away: 1 % after a wide filter.
    """
    assert found.status == expected.status
    assert found.windowed == expected.windowed
    assert dict(zip(KINDS, found.rejected)) == dict(zip(KINDS, expected.rejected))
    assert len(found.centroids) == len(expected.centroids)
    np.testing.assert_allclose(found.figures, expected.figures, rtol=NEAR)
    np.testing.assert_allclose(found.streak, expected.streak, rtol=NEAR, atol=1e-6)
    for name in native.CENTROID.names:
        one, other = found.centroids[name], expected.centroids[name]
        if name in ('u_px', 'v_px'):
            assert (np.abs(one - other) <= NEAR * expected.centroids['sigma_px']).all(), name
        else:
            np.testing.assert_allclose(one, other, rtol=2 * NEAR, atol=1e-7, err_msg=name)


def config_of(options: ExtractionOptions = ExtractionOptions(),
              search: SearchOptions = SearchOptions()) -> np.ndarray:
    """Return the options of a tracker that only extracts."""
    config, abi = np.zeros((), native.CONFIG), native.this_abi()
    assert kernels().st_defaults(config.ctypes.data, abi.ctypes.data) == 0
    config['stages'] = 1
    given = config['extraction']
    for name, value in native_options(options).items():
        given[name] = value
    given['search_period_s'], given['max_stars_lost'] = (
        search.search_period_s, search.max_stars_lost)
    return config


def camera_of(shape: tuple[int, int]) -> np.ndarray:
    """Return any camera with images of this shape (H, W)."""
    camera = np.zeros((), native.CAMERA)
    camera['height_px'], camera['width_px'] = shape
    camera['fx_px'] = camera['fy_px'] = 2.0 * max(shape)
    camera['cx_px'], camera['cy_px'] = (shape[1] - 1) / 2, (shape[0] - 1) / 2
    return camera


def image_struct(image: np.ndarray, cell: int = 1) -> np.ndarray:
    """Return the st_image of an image (H, W), which has to stay."""
    struct = np.zeros((), native.IMAGE)
    struct['pixels'], struct['stride_bytes'] = image.ctypes.data, image.strides[0]
    struct['height_px'], struct['width_px'] = image.shape
    struct['type'], struct['cell'] = image.dtype == np.uint16, cell
    return struct


class NativeTracker:
    """A tracker of the native core that extracts, for images of a shape (H, W)."""

    def __init__(self, shape: tuple[int, int], options: ExtractionOptions = ExtractionOptions(),
                 search: SearchOptions = SearchOptions(), config: np.ndarray | None = None
                 ) -> None:
        config, camera = config_of(options, search) if config is None else config, camera_of(shape)
        size, fault = ctypes.c_size_t(), np.zeros((), native.FAULT)
        assert kernels().st_size(config.ctypes.data, camera.ctypes.data, None,
                                 ctypes.byref(size)) == 0
        self.bytes = size.value
        self._block = np.full(size.value + 2 * ALIGNMENT, 0xA5, np.uint8)
        self._first = -self._block.ctypes.data % ALIGNMENT
        self.handle = ctypes.c_void_p()
        assert kernels().st_create(
            self._block.ctypes.data + self._first, size.value, config.ctypes.data,
            camera.ctypes.data, None, ctypes.byref(self.handle), fault.ctypes.data) == 0

    def reset(self) -> None:
        assert kernels().st_reset(self.handle) == 0

    @property
    def is_intact(self) -> bool:
        """Whether nothing was written beyond the memory that was given."""
        end = self._first + self.bytes
        return all((beyond == 0xA5).all() for beyond in (
            self._block[:self._first], self._block[end:]))

    def extract(self, stamp_ns: int, image: np.ndarray,
                predicted: PredictedCentroids | None = None, lost: bool = True, cell: int = 1
                ) -> Found:
        """Return what ExtractionStage.process() returns."""
        struct, extraction = image_struct(image, cell), np.zeros((), native.EXTRACTION)
        count = 0 if predicted is None else len(predicted.uv)
        predictions = np.zeros(count, native.PREDICTION)
        if predicted is not None:
            predictions['u_px'], predictions['v_px'] = predicted.uv.T
            predictions['u_rate_px_s'], predictions['v_rate_px_s'] = predicted.velocity.T
            predictions['sigma_px'], predictions['hip'] = predicted.sigma_px, predicted.hip
        status = kernels().st_extract(
            self.handle, stamp_ns, struct.ctypes.data, predictions.ctypes.data, count,
            0 if predicted is None else predicted.stamp_ns, lost, extraction.ctypes.data)
        assert status == 0, status
        assert int(extraction['rejected_listed']) == len(
            self._list('st_rejections', native.REJECTED))
        return Found.by_core(extraction, self._list('st_centroids', native.CENTROID))

    def _list(self, name: str, kind: np.dtype) -> np.ndarray:
        count = ctypes.c_size_t()
        first = getattr(kernels(), name)(self.handle, ctypes.byref(count))
        return np.frombuffer(ctypes.string_at(first, count.value * kind.itemsize), kind)


# --- images ---


def light(shape: tuple[int, int], uv: np.ndarray, flux: np.ndarray, sigma_px: float,
          streak_px: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """Return stars (H, W) of a Gaussian integrated over the pixels, moved along a streak."""
    image, steps = np.zeros(shape), 1 if streak_px == (0.0, 0.0) else 41
    x, y = np.arange(shape[1] + 1) - 0.5, np.arange(shape[0] + 1) - 0.5
    for (u, v), total in zip(uv, np.broadcast_to(flux, len(uv))):
        for t in np.linspace(-0.5, 0.5, steps) if steps > 1 else (0.0,):
            across = np.diff(erf((x - u - t * streak_px[0]) / sigma_px / 2 ** 0.5)) / 2
            down = np.diff(erf((y - v - t * streak_px[1]) / sigma_px / 2 ** 0.5)) / 2
            seen_u, seen_v = np.flatnonzero(across > 1e-12), np.flatnonzero(down > 1e-12)
            if len(seen_u) and len(seen_v):
                rows, columns = slice(seen_v[0], seen_v[-1] + 1), slice(seen_u[0], seen_u[-1] + 1)
                image[rows, columns] += total / steps * np.outer(down[rows], across[columns])
    return image


def exposed(signal: np.ndarray, rng: np.random.Generator, dtype: type = np.uint16,
            level: float = 100.0, read: float = 4.0) -> np.ndarray:
    """Return an image of a signal in DN with photon noise and that of reading it out."""
    noisy = rng.poisson(np.maximum(signal, 0)) + rng.normal(level, read, signal.shape)
    return np.clip(np.round(noisy), 0, np.iinfo(dtype).max).astype(dtype)


def images() -> dict[str, np.ndarray]:
    """Return simulated images by what they show."""
    rng = np.random.default_rng(60)
    found = {}

    def stars(shape, count):
        return rng.uniform(0, 1, (count, 2)) * [shape[1], shape[0]], np.geomspace(
            300, 60000, count)
    for name, shape, count, sigma, dtype, level in (
            ('30 stars', (512, 512), 30, 0.8, np.uint16, 100.0),
            ('8 bit', (480, 640), 25, 1.0, np.uint8, 12.0),
            ('odd size', (271, 403), 15, 1.2, np.uint16, 300.0),
            ('narrow', (300, 300), 20, 0.45, np.uint16, 50.0),
            ('wide', (400, 400), 20, 3.0, np.uint16, 50.0),
            ('crowded', (400, 400), 400, 1.0, np.uint16, 80.0),
            ('nearly empty', (256, 256), 1, 0.8, np.uint16, 20.0),
            ('empty', (200, 320), 0, 0.8, np.uint8, 3.0),
            ('small', (9, 40), 2, 0.8, np.uint16, 20.0)):
        signal = light(shape, *stars(shape, count), sigma)
        found[name] = exposed(signal if dtype is np.uint16 else signal / 40, rng, dtype, level,
                              4.0 if dtype is np.uint16 else 1.2)
    shape = (400, 480)
    uv, flux = stars(shape, 25)
    for name, streak in (('streaks', (14.0, 5.0)), ('short streaks', (2.5, -1.0)),
                         ('long streaks', (-5.0, 40.0))):
        found[name] = exposed(3 * light(shape, uv, flux, 0.9, streak), rng)
    point = light(shape, uv, flux, 0.9)
    glare = 3000 * np.exp(-np.hypot(*np.mgrid[0:400, 0:480]) / 150)
    found['glare'] = exposed(point + glare, rng)
    moon = 60000.0 * (np.hypot(*(np.mgrid[0:400, 0:480] - np.array([200, 240])[:, None, None]))
                      < 90)
    found['moon'] = exposed(point + moon, rng)
    trail = light(shape, np.array([[240.0, 200.0]]), 4e5, 1.0, (460.0, 190.0))
    found['trail'] = exposed(point + trail, rng)
    saturated = exposed(8 * point, rng)
    found['saturated stars'] = np.minimum(saturated, 4095)
    column = saturated.copy()
    column[:, 100:102] = 65535
    found['saturated column'] = column
    hot = exposed(point, rng)
    hot[rng.integers(0, 400, 60), rng.integers(0, 480, 60)] = 5000
    found['hot pixels'] = hot
    storm = exposed(point, rng)
    storm[rng.integers(0, 400, 3000), rng.integers(0, 480, 3000)] = 4000
    found['storm'] = storm
    noise = rng.integers(0, 4000, (300, 300)).astype(np.uint16)
    noise[::7] = 0
    found['pattern'] = noise
    ring = np.hypot(*(np.mgrid[-9:10, -9:10]))
    ring = ((ring > 4) & (ring < 8)).astype(float)
    defocused = np.zeros(shape)
    for u, v in uv.astype(int).clip(10, 380):
        defocused[v - 9:v + 10, u - 9:u + 10] += 200 * ring
    found['defocused'] = exposed(defocused, rng)
    found['blank'] = np.full((64, 64), 7, np.uint8)
    found['white'] = np.full((64, 64), 255, np.uint8)
    white = np.full((64, 64), 255, np.uint8)
    white[:20] = rng.integers(0, 99, (20, 64))
    found['mostly white'] = white
    found['too small'] = np.zeros((7, 40), np.uint8)
    coma = sum(light(shape, uv + [0.8 * k, 0.5 * k], 2 * flux / (1 + k), 0.8 + 0.25 * k)
               for k in range(6))
    found['coma'] = exposed(coma, rng)
    return found


OPTIONS = [
    ExtractionOptions(threshold='fixed', threshold_dn=200.0),
    ExtractionOptions(threshold='iterative', method='grey'),
    ExtractionOptions(method='squared', max_stars=5),
    ExtractionOptions(method='thresholded', psf_sigma_px=1.1),
    ExtractionOptions(method='binary', line_time_us=20.0, readout_direction='up')]
PHOTOGRAPHS = [*sorted((ROOT / 'test' / 'data' / 'night-sky-11deg').glob('*.tiff'))[:2],
               *sorted((ROOT / 'test' / 'data' / 'night-sky-6deg').glob('*.png'))[:2]]


def cases() -> dict[str, tuple[np.ndarray, ExtractionOptions]]:
    """Return images, photographs and one image with other options, by name."""
    simulated, plain = images(), ExtractionOptions()
    return ({name: (image, plain) for name, image in simulated.items()}
            | {path.stem: (read_image(path), plain) for path in PHOTOGRAPHS}
            | {f'{options.threshold} {options.method}': (simulated['30 stars'], options)
               for options in OPTIONS})


# --- what Python found in them ---


def recorded() -> dict[str, Found]:
    """Return what Python found in each of the images."""
    with np.load(RECORDED) as columns:
        names = dict.fromkeys(name.partition('/')[0] for name in columns)
        return {name: Found(*(columns[f'{name}/{field}'] if columns[f'{name}/{field}'].ndim
                              else columns[f'{name}/{field}'].item() for field in Found._fields))
                for name in names}
