# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Association, tracks and stars in view of the native core for tests: functions by ctypes."""

from dataclasses import replace
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

from native_core import call
import numpy as np
from startracker_ros.core import native
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.sky_grid import sky_grid
from startracker_ros.core.identify.sky_file import sky_arrays
from startracker_ros.core.stored_arrays import write_arrays
from startracker_ros.core.track.options import ASSOCIATIONS

CAMERAS = (
    Camera.from_fov(512, 512, 20.0),
    replace(Camera.from_fov(512, 512, 12.0), distortion=(-0.1, 0.02, 1e-3, -5e-4, 0.0)),
    Camera(512, 512, 200.0, 200.0, 250.0, 260.0, (-0.02, 0.004, 0.0, 0.0), 'equidistant'))
MODEL_NAMES = ('attitude', 'constant_velocity', 'coordinated_turn', 'sna')
SOLVERS = ('quest', 'davenport', 'svd', 'triad')
MOST = 20_000
RECORD = Path(__file__).parent / 'native' / 'bank.npz'
MAX_STEPS = 1_000_000


def real(array) -> np.ndarray:
    return np.ascontiguousarray(array, float)


def whole(array) -> np.ndarray:
    return np.ascontiguousarray(array, np.int32)


def centroid_structs(centroids) -> np.ndarray:
    """Return centroids (N,) as an array of CENTROID."""
    covariance, common = centroids.covariance, centroids.common
    made = np.zeros(len(centroids), native.CENTROID)
    columns = (*centroids.uv.T, centroids.flux, centroids.snr, centroids.sigma_px,
               covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1], common[:, 0, 0],
               common[:, 0, 1], common[:, 1, 1], centroids.delay_s)
    for name, column in zip(native.CENTROID.names, columns):
        made[name] = column
    return made


def options_struct(options) -> np.ndarray:
    """Return options of the tracker as a TRACKING_OPTIONS."""
    made = np.zeros((), native.TRACKING_OPTIONS)
    names = {'model': MODEL_NAMES, 'solver': SOLVERS, 'association': ASSOCIATIONS}
    for name in native.TRACKING_OPTIONS.names:
        value = getattr(options, name)
        made[name] = names[name].index(value) if name in names else value
    return made


def hint_struct(stamp_ns, quaternion, covariance, rate=(0, 0, 0), rate_covariance=0) -> np.ndarray:
    made = np.zeros((), native.HINT)
    made['stamp_ns'], made['quaternion'] = stamp_ns, quaternion
    made['covariance_rad2'], made['rate_rad_s'] = covariance, rate
    made['rate_covariance'] = rate_covariance
    return made


# --- association ---


def marginals(weight, max_steps=MAX_STEPS) -> np.ndarray:
    return events(weight, max_steps)[0]


def events(weight, max_steps=MAX_STEPS) -> tuple[np.ndarray, float, np.ndarray]:
    """Return the probabilities, the logarithm of the sum of all events, and what is left out."""
    probability, left_out = real(weight).copy(), np.zeros(2, np.int32)
    log_sum = call('stt_marginalise', probability, *probability.shape, max_steps, left_out)
    return probability, log_sum, left_out


def upper(covariance) -> np.ndarray:
    """Return uu, uv, vv (N, 3) of symmetric matrices (N, 2, 2)."""
    covariance = np.asarray(covariance, float).reshape(-1, 2, 2)
    return real(np.column_stack([covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]]))


def associate(predicted, covariance, uv, error, detection, factor=None, confirmed=None):
    """Return probabilities (N, M + 1), unassociated (M,) and what is left out (2,)."""
    tracks, centroids = len(predicted), len(uv)
    probability, left_out = np.empty((tracks, centroids + 1)), np.zeros(2, np.int32)
    unassociated = np.zeros(centroids, np.int32)
    call('stt_associate', real(predicted), upper(covariance), tracks, real(uv), upper(error),
         centroids, real(detection), -1 if factor is None else ASSOCIATIONS.index(factor),
         None if confirmed is None else whole(confirmed), probability, unassociated, left_out)
    return probability, unassociated.astype(bool), left_out


