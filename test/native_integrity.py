# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Integrity of the native core for tests: its functions by ctypes, and a record of real runs.

native/integrity.npz has what its functions were given in runs of transcripts.py and what they
gave, from when they were written in Python.
"""

from collections.abc import Sequence
import ctypes
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

from native_core import call, filled, kernels
import numpy as np
from startracker_ros.core import native
from startracker_ros.core.integrity.checks import check_of

RECORD = Path(__file__).parent / 'native' / 'integrity.npz'
SOLVERS = ('quest', 'davenport', 'svd', 'triad')
FIGURES = 9
# of st_reason_code
TRUSTED, PARALLEL = 600, 610
GYRO_OPTIONS = np.array([3.0, 0.15, 100.0, 0.1])
"""The defaults: drift deg/h, noise deg/sqrt(h), range deg/s, change of the rate deg/s^2."""

TRUST_PX, TRUST_STARS = 1.0, 4
PROBABILITIES = np.array([1e-7, 1e-5])


# --- the native functions ---


class Solved(NamedTuple):
    """Code and figures of the reason; quaternion, covariance, chi2, residuals (N,) rad."""

    code: int
    figures: np.ndarray
    quaternion: np.ndarray
    covariance: np.ndarray
    chi2: float
    residual_rad: np.ndarray


def solve(solver: str, sensor, icrf, sigma_rad) -> Solved:
    """Return the attitude of directions (N, 3) with errors (N,)."""
    count = len(sigma_rad)
    figures, solution, residual = np.zeros(FIGURES), np.zeros(14), np.full(count, np.nan)
    code = call('stt_solve', SOLVERS.index(solver), sensor, icrf, sigma_rad, count, figures,
                solution, residual)
    return Solved(code, figures, solution[:4], solution[4:13].reshape(3, 3), solution[13],
                  residual)


def best_rotation(solver: str, sensor, icrf, weight, sigma_rad) -> tuple[np.ndarray, float]:
    """Return the matrix (3, 3) and the gap."""
    matrix = np.zeros((3, 3))
    gap = call('stt_best_rotation', SOLVERS.index(solver), sensor, icrf, weight, sigma_rad,
               len(weight), matrix)
    return matrix, gap


def refine(matrix, sensor, icrf, weight, most_steps=5) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the refined matrix, the covariance and the determinant."""
    refined, covariance = matrix.copy(), np.zeros((3, 3))
    determinant = call('stt_refine', sensor, icrf, weight, len(weight), most_steps, refined,
                       covariance)
    return refined, covariance, determinant


def triad(sensor, icrf, first, second) -> np.ndarray:
    return filled('stt_triad', (3, 3), sensor, icrf, len(sensor), first, second)


def cramer_rao(sensor, sigma_rad) -> np.ndarray:
    return filled('stt_cramer_rao', (3, 3), sensor, sigma_rad, len(sigma_rad))


def mean_chi2(solved: Solved, icrf, sigma_rad) -> float:
    solution = np.concatenate([solved.quaternion, solved.covariance.ravel(), [0.0]])
    return call('stt_mean_chi2', solution, icrf, sigma_rad, len(sigma_rad))


def fit_error_ellipses(camera, uv, error, icrf, solved: Solved) -> Solved:
    """Return the best fit to errors (N, 3): uu, uv, vv."""
    solution = np.concatenate([
        solved.quaternion, solved.covariance.ravel(), [solved.chi2]])
    residual = solved.residual_rad.copy()
    call('stt_fit_error_ellipses', camera, uv, error, icrf, len(uv), solution, residual)
    return solved._replace(quaternion=solution[:4], covariance=solution[4:13].reshape(3, 3),
                           chi2=solution[13], residual_rad=residual)


