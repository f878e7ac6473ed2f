# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Fits of the native core for tests: images whose stars are known, and the functions by ctypes."""

import ctypes
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

import cv2
from native_core import kernels
import numpy as np
from scipy.special import ndtr

_REAL, _POINTER, _WHOLE = ctypes.c_double, ctypes.c_void_p, ctypes.c_int32


class _Frame(ctypes.Structure):
    _fields_ = [
        *((name, _POINTER) for name in ('pixel', 'level', 'noise', 'peak')),
        *((name, _REAL) for name in (
            'median_level', 'median_noise', 'tiles_down', 'tiles_across', 'filter_sigma_px',
            'full_scale_dn')),
        *((name, _WHOLE) for name in (
            'width', 'height', 'tile_rows', 'tile_columns', 'peaks', 'reserved'))]


class _Windows(ctypes.Structure):
    _fields_ = [*((name, _WHOLE) for name in ('count', 'side', 'free', 'iterations')),
                ('gain_dn', _REAL), ('model_error', _REAL),
                *((name, _POINTER) for name in (
                    'data', 'used', 'corner', 'variance', 'star', 'covariance', 'chi2', 'dof',
                    'model', 'own', 'weight', 'shape', 'noise'))]


CENTROID = np.dtype([(name, float) for name in (
    'u', 'v', 'flux', 'snr', 'sigma', 'uu', 'uv', 'vv', 'common_uu', 'common_uv', 'common_vv',
    'delay')])
REJECTED = np.dtype([('u', float), ('v', float), ('kind', np.int32), ('reserved', np.int32)])
KINDS = ('edge', 'saturated', 'hot_pixel', 'cosmic_ray', 'elongated', 'too_wide', 'not_fitted',
         'faint', 'not_streaked', 'disc', 'line')
METHODS = ('gaussian', 'binary', 'grey', 'squared', 'thresholded')
SEGMENTATION = {'gaussian': (0.0, False, 1.0), 'binary': (40.0, False, 1.0),
                'grey': (0.0, False, 1.05), 'squared': (0.0, False, 1.0),
                'thresholded': (0.0, True, 1.0)}
FITS = ((4, 2), (4, 12), (5, 4))  # free parameters and iterations
RECORD = Path(__file__).parent / 'native' / 'fits.npz'
PHOTOGRAPHS = {
    'photograph of 11 deg': 'night-sky-11deg/2019-07-29T204726_Alt60_Azi45_Try1.png',
    'photograph of 6 deg': 'night-sky-6deg/img0.png'}


class Field(NamedTuple):
    """
    What the fits see of a frame.

    image (H, W) uint16; level and noise (rows + 2, columns + 2) of its mesh; medians of both;
    tiles per pixel down and across; sigma of the filter; full scale in DN; peaks (K, 7): u, v,
    top_u, top_v, height, level, noise.
    """

    image: np.ndarray
    level: np.ndarray
    noise: np.ndarray
    medians: tuple[float, float]
    scale: tuple[float, float]
    filter_sigma_px: float
    full_scale_dn: float
    peaks: np.ndarray

    @property
    def native(self) -> _Frame:
        """Return the struct; it points into the arrays of the field."""
        rows, columns = self.level.shape
        height, width = self.image.shape
        return _Frame(
            self.image.ctypes.data, self.level.ctypes.data, self.noise.ctypes.data,
            self.peaks.ctypes.data, *self.medians, *self.scale, self.filter_sigma_px,
            self.full_scale_dn, width, height, rows - 2, columns - 2, len(self.peaks), 0)


def _of(array: np.ndarray) -> int:
    assert array.flags.c_contiguous
    return array.ctypes.data


def profile(centre, sigma, first, count):
    """Return a, da/du and da/dsigma (3, count)."""
    share = np.empty((3, count))
    kernels().stt_profile(centre, sigma, first, count, _of(share))
    return share