def associate_stars(predicted, covariance, uv, variance, detection, association, confirmed=None):
    error = np.asarray(variance, float)[:, None, None] * np.eye(2)
    return associate(predicted, covariance, uv, error, detection, association, confirmed)[:2]


def update(state, covariance, uv, variance, probability):
    state, covariance = real(state).copy(), real(covariance).copy()
    call('stt_update', real(probability), len(state), real(uv), real(variance), len(uv), state,
         covariance)
    return state, covariance


def predict(state, covariance, transition, noise):
    state, covariance = real(state).copy(), real(covariance).copy()
    call('stt_predict', real(transition), real(noise), len(state), state, covariance)
    return state, covariance


# --- motion ---


def star_motion(model, dt_s, rate_rad_s, noise) -> tuple[np.ndarray, np.ndarray]:
    transition, covariance = np.empty((4, 4)), np.empty((4, 4))
    call('stt_star_motion', MODEL_NAMES.index(model), float(dt_s), float(rate_rad_s), real(noise),
         transition, covariance)
    return transition, covariance


def coordinated_turn(dt_s, rate_rad_s, density) -> tuple[np.ndarray, np.ndarray]:
    return star_motion('coordinated_turn', dt_s, rate_rad_s, density)


def rolled(camera, rate_rad_s, dt_s) -> np.ndarray:
    transition = np.empty((4, 4))
    call('stt_rolled', camera.native, float(rate_rad_s), float(dt_s), transition)
    return transition


def turn_curvature(camera, uv, rate, dt_s) -> np.ndarray:
    curvature = np.empty((len(uv), 4))
    call('stt_turn_curvature', camera.native, real(uv), len(uv), real(rate), float(dt_s),
         curvature)
    return curvature


def moved_by(camera, uv, variance, rate, rate_covariance):
    state, covariance = np.empty((len(uv), 4)), np.empty((len(uv), 4, 4))
    call('stt_moved_by', camera.native, real(uv), real(variance), len(uv), real(rate),
         real(rate_covariance), state, covariance)
    return state, covariance


def propagated(camera, uv, rate, dt_s) -> np.ndarray:
    moved = np.empty((len(uv), 2))
    call('stt_propagated', camera.native, real(uv), len(uv), real(rate), float(dt_s),
         moved)
    return moved


def body_rate(camera, uv, velocity, covariance):
    """Return the rate (3,) and its covariance (3, 3), None where it is not fixed."""
    rate, rate_covariance = np.empty(3), np.empty((3, 3))
    fixed = call('stt_body_rate', camera.native, real(uv), real(velocity),
                 upper(covariance), len(uv), rate, rate_covariance)
    return (rate, rate_covariance) if fixed else None


def rate_between_frames(camera, before, after, dt_s):
    rate = np.empty(3)
    agree = call('stt_rate_between_frames', camera.native, centroid_structs(before),
                 len(before), centroid_structs(after), len(after), float(dt_s), rate)
    return rate if agree else None


def star_neighbourhood(camera, predicted, icrf, uv, sigma_px) -> np.ndarray:
    assigned = np.zeros(len(predicted), np.int32)
    call('stt_star_neighbourhood', camera.native, real(predicted), real(icrf),
         len(predicted), real(uv), real(np.broadcast_to(sigma_px, len(uv))), len(uv), assigned)
    return assigned


# --- sky ---


def apparent(observer, natural) -> np.ndarray:
    found = np.empty((len(natural), 3))
    call('stt_apparent', observer, real(natural), len(natural), found)
    return found