def fit_rows(camera, star) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Return product and energy (13,), edges (12,) and chi2 of stars (N, 15)."""
    pattern = np.zeros(38)
    chi2 = call('stt_fit_rows', camera, star, len(star), pattern)
    return pattern[:13], pattern[13:26], pattern[26:], chi2


def find_pattern(camera, star, memory) -> str:
    """Return the pattern in words, empty for none; changes the memory (4,)."""
    figures = np.zeros(FIGURES)
    return sentence(call('stt_find_pattern', camera, star, len(star), memory, figures), figures)


def contradiction(expected, uv, present_px) -> str:
    """Return what contradicts an attitude, in words; expected (N, 4), uv (M, 2)."""
    figures = np.zeros(FIGURES)
    return sentence(call('stt_contradiction', expected, len(expected), uv, len(uv), present_px,
                         figures), figures)


def sentence(code: int, figures: Sequence[float]) -> str:
    """Return the sentence of a reason of a check, empty for none."""
    if not code:
        return ''
    check = check_of(code)
    assert check is not None, code
    return check.sentence(figures)


def _sizes() -> list[int]:
    sizes = np.zeros(2, np.int32)
    call('stt_integrity_sizes', sizes)
    return sizes.tolist()


class LensError:
    """As in lens_error.h."""

    def __init__(self, camera) -> None:
        self._camera, self._memory = camera, np.zeros(_sizes()[0], np.uint8)
        self.value_px = self.scale = self.scale_sigma = 0.0

    def add(self, index, star) -> bool:
        """Add stars (N, 15) of catalogue entries (N,)."""
        known = np.zeros(3)
        first = call('stt_add_to_lens_error', self._camera, index.astype(np.int32), star,
                     len(star), self._memory, known)
        self.value_px, self.scale, self.scale_sigma = known
        return bool(first)


class StampJitter:
    """As in stamp_jitter.h."""

    def __init__(self) -> None:
        self._memory = np.zeros(_sizes()[1], np.uint8)
        call('stt_start_jitter', self._memory)
        self.sigma_s, self.turn_rad = 0.0, np.zeros(3)

    def interrupt(self) -> None:
        call('stt_interrupt_jitter', self._memory)

    def add(self, stamps_ns, before, predicted, corrected, turn, covariance) -> None:
        """Add states (7,): quaternion, rate; stamps are those of before and of the frame."""
        known = np.zeros(4)
        call('stt_add_to_jitter', *map(int, stamps_ns), before, predicted, corrected, turn,
             covariance, self._memory, known)
        self.sigma_s, self.turn_rad = known[0], known[1:]


def compare_gyro(rate_ns, rate, frame_ns, frame) -> np.ndarray:
    """Return of frames (F, 25) whether the gyro contradicts and how many agreed, (F, 2)."""
    found = np.zeros((len(frame), 2), np.int32)
    call('stt_compare_gyro', GYRO_OPTIONS, rate_ns, rate, len(rate), frame_ns, frame, len(frame),
         found)
    return found


def protection_level(covariance, sensor, sigma_rad, residual_rad, probabilities=PROBABILITIES,
                     rejected=0) -> np.ndarray:
    star = np.column_stack([sensor, sigma_rad, residual_rad])
    return filled('stt_protection_level', (3,), covariance, star, len(star), probabilities,
                  rejected)


def trust_options(solver='quest', min_stars=TRUST_STARS, max_residual_px=TRUST_PX) -> np.ndarray:
    return np.array((max_residual_px, *PROBABILITIES, SOLVERS.index(solver), min_stars),
                    native.TRUST_OPTIONS)


class Trusted(NamedTuple):
    """Code and figures of the reason, and numbers (18,) as of stt_trust_stars."""

    code: int
    figures: np.ndarray
    numbers: np.ndarray


def trust_stars(camera, options, star, observer=(0.0, 0.0), previous=None) -> Trusted:
    """Return the attitude of stars (N, 11); observer is sigma of velocity and epoch."""
    figures, numbers = np.zeros(FIGURES), np.zeros(18)
    code = call('stt_trust_stars', camera, options, star, len(star), *observer, previous, figures,
                numbers)
    return Trusted(code, figures, numbers)


def trust_tracks(camera, options, quaternion, covariance, chi2, star, previous=None) -> Trusted:
    """Return a tracked attitude, of stars (N, 7)."""
    figures, numbers = np.zeros(FIGURES), np.zeros(18)
    code = call('stt_trust_tracks', camera, options, quaternion, covariance, chi2, star,
                len(star), previous, figures, numbers)
    return Trusted(code, figures, numbers)


def checks() -> dict[str, Any]:
    """Return the table of the library for tests."""
    count = ctypes.c_size_t()
    table = kernels().st_checks(ctypes.byref(count))
    found = np.frombuffer(ctypes.string_at(table, native.CHECK.itemsize * count.value),
                          native.CHECK)
    return {native.text_at(one['name']): one for one in found}


# --- inputs ---


def directions(rng, count, half_width=0.1, noise=1e-4):
    """Return sensor and ICRF directions (N, 3) of noisy stars, and their sigma (N,) rad."""
    q = rng.normal(size=4)
    x, y, z, w = q / np.linalg.norm(q)
    matrix = np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                       [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                       [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])
    sensor = np.column_stack([rng.uniform(-half_width, half_width, (count, 2)), np.ones(count)])
    sensor /= np.linalg.norm(sensor, axis=1, keepdims=True)
    icrf, sigma = sensor @ matrix.T, rng.uniform(1, 3, count) * noise
    sensor = sensor + rng.normal(size=sensor.shape) * sigma[:, None]
    return sensor / np.linalg.norm(sensor, axis=1, keepdims=True), icrf, sigma


def solver_inputs() -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return sensor, ICRF and sigma by name: good fields, and what no attitude follows from."""
    rng = np.random.default_rng(7)
    found = {f'{count} stars, {half_width:g} rad': directions(rng, count, half_width)
             for count in (2, 3, 5, 20, 60) for half_width in (0.003, 0.1, 1.0)}
    sensor, icrf, sigma = directions(rng, 6)

    def changed(name, *, star=2, sensor=sensor, icrf=icrf, sigma=sigma, **values):
        arrays = {'sensor': sensor.copy(), 'icrf': icrf.copy(), 'sigma': sigma.copy()}
        for key, value in values.items():
            arrays[key.removesuffix('_')][star] = value
        found[name] = arrays['sensor'], arrays['icrf'], arrays['sigma']

    changed('same star twice', sensor_=sensor[4], icrf_=icrf[4])
    changed('same direction in the image alone', sensor_=sensor[4])
    changed('not a number', sensor_=[np.nan, 0, 1])
    changed('infinite', icrf_=[np.inf, 0, 1])
    changed('sigma not a number', sigma_=np.nan)
    changed('sigma of zero', sigma_=0.0)
    changed('sigma below zero', sigma_=-1e-4)
    changed('zero length', sensor_=np.zeros(3))
    changed('zero length and sigma of zero', sensor_=np.zeros(3), sigma_=0.0)
    changed('not a number and sigma of zero', icrf_=[0, np.nan, 0], sigma_=0.0)
    changed('very long', sensor_=1e200 * sensor[2])
    changed('very short', icrf_=1e-200 * icrf[2])
    changed('one star decides alone', sigma=np.where(np.arange(6) == 1, 1e-9, 1.0))
    found['mirrored'] = sensor * [-1, 1, 1], icrf, sigma
    axis = np.array([0.1, -0.2, 1.0])
    found['parallel'] = np.outer([1, 2, 3.0], axis), np.outer([3, 1, 2.0], axis), sigma[:3]
    found['0.1 arcsec apart'] = *(np.array([[0, 0, 1], [5e-7, 0, 1.0]]),) * 2, sigma[:2]
    found['opposite'] = *(np.array([[0, 0, 1], [0, 0, -1.0]]),) * 2, sigma[:2]
    half_turn = np.diag([1.0, -1.0, -1.0])
    found['half turn'] = sensor, sensor @ half_turn, sigma
    contradicting = icrf.copy()
    contradicting[:2] = icrf[1::-1]
    found['two stars exchanged'] = (
        sensor, contradicting, np.where(np.arange(6) < 2, 0.9, 1) * 1e-4)
    found['no rotation'] = *rng.normal(size=(2, 8, 3)), 10 ** rng.uniform(-5, -4, 8)
    return found