class Windows:
    """Windows (K, n, n) and their fits, as stt_windows of kernels.h has them."""

    def __init__(self, count: int, side: int) -> None:
        square = (count, side, side)
        self.data, self.used, self.model, self.own, self.weight = (
            np.zeros(square, np.float32) for _ in range(5))
        self.corner, self.variance = np.zeros((count, 2), np.int32), np.zeros(count)
        self.star, self.chi2, self.dof = np.zeros((count, 5)), np.zeros(count), np.zeros(count)
        self.covariance, self.shape = np.zeros((count, 4, 4)), np.zeros((count, 6))
        self.noise = np.zeros(2)

    def native(self, free=4, iterations=0, noise=(0.0, 0.0)) -> _Windows:
        count, side = self.data.shape[:2]
        arrays = (getattr(self, name) for name, _ in _Windows._fields_[6:])
        return _Windows(count, side, free, iterations, *noise, *map(_of, arrays))

    def fit(self, start, noise, free, iterations) -> 'Windows':
        """Fit them from start (K, 5); noise is gain and model error."""
        self.star[:] = start
        self.covariance = np.zeros((len(start), free, free))
        kernels().stt_fit_windows(ctypes.byref(self.native(free, iterations, noise)))
        return self


def cut_windows(field: Field, sigma_px: float) -> Windows:
    """Return the windows of all peaks; star is where their fits start."""
    windows = Windows(len(field.peaks), 2 * max(3, int(np.ceil(3.5 * sigma_px))) + 1)
    kernels().stt_cut_windows(
        ctypes.byref(field.native), sigma_px, ctypes.byref(windows.native()))
    return windows


class Measured(NamedTuple):
    """Stars (N,) CENTROID; rejected (R,) REJECTED."""

    stars: np.ndarray
    rejected: np.ndarray


def _listed(call, most: int) -> tuple[Measured, int]:
    """Call a function with lists for so many stars and rejected spots."""
    stars, rejected = np.zeros(most, CENTROID), np.zeros(most, REJECTED)
    count, left = ctypes.c_int32(most), ctypes.c_int32(most)
    result = call(_of(stars), ctypes.byref(count), _of(rejected), ctypes.byref(left))
    return Measured(stars[:count.value], rejected[:left.value]), result


def measure_points(field, sigma_px, method='gaussian', segmentation=(0.0, 0.0, 1.0),
                   threshold_sigmas=5.5, most=1000) -> tuple[Measured, bool]:
    """Return stars and rejected spots, and whether all are smeared."""
    segments = np.array(segmentation, float)
    measured, smeared = _listed(lambda *lists: kernels().stt_measure_points(
        ctypes.byref(field.native), sigma_px, METHODS.index(method), _of(segments),
        threshold_sigmas, most, *lists), len(field.peaks) + 1)
    return measured, bool(smeared)


def psf_sigma(field, narrow=False) -> tuple[float, bool]:
    """Return the PSF sigma in px, and whether it is certain."""
    sigma = ctypes.c_double()
    certain = kernels().stt_psf_sigma(ctypes.byref(field.native), narrow, ctypes.byref(sigma))
    return sigma.value, bool(certain)


def fit_streaks(field, sky, star, gain_dn, free, iterations):
    """Return star (K, 7), covariance (K, free, free), chi-square and degrees of freedom (K,)."""
    star, count = star.copy(), len(star)
    covariance, chi2, dof = np.zeros((count, free, free)), np.zeros(count), np.zeros(count)
    kernels().stt_fit_streaks(ctypes.byref(field.native), _of(sky), _of(star), _of(covariance),
                              _of(chi2), _of(dof), count, free, gain_dn, iterations)
    return star, covariance, chi2, dof


def photon_gain(field, sky, star, gain_dn) -> float:
    return kernels().stt_photon_gain(
        ctypes.byref(field.native), _of(sky), _of(star), len(star), gain_dn)