class View:
    """The sky of a file as an observer sees it, and the stars in view; one at a time."""

    def __init__(self, sky, camera, years=0.0, moved_au=(0.0, 0.0, 0.0)) -> None:
        self._sky = sky
        assert call('stt_open_view', sky, camera.native, float(years), real(moved_au))

    def add_observer(self, stamp_ns, observer) -> None:
        call('stt_add_observer', np.array(stamp_ns, np.int64), observer)

    def look(self, stamp_ns) -> tuple[int, np.ndarray]:
        """Return the version of the directions, and sigma of velocity and epoch."""
        sigma = np.empty(2)
        return call('stt_look', np.array(stamp_ns, np.int64), sigma), sigma

    def stars(self, star) -> tuple[np.ndarray, np.ndarray]:
        """Return directions (N, 3) and which are crowded (N,)."""
        direction, crowded = np.empty((len(star), 3)), np.empty(len(star), np.int32)
        call('stt_sky_stars', whole(star), len(star), direction, crowded)
        return direction, crowded.astype(bool)

    def in_view(self, q):
        return self._listed('stt_stars_in_view', real(q))

    def beside(self, q, uv, reach_px):
        return self._listed('stt_stars_beside', real(q), real(uv), len(uv), float(reach_px))

    def _listed(self, name, *arguments):
        star, sensor, uv = np.empty(MOST, np.int32), np.empty((MOST, 3)), np.empty((MOST, 2))
        count = call(name, *arguments, MOST, star, sensor, uv)
        return star[:count], sensor[:count], uv[:count]

    def unexplained(self, q, uv, sigma_px, reach_px, reach_sigmas) -> np.ndarray:
        centroids = np.zeros(len(uv), native.CENTROID)
        centroids['u_px'], centroids['v_px'] = np.asarray(uv).T
        centroids['sigma_px'] = sigma_px
        left = np.empty(len(uv), np.int32)
        return left[:call('stt_unexplained', real(q), centroids, len(uv), float(reach_px),
                          float(reach_sigmas), left)]

    def visible(self, q, rate, faintest) -> tuple[np.ndarray, np.ndarray]:
        """Return pixels (N, 2) and velocities (N, 2)."""
        found = np.empty((MOST, 4))
        count = call('stt_visible_stars', real(q), real(rate), float(faintest), MOST, found)
        return found[:count, :2], found[:count, 2:]

    def predict(self, q, covariance, rate, faintest, most) -> np.ndarray:
        found = np.empty(most, native.PREDICTION)
        return found[:call('stt_predict_stars', real(q), real(covariance), real(rate),
                           float(faintest), most, found)]

    def new_stars(self, q, covariance, uv, flux, sigma_px, zero_point, tolerance):
        """Return stars (K,) and centroids (K,)."""
        free, found = real(np.column_stack([uv, flux, sigma_px])), np.empty((MOST, 2), np.int32)
        count = call('stt_new_stars', real(q), real(covariance), free, len(free),
                     float(zero_point), float(tolerance), MOST, found)
        return tuple(found[:count].T)

    def fit_identified(self, options, centroids, hip):
        """Return stars, CENTROID, quaternion, covariance and scale, or the code of the reason."""
        options, centroids = (np.ascontiguousarray(each) for each in (options, centroids))
        star, kept = np.empty(len(hip), np.int32), np.empty(len(hip), native.CENTROID)
        attitude, scale, reason = np.empty(13), np.empty(1), np.zeros((), native.REASON)
        count = call('stt_fit_identified', options, centroids,
                     whole(hip), len(hip), star, kept, attitude, scale, reason)
        if not count:
            return int(reason['code'])
        return (star[:count], kept[:count], attitude[:4], attitude[4:].reshape(3, 3),
                float(scale[0]))


def fit_rotation(camera, icrf, uv, sigma_px, candidate, solver='quest'):
    """Return attitude (13,), scale, rms px, chi2, stars (4,), normalised and inlier; None."""
    count = len(uv)
    attitude, figures = np.empty(13), np.empty(4)
    normalised, inlier = np.empty(count), np.empty(count, np.int32)
    if not call('stt_fit_rotation', camera.native, real(icrf), real(uv), real(sigma_px),
                whole(candidate), count, SOLVERS.index(solver), attitude, figures, normalised,
                inlier):
        return None
    return attitude, figures, normalised, inlier.astype(bool)


def start_of_two(first, first_scale, second, second_scale) -> np.ndarray:
    """Return rate, its covariance and the cross covariance (21,)."""
    rates = np.empty(21)
    call('stt_start_of_two', first, float(first_scale), second, float(second_scale), rates)
    return rates


def start_of_hint(hint, frame, scale, max_gap_s, hinted=True) -> np.ndarray:
    """Return the same, nothing where the hint does not start."""
    rates = np.empty(21)
    return rates if call('stt_start_of_hint', hint, frame, float(scale), float(max_gap_s),
                         int(hinted), rates) else rates[:0]