ROW_FAULTS = ('as recorded', 'torn', 'line time', 'scale', 'stars off', 'few stars')


def with_row_fault(fault: str, star: np.ndarray, camera: Any, scale: float) -> np.ndarray:
    """
    Return stars (N, 16) of a frame, catalogue entry first, with residuals by a fault.

    scale is the one that is known of the lens, which has predicted the stars.
    """
    star = star[:6] if fault == 'few stars' else star.copy()
    u, v, velocity = star[:, 1], star[:, 2], star[:, 14:]
    away = np.column_stack([u - camera['cx_px'], v - camera['cy_px']])
    residual = star[:, 3:5]
    if fault == 'torn':
        residual += np.where(v > 0.6 * camera['height_px'], -0.02, 0.0)[:, None] * velocity
    elif fault == 'line time':
        residual += 20e-6 * (v - camera['height_px'] / 2)[:, None] * velocity
    elif fault == 'scale':
        residual += (1e-3 - scale) * away
    elif fault == 'stars off':
        angle = 2.4 * star[:, 0]
        residual += 0.3 * np.column_stack([np.cos(angle), np.sin(angle)]) - scale * away
    return star


EXPECTED_FAULTS = ('as recorded', 'ghost', 'late', 'hidden', 'elsewhere')


def with_stars_elsewhere(fault: str, star: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Return centroids (M, 2) of which a part does not show the expected stars (N, 4)."""
    low = uv[:, 1] > np.median(star[:, 1])
    if fault == 'ghost':
        return np.where(low[:, None], uv + [12.0, -7.0], uv)
    if fault == 'late':
        away = np.hypot(*(uv[:, None] - star[:, :2]).transpose(2, 0, 1))
        return np.where(low[:, None], uv + 0.1 * star[away.argmin(axis=1), 2:] + 1.0, uv)
    if fault == 'hidden':
        return uv[~low].copy()
    if fault == 'elsewhere':
        scattered = np.random.default_rng(len(uv)).uniform(0, 1000, (len(uv), 2))
        return np.where(low[:, None], scattered, uv)
    return uv


STAMP_FAULTS = ('as recorded', '5 ms', 'shaken')


def with_stamp_errors(fault: str, numbers: np.ndarray) -> np.ndarray:
    """Return states, turns and covariances (F, 33) of frames with timestamp errors or shaken."""
    rng, numbers = np.random.default_rng(4), numbers.copy()
    if fault == '5 ms':
        numbers[:, 21:24] += rng.normal(0, 5e-3, (len(numbers), 1)) * numbers[:, 11:14]
    elif fault == 'shaken':
        speed = np.linalg.norm(numbers[:, 11:14], axis=1, keepdims=True)
        numbers[:, 21:24] += rng.normal(0, 5e-3, (len(numbers), 3)) * speed
    return numbers


def camera_struct(camera) -> np.ndarray:
    """Return an st_camera of a plumb_bob lens without distortion."""
    struct = np.zeros((), native.CAMERA)
    for name in ('width', 'height', 'fx', 'fy', 'cx', 'cy'):
        struct[f'{name}_px'] = getattr(camera, name)
    assert not any(camera.distortion)
    return struct


# --- the record ---

RUNS = {  # how many frames
    'torn frames 1 deg/s': 36, 'rolling shutter 1 deg/s': 12, 'list, timestamp errors of 5 ms': 40,
    'list, sway 0.05 deg, 1 s, exposed 0.1 s': 40, 'slews to 3 deg/s, gyro': 60,
    'slews, gyro in deg/s': 60, 'list, three images in a row one frame late, 1 deg/s': 40,
    'half of the image covered': 40, '30 false, 20 % missing': 20, 'smear 5 deg/s, 20 ms': 20,
    'start with 100 spots': 20}


class CovarianceInput(NamedTuple):
    """Stars (N, ...) of an attitude with its covariance."""

    sensor: np.ndarray
    sigma: np.ndarray
    q: np.ndarray
    motion: np.ndarray
    residual: np.ndarray
    P: np.ndarray
    common: np.ndarray
    rate: np.ndarray
    camera: Any


def covariance_inputs() -> list[CovarianceInput]:
    from startracker_ros.core.camera.model import Camera
    rng, found = np.random.default_rng(12), []
    for count in (2, 3, 4, 7, 14, 40):
        sensor, _, sigma = directions(rng, count)
        root, pointing = rng.normal(size=(3, 3)) * 1e-5, rng.normal(size=(2, 2))
        q = rng.normal(size=4)
        found.append(CovarianceInput(
            sensor, sigma, q / np.linalg.norm(q), rng.normal(size=(count, 3)) * 1e-7,
            np.abs(rng.normal(size=count)) * sigma, cramer_rao(sensor, sigma) + root @ root.T,
            pointing @ pointing.T, rng.normal(size=3) * 0.01, Camera.from_fov(1024, 768, 12.0)))
    return found


def spans(counts: np.ndarray) -> list[slice]:
    """Return where each of lists of these lengths is, one after the other."""
    ends = [0, *np.cumsum(counts).tolist()]
    return [slice(*one) for one in pairwise(ends)]