def streak_flux(field, sky, star) -> np.ndarray:
    return np.array([kernels().stt_streak_flux(ctypes.byref(field.native), _of(sky[i]),
                                               _of(star[i])) for i in range(len(star))])


def fit_streak(uv, streak_px, weight, shape) -> np.ndarray:
    streak = np.zeros(5)
    kernels().stt_fit_streak(
        _of(uv), _of(streak_px), _of(weight), len(uv), shape[1], shape[0], _of(streak))
    return streak


def joined(one, other) -> np.ndarray:
    both, streak = np.array([one, other], float), np.zeros(5)
    kernels().stt_joined(_of(both[0]), _of(both[1]), _of(streak))
    return streak


def estimate_streak(field, start_px=1.0) -> np.ndarray:
    """Return u_px, v_px, roll, u0, v0 and the width in px; nothing where none was found."""
    found, sigma = np.zeros(6), ctypes.c_double()
    if not kernels().stt_estimate_streak(
            ctypes.byref(field.native), start_px, _of(found), ctypes.byref(sigma)):
        return np.empty(0)
    found[5] = sigma.value
    return found


def search_streaks(field, streak, sigma_px, threshold_sigmas=5.5) -> np.ndarray:
    """Return the peaks (K, 2) after the filter of a streak."""
    places, motion = np.zeros((1000, 2)), np.array(streak, float)
    return places[:kernels().stt_search_streaks(
        ctypes.byref(field.native), _of(motion), sigma_px, threshold_sigmas, _of(places))]


def measure_streaks(field, uv, streak, sigma_px, threshold_sigmas=5.5) -> Measured:
    motion = np.array(streak, float)
    return _listed(lambda *lists: kernels().stt_measure_streaks(
        ctypes.byref(field.native), _of(uv), len(uv), _of(motion), sigma_px, threshold_sigmas,
        *lists), len(uv) + 1)[0]


def pointing_error(field, star, streaked) -> np.ndarray:
    """Return the covariance (2, 2) px^2."""
    covariance = np.zeros((2, 2))
    kernels().stt_pointing_error(
        ctypes.byref(field.native), _of(star), len(star), streaked, _of(covariance))
    return covariance


# --- images ---


class Sky(NamedTuple):
    """
    Stars of an image: sigma_px and number; what they do in the exposure and what is among them.

    streak: u_px, v_px, roll rad; path: offsets (K, 3) u, v, dwell of a kick. gain_dn of a
    photo-electron; pairs are close neighbours; bits 8 or 16.
    """

    sigma_px: float = 1.0
    stars: int = 40
    streak: tuple[float, float, float] = (0.0, 0.0, 0.0)
    path: tuple[tuple[float, float, float], ...] = ((0.0, 0.0, 1.0),)
    gain_dn: float = 1.0
    pairs: int = 0
    bits: int = 16
    faintest: float = 3.0
    brightest: float = 4.6
    hits: int = 0
    side_px: int = 256


def image_of(sky: Sky, seed: int) -> np.ndarray:
    """Return an image (H, W) uint16 of a sky, with a slope, photons and read noise."""
    rng, side = np.random.default_rng(seed), sky.side_px
    uv = rng.uniform(-2, side + 2, (sky.stars, 2))
    for pair in range(sky.pairs):
        uv[2 * pair + 1] = uv[2 * pair] + rng.uniform(-3, 3, 2) * sky.sigma_px
    flux = 10 ** rng.uniform(sky.faintest, sky.brightest, sky.stars)
    edges, (y, x) = np.arange(side + 1) - 0.5, np.mgrid[:side, :side]
    light = 60 + 0.05 * x - 0.02 * y
    u_px, v_px, roll = sky.streak
    length = np.hypot(u_px, v_px)
    for (u, v), brightness in zip(uv, flux):
        middle = (side - 1) / 2
        moved = np.array([u_px - roll * (v - middle), v_px + roll * (u - middle)])
        times = np.linspace(-0.5, 0.5, max(1, int(4 * length))) if length else np.zeros(1)
        for offset_u, offset_v, dwell in sky.path:
            for time in times:
                a, d = (np.diff(ndtr((edges - centre) / sky.sigma_px)) for centre in (
                    u + offset_u + time * moved[0], v + offset_v + time * moved[1]))
                light = light + np.outer(d, a) * (brightness * dwell / len(times))
    dn = sky.gain_dn * rng.poisson(light / sky.gain_dn) + rng.normal(0, 3, light.shape)
    for u, v in rng.integers(0, side, (sky.hits, 2)):
        dn[v, u] += 10 ** rng.uniform(2.5, 4)
    if sky.bits == 8:
        return (dn / 8).round().clip(0, 255).astype(np.uint16)
    return dn.round().clip(0, 16383).astype(np.uint16)