# --- models of stars ---

TRACK = np.dtype([
    ('state', float, 4), ('covariance', float, (4, 4)),
    *((name, float) for name in ('variance', 'flux', 'snr', 'sigma_px', 'residual_px',
                                 'probability', 'star', 'age', 'missed', 'confirmed'))])


class Updated(NamedTuple):
    """What a frame did: tracks (N,) TRACK; attitude, figures and normalised as fit_rotation()."""

    tracks: np.ndarray
    good: bool
    has_fit: bool
    attitude: np.ndarray
    figures: np.ndarray
    normalised: np.ndarray
    rate: np.ndarray
    rate_covariance: np.ndarray
    uv: np.ndarray
    unassociated: np.ndarray
    uses_gyro: bool
    gyro_trouble: int


class Model:
    """A model of stars, of the sky of the last View."""

    def __init__(self, options, start, roll) -> None:
        self.options = options
        call('stt_open_model', self.options, start, real(roll))

    def add(self, star, centroids, confirmed) -> None:
        for one, centroid in zip(star, centroids):
            assert call('stt_add_star', self.options, int(one), np.array(centroid), int(confirmed))

    def select(self, kept, confirmed) -> None:
        """Keep tracks (N,), of which some are confirmed."""
        call('stt_select_tracks', whole(kept), whole(confirmed))

    def update(self, stamp_ns, centroids, roll) -> Updated:
        count, most = len(centroids), int(self.options['max_stars'])
        tracks, attitude, figures = np.zeros(most, TRACK), np.full(13, np.nan), np.empty(4)
        rates, normalised, uv = np.empty(12), np.empty(most), np.empty((count, 2))
        unassociated, flags = np.empty(count, np.int32), np.empty(5, np.int32)
        call('stt_update_model', self.options, np.array(stamp_ns, np.int64), centroids, count,
             real(roll), tracks, attitude, figures, rates, normalised, uv, unassociated, flags)
        return Updated(
            tracks[:flags[4]], bool(flags[0]), bool(flags[1]), attitude, figures,
            normalised[:flags[4]], rates[:3], rates[3:].reshape(3, 3), uv,
            unassociated.astype(bool), bool(flags[2]), int(flags[3]))


def sky_struct(file) -> np.ndarray:
    """Return the SKY of bytes (N,) uint8."""
    return np.array((file.ctypes.data, len(file)), native.SKY)


def aligned(content) -> np.ndarray:
    """Return bytes at an address that the core accepts."""
    block = np.empty(len(content) + 64, np.uint8)
    first = -block.ctypes.data % 64
    made = block[first:first + len(content)]
    made[:] = np.frombuffer(content, np.uint8)
    return made


def sky_file(camera, direction, **columns) -> np.ndarray:
    """
    Return the bytes of a sky file with stars of these directions (N, 3), brightest first.

    columns are others of STARS, by default those of single stars of magnitude 5 that do not move.
    """
    count = len(direction)
    grid = sky_grid(real(direction))
    cells = {'cells': np.array(grid.cells, np.int32), 'start': grid.start, 'member': grid.member}
    stars = {
        'hip': np.arange(1, count + 1, dtype=np.int32), 'direction': real(direction),
        'magnitude': np.full(count, 5.0), 'crowded': np.zeros(count, bool),
        'blended': np.zeros(count, bool), 'variation_mag': np.zeros(count, np.float32),
        'motion': np.zeros((count, 3), np.float32), 'parallax_rad': np.zeros(count, np.float32)}
    patterns = {f'pattern_{name}': array for name, array in cells.items()}
    pairs = {name: array[:name.endswith('below')] for name, array in _any_sky(camera).items()
             if name.startswith(('pair_', 'bright_'))}
    content = BytesIO()
    write_arrays(content, {**_any_sky(camera), **stars, **columns, **cells, **patterns, **pairs})
    return aligned(content.getvalue())


@cache
def _any_sky(camera) -> dict[str, np.ndarray]:
    return sky_arrays(camera, 2026.0)