SKIES = {
    'narrow': Sky(0.5), 'points': Sky(), 'wide': Sky(2.2, 25),
    'defocused': Sky(4.5, 8),
    'many': Sky(stars=120), 'pairs': Sky(stars=60, pairs=20), '8 bit': Sky(bits=8),
    'few photons': Sky(gain_dn=8.0), 'saturated': Sky(brightest=5.8, stars=25),
    'hits': Sky(hits=40), 'faint': Sky(faintest=2.2, brightest=3.0),
    'empty': Sky(stars=0), 'one': Sky(stars=1, faintest=4.0, brightest=4.0),
    'streaks of 3 px': Sky(streak=(2.5, 1.7, 0.0)),
    'streaks of 9 px': Sky(streak=(-8.0, 4.0, 0.0), stars=25),
    'streaks of 25 px': Sky(streak=(20.0, 15.0, 0.0), stars=18, faintest=3.8),
    'streaks of 60 px': Sky(streak=(10.0, 59.0, 0.0), stars=12, faintest=4.4, brightest=5.2,
                            side_px=384),
    'wide streaks': Sky(2.0, 15, streak=(12.0, -9.0, 0.0), faintest=4.0),
    'rolled streaks': Sky(streak=(14.0, 3.0, 0.05), stars=25, faintest=3.6),
    '8 bit streaks': Sky(streak=(9.0, 9.0, 0.0), bits=8, stars=20, faintest=4.0),
    'kicks': Sky(path=((-2.0, -1.2, 0.6), (3.0, 1.8, 0.4)), stars=15, faintest=3.6),
    'tails': Sky(path=((0.0, 0.0, 0.6), *((0.5 * k, 0.0, 0.05) for k in range(1, 9))), stars=15,
                 faintest=3.6),
}


def cases() -> dict[str, tuple[np.ndarray, int, tuple[float, ...] | None]]:
    """Return by name the image (H, W) uint16, its bits, and the streak if its stars have one."""
    found = {}
    for seed, (name, sky) in enumerate(SKIES.items()):
        middle = (sky.side_px - 1) / 2
        known = (*sky.streak, middle, middle) if any(sky.streak) else None
        found[name] = image_of(sky, seed), sky.bits, known
    for name, file in PHOTOGRAPHS.items():
        image = cv2.imread(str(Path(__file__).parent / 'data' / file), cv2.IMREAD_UNCHANGED)
        grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        part = np.ascontiguousarray(grey[:640, :640].astype(np.uint16))
        found[name] = part, 8 * grey.dtype.itemsize, None
    return found


def digest_of(image: np.ndarray) -> np.ndarray:
    """Return a digest (32,) of the pixels, by which a record knows its image."""
    return np.frombuffer(sha256(image.tobytes()).digest(), np.uint8)


def field_of(image: np.ndarray, record: dict[str, np.ndarray]) -> Field:
    """Return what the fits see of an image, with background and peaks of its record."""
    level, noise, across, down, sigma_px, full_scale_dn = record['numbers'].tolist()
    return Field(image, record['level'], record['noise'], (level, noise), (across, down),
                 sigma_px, full_scale_dn, record['peaks'])
