# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The data sheet of a night: images in, rows out."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
import json
from pathlib import Path

import numpy as np
from scipy.optimize import minimize
from startracker_ros.core.astro.epoch import utc
from startracker_ros.core.astro.ground_site import Site
from startracker_ros.core.attitude.result import WRONG_SIGMAS
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.maths.rotation import ARCSEC, attitude_error
from startracker_ros.io.progress import progress
from startracker_ros.io.table import Result
from startracker_ros.tools.figures.correctness import count_wrong, nees_of
from startracker_ros.tools.night.earth_motion import EarthMotion, fit_motion
from startracker_ros.tools.night.frames import Frame, observe, published_errors, star_rows
from startracker_ros.tools.night.intervals import (
    block_mean, block_trend, bootstrapped, chi_square_mean, CONFIDENCE, Interval, root, share,
    successive_sigma, UNKNOWN)
from startracker_ros.tools.night.patterns import (
    field_columns, field_degree, fit_pattern, frame_normals, Pattern, PHASE_COLUMNS,
    phase_columns, single_coefficient, Stars, turns_of, without_turns)
from startracker_ros.tools.night.sources import camera_of_bag, NightError, timed_images, TimedImage

# --- the rows, in the terms of ECSS-E-ST-60-20C Rev. 2 ---

AXES = {'cross boresight': slice(0, 2), 'about boresight': slice(2, 3)}
_HOUR_S = 3600.0
_JOINED_INTERVALS = 2.5
"""Of the usual time between frames: neighbours that are farther apart are not compared."""
_LEAST_STARS = 3
_LEAST_PUBLISHED = 20
_COARSE_JITTER_S, _COARSE_LINE_S = 10e-3, 100e-6
"""Drivers stamp to some ms, rolling shutters need 5 to 100 us a line: wider intervals say
nothing."""

MET, MISSED, NOT_OBSERVABLE = 'met', 'missed', 'not observable'

BIN_MAG = 0.5
_LEAST_WIDTH_MAG = 0.01

_SIGMAS = 1.96
_SLOWEST_RAD_S = 1e-9


@dataclass(frozen=True)
class NightRow:
    """
    One figure: ours, errors 1 sigma, with its 95 % confidence interval low to high.

    goal is that of an ideal instrument; it is met where the interval contains it. What the motion
    cannot show is not observable: the interval is what may be hidden. simulated is the figure of
    the data sheet by simulation, None without one.
    """

    section: str
    case: str
    ours: float | None
    unit: str
    low: float | None = None
    high: float | None = None
    goal: float | None = None
    verdict: str = ''
    method: str = ''
    simulated: float | None = None


def row(section: str, case: str, found: Interval, unit: str, method: str,
        goal: float | None = None, coarse: float = np.inf) -> NightRow:
    """Return a row; one that meets its goal within an interval wider than coarse says nothing."""
    value, low, high = (float(each) for each in found)
    meets = goal is not None and low <= goal <= high
    if np.isnan(value) or meets and high - low > coarse:
        return NightRow(section, case, None, unit, low, high, goal, NOT_OBSERVABLE, method)
    verdict = '' if goal is None else MET if meets else MISSED
    return NightRow(section, case, value, unit, low, high, goal, verdict, method)


@dataclass(frozen=True)
class Night:
    """What was seen of a camera in a night, and the motion that fits it."""

    camera: Camera
    frames: Sequence[Frame]
    motion: EarthMotion
    tracking: bool
    site: bool

    @cached_property
    def stars(self) -> Stars:
        """Return the catalogue stars of the frames with an attitude of their own."""
        return star_rows(self.frames, self.motion, self.camera)

    @cached_property
    def seen(self) -> Stars:
        """Return the stars with a centroid, of frames with enough of them."""
        seen = self.stars.select(self.stars.seen)
        return seen.select(np.bincount(seen.frame)[seen.frame] >= _LEAST_STARS)

    @cached_property
    def degree(self) -> int:
        """Return the degree of the polynomials of the field."""
        return field_degree(self.seen, self.camera)

    @cached_property
    def pattern(self) -> Pattern | None:
        """Return what repeats with the pixel phase, then with the place in the field."""
        if not self.degree:
            return None
        uv = self.seen.uv
        return fit_pattern(self.seen, np.concatenate(
            [phase_columns(uv), field_columns(uv, self.camera, self.degree)], axis=-1))

    @cached_property
    def used(self) -> np.ndarray:
        """Return the indices (U,) of the frames that have an attitude by these stars."""
        return np.unique(self.seen.frame)

    @cached_property
    def stamps_ns(self) -> np.ndarray:
        """Return the stamps (U,) of these frames."""
        return np.array([self.frames[index].stamp_ns for index in self.used], np.int64)

    @cached_property
    def time_s(self) -> np.ndarray:
        """Return their times (U,) in s from the middle of the night."""
        return self.motion.seconds(self.stamps_ns)

    @cached_property
    def joined(self) -> np.ndarray:
        """Return which neighbours (U - 1,) are close in time."""
        steps = np.diff(self.time_s)
        return steps <= _JOINED_INTERVALS * np.median(steps)

    @cached_property
    def errors(self) -> np.ndarray:
        """Return the errors (U, 3) rad of single frames about the motion, without the pattern."""
        shift = self.seen.residual - (0 if self.pattern is None else self.pattern.shift_px)
        return turns_of(self.seen, shift[..., None])[self.used, :, 0]

    @cached_property
    def steady_errors(self) -> np.ndarray:
        """Return these errors less the straight line that fits them."""
        return _without_line(self.time_s, self.errors)

    def noise(self, axes: slice) -> Interval:
        """Return the temporal noise in rad about axes."""
        return successive_sigma(self.steady_errors[:, axes], self.joined)

    @cached_property
    def covariance(self) -> np.ndarray:
        """Return the covariances (U, 3, 3) rad^2 that the stars state."""
        return np.linalg.inv(frame_normals(self.seen)[self.used])

    @cached_property
    def rates_rad_s(self) -> np.ndarray:
        """Return the rates (F, 3) of all frames with respect to ICRF."""
        return self.motion.icrf_rate(np.array([frame.stamp_ns for frame in self.frames]))


def _without_line(time_s: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return values (F, A) less their straight lines."""
    powers = np.vander(time_s / np.abs(time_s).max(), 2)
    return values - powers @ np.linalg.lstsq(powers, values, None)[0]


def all_rows(night: Night) -> list[NightRow]:
    """Return the rows of a night."""
    return [each for section in (_frame_rows, _error_rows, _motion_rows, _covariance_rows,
                                 _stamp_rows, _refraction_rows, _star_rows, _width_rows)
            for each in section(night)]


def _frame_rows(night: Night) -> Iterator[NightRow]:
    section, count = 'Availability', len(night.frames)
    published = sum(frame.published is not None for frame in night.frames)
    alone = sum(frame.alone is not None for frame in night.frames)
    yield row(section, 'frames with a published attitude', share(published, count), '%',
              'star tracker')
    yield row(section, 'frames identified by themselves', share(alone, count), '%',
              'images, one by one')
    matched = np.bincount(night.seen.frame)[night.used].astype(float)
    yield row(section, 'stars of a frame, mean', block_mean(matched), 'stars',
              'images, one by one')
    yield NightRow(section, 'stars of a frame, fewest', float(matched.min()), 'stars',
                   method='images, one by one')


def _error_rows(night: Night) -> Iterator[NightRow]:
    section = 'Error of a single image'
    for axis, columns in AXES.items():
        yield row(section, f'temporal noise, {axis}', night.noise(columns).scaled(1 / ARCSEC),
                  'arcsec', 'successive frames')
    kinds = {'field-of-view spatial error': (slice(PHASE_COLUMNS, None),
                                             f'polynomial of degree {night.degree}'),
             'pixel spatial error': (slice(0, PHASE_COLUMNS), 'sine of the pixel phase')}
    for name, (chosen, method) in kinds.items():
        part = None if night.pattern is None else night.pattern.part(chosen)
        for axis, columns in AXES.items():
            found = UNKNOWN
            if part is not None:
                turns = turns_of(night.seen, part.columns)[night.used]
                found = part.rms((turns - turns.mean(axis=0))[:, columns])
            yield row(section, f'{name}, {axis}', found.scaled(1 / ARCSEC), 'arcsec', method, 0.0)
        found = UNKNOWN if part is None else part.rms(without_turns(night.seen, part.columns))
        yield row(section, f'{name}, of a star',
                  found.scaled(night.camera.pixel_rad / ARCSEC), 'arcsec', method, 0.0)


def _motion_rows(night: Night) -> Iterator[NightRow]:
    section, method = 'Motion of the mount', 'means of blocks'
    slopes = [block_trend(night.time_s, axis, 1) for axis in night.errors.T]
    mount, sky = night.motion.rate_rad_s, night.rates_rad_s[night.used].mean(axis=0)
    if night.tracking:
        yield row(section, 'rate on the Earth', _length(mount, slopes).scaled(1 / ARCSEC),
                  'arcsec/s', method)
        for axis, errors in zip('xyz', night.errors.T):
            change = block_trend(night.time_s, errors, 2)
            yield row(section, f'change of the rate about {axis}',
                      change.scaled(2 * _HOUR_S / ARCSEC), 'arcsec/s/h', method, 0.0)
    else:
        yield row(section, 'rate of the sky', _length(sky, slopes).scaled(1 / ARCSEC), 'arcsec/s',
                  method, float(np.linalg.norm(sky - mount)) / ARCSEC)
        for axis, rate, slope in zip('xyz', mount, slopes):
            drift = Interval(*(rate + end for end in slope))
            yield row(section, f'drift about {axis}', drift.scaled(_HOUR_S / ARCSEC), 'arcsec/h',
                      method, 0.0)
    for axis, columns in AXES.items():
        square = np.mean(night.steady_errors[:, columns] ** 2, axis=1)
        slow = block_mean(square - night.noise(columns).value ** 2)
        yield row(section, f'slow motion about the line, {axis}',
                  Interval(*np.sqrt(np.maximum(slow, 0))).scaled(1 / ARCSEC), 'arcsec',
                  'scatter beyond the temporal noise', 0.0)


def _length(rate: np.ndarray, slopes: Sequence[Interval]) -> Interval:
    """Return the length of a rate (3,) rad/s and of its changes by slopes of its axes."""
    axis = rate / np.linalg.norm(rate)
    value = float(axis @ (rate + [slope.value for slope in slopes]))
    half = float(np.linalg.norm(axis * [(slope.high - slope.low) / 2 for slope in slopes]))
    return Interval(value, value - half, value + half)


def _covariance_rows(night: Night) -> Iterator[NightRow]:
    section, method = 'Covariance', 'published, about the fitted motion'
    stamps, error, covariance = published_errors(night.frames, night.motion)
    nees, wrong = UNKNOWN, UNKNOWN
    if len(stamps) >= _LEAST_PUBLISHED:
        about = _without_line(night.motion.seconds(stamps), error)
        square = nees_of(about, covariance)
        # Two parameters of each axis were fitted.
        nees = chi_square_mean(square * len(square) / (len(square) - 2), 3)
        sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        wrong = share(count_wrong(about, sigma).wrong, len(about))
    yield row(section, 'normalised error squared of an axis', nees, '', method, 1.0)
    yield row(section, f'attitudes beyond {WRONG_SIGMAS:g} sigma on an axis', wrong, '%', method,
              0.0)


def _stamp_rows(night: Night) -> Iterator[NightRow]:
    section = 'Stamps'
    yield NightRow(section, 'delay, constant part', None, 'ms', verdict=NOT_OBSERVABLE,
                   method='at a constant rate it is a constant turn')
    rate = night.rates_rad_s[night.used].mean(axis=0)
    jitter = stamp_jitter_s(night.errors, night.covariance, rate, night.joined)
    yield row(section, 'jitter', jitter.scaled(1e3), 'ms', 'errors along the motion', 0.0,
              1e3 * _COARSE_JITTER_S)
    line = line_time_s(night.seen, night.camera, night.rates_rad_s, night.degree)
    yield row(section, 'time of a line, rolling shutter', line.scaled(1e6), 'us',
              'shear along the motion', 0.0, 1e6 * _COARSE_LINE_S)


def _refraction_rows(night: Night) -> Iterator[NightRow]:
    method = 'shear towards the zenith' if night.site else 'needs --site'
    found = UNKNOWN if not night.seen.refraction.any() else single_coefficient(
        night.seen, night.camera, night.seen.refraction, night.degree)
    yield row('Refraction', 'that of the stars over that of the air',
              Interval(*(1 + end for end in found)), '', method, 1.0, 1.0)


def _star_rows(night: Night) -> Iterator[NightRow]:
    section, method = 'Detection', 'stars of the catalogue'
    yield row(section, 'limiting magnitude, half are found', limiting_magnitude(night.stars),
              'mag', method)
    for lower, found in shares_by_magnitude(night.stars):
        yield row(section, f'found, V {lower:g} to {lower + BIN_MAG:g}', found, '%', method)


def _width_rows(night: Night) -> Iterator[NightRow]:
    camera = night.camera
    uv = np.concatenate([frame.width_uv for frame in night.frames])
    width = np.concatenate([frame.width_px for frame in night.frames])
    frame = np.repeat(np.arange(len(night.frames)), [len(each.width_px) for each in night.frames])
    middle = np.array([camera.width - 1, camera.height - 1]) / 2
    radius = np.linalg.norm(uv - middle, axis=1) / np.linalg.norm(middle)
    for name, low, high in (('within 1/3', 0, 1 / 3), ('1/3 to 2/3', 1 / 3, 2 / 3),
                            ('beyond 2/3', 2 / 3, np.inf)):
        chosen = (radius >= low) & (radius < high)
        medians = np.array([np.median(width[chosen & (frame == each)])
                            for each in np.unique(frame[chosen])])
        yield row('Star images', f'PSF sigma, {name} of the half diagonal', block_mean(medians),
                  'px', 'Gaussian fits of bright stars')


def shares_by_magnitude(stars: Stars) -> list[tuple[float, Interval]]:
    """
    Return the lower end of each bin of magnitude and the share in % of its stars found.

    The frames of one star are not independent: each star is a trial with the share of its frames.
    """
    magnitude, found, trials = per_star(stars)
    bins = np.floor(magnitude / BIN_MAG)
    return [(float(each * BIN_MAG), share(float(np.sum((found / trials)[bins == each])),
                                          int(np.sum(bins == each))))
            for each in np.unique(bins)]


def limiting_magnitude(stars: Stars) -> Interval:
    """
    Return the magnitude of which half of the stars are found; unknown where all or none are.

    Logistic regression p = 1 / (1 + exp((m - m50) / w)), its interval by resampling stars.
    """
    magnitude, found, trials = per_star(stars)
    if not 0 < found.sum() < trials.sum():
        return UNKNOWN
    return bootstrapped(lambda rows: _half(magnitude[rows], found[rows], trials[rows]),
                        len(magnitude))


def per_star(stars: Stars) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return magnitude, frames with a centroid and frames in view (S,) of each star."""
    _, first, star = np.unique(stars.star, return_index=True, return_inverse=True)
    return (stars.magnitude[first], np.bincount(star, stars.seen).astype(float),
            np.bincount(star).astype(float))


def _half(magnitude: np.ndarray, found: np.ndarray, trials: np.ndarray) -> float:
    if not 0 < found.sum() < trials.sum():
        return np.nan
    start = np.array([np.average(magnitude, weights=np.maximum(found, 1e-9)), np.log(0.3)])

    def loss(parameters: np.ndarray) -> float:
        width = max(float(np.exp(parameters[1])), _LEAST_WIDTH_MAG)
        steps = (magnitude - parameters[0]) / width
        return float(found @ np.logaddexp(0, steps) + (trials - found) @ np.logaddexp(0, -steps))
    return float(minimize(loss, start, method='Nelder-Mead').x[0])


def stamp_jitter_s(errors: np.ndarray, covariance: np.ndarray, rate_rad_s: np.ndarray,
                   joined: np.ndarray) -> Interval:
    """
    Return the scatter of the stamps by errors (F, 3) rad of attitudes turning at rate (3,) rad/s.

    An error of a stamp is a turn along the motion. What errors along it have more than those
    across it, both across the boresight, is that of the stamps. covariance (F, 3, 3) are the
    errors that the stars state, for their ratio.
    """
    rate = rate_rad_s[:2]
    speed = float(np.linalg.norm(rate))
    if speed < _SLOWEST_RAD_S:
        return UNKNOWN
    axes = np.array([rate, [-rate[1], rate[0]]]) / speed
    along, across = (successive_sigma(errors[:, :2] @ axis[:, None], joined) for axis in axes)
    stated = [float(np.mean(np.einsum('i,fij,j->f', axis, covariance[:, :2, :2], axis)))
              for axis in axes]
    expected = across.value ** 2 * stated[0] / stated[1]
    count = int(np.count_nonzero(joined))
    degrees = 2 * count ** 2 / max(3 * count - 1, 1)
    sigma = np.sqrt(2 * (along.value ** 4 + expected ** 2) / degrees)
    square = along.value ** 2 - expected
    return root(square, float(sigma), square > _SIGMAS * sigma).scaled(1 / speed)


def line_time_s(stars: Stars, camera: Camera, rates_rad_s: np.ndarray, degree: int) -> Interval:
    """Return the delay from row to row by residuals of frames turning at rates (F, 3) rad/s."""
    flow = np.einsum('nki,ni->nk', stars.jacobian, rates_rad_s[stars.frame])
    rows = stars.uv[:, 1] - (camera.height - 1) / 2
    return single_coefficient(stars, camera, flow * rows[:, None], degree)


# --- the command ---

_LEAST_FRAMES = 20
_WRONG_RAD = np.radians(1.0)
"""No mount shakes so much: an attitude that is off by more is that of another field."""
_TURNING_RAD_S = 5 * ARCSEC
"""No tripod gives way so fast, a third of the rate of the sky."""


def night(source: Path, camera: Camera | None, *, site: Site | None = None,
          start_year: float | None = None, interval_s: float | None = None,
          tracking: bool = False, namespace: str | None = None,
          datasheet: Path | None = None) -> Result:
    """
    Return the data sheet of the camera that took the images of a bag, a folder or a video.

    camera None is that of the bag. The camera stands still on the Earth or, tracking, turns there
    at a constant rate about a constant axis. datasheet is JSON of `startracker datasheet`.
    NightError for images that are not a night of it, and for a file that is no such document;
    ImageError, BagError.
    """
    simulated = {} if datasheet is None else _figures_at_rest(datasheet)
    camera = camera or camera_of_bag(source, namespace)
    left_out = list[str]()
    images = timed_images(source, start_year, interval_s, namespace, zone_needed=site is not None,
                          left_out=left_out)
    seen = measure(progress(images, 'night'), camera, site, tracking)
    rows = [replace(each, simulated=simulated.get(each.case)) for each in all_rows(seen)]
    stamps = np.array([frame.stamp_ns for frame in seen.frames])
    goals = [each for each in rows if each.verdict in (MET, MISSED)]
    return Result('night', rows, {
        'begin': utc(stamps[0]), 'end': utc(stamps[-1]), 'frames': len(stamps),
        **({'left_out': '; '.join(left_out)} if left_out else {}),
        'interval_s': float(np.median(np.diff(stamps))) * 1e-9,
        'camera': f'{camera.width} x {camera.height} px, {np.degrees(camera.fov_x_rad):.2f} deg',
        'mount': 'constant rate' if tracking else 'fixed to the Earth',
        'site': 'none: no refraction, no diurnal aberration' if site is None else
        f'{site.latitude_deg:g} {site.longitude_deg:g} {site.height_m:g}',
        'goals': len(goals),
        'missed': '; '.join(each.case for each in goals if each.verdict == MISSED) or 'none',
        'missed_by_chance': (1 - CONFIDENCE) * len(goals),
    }, notes={'missed_by_chance': 'expected, of an ideal instrument'})


def _figures_at_rest(datasheet: Path) -> dict[str, float | None]:
    """Return the figures of a data sheet at rest, by the cases of a night."""
    try:
        rows = json.loads(datasheet.read_bytes())['rows']
        return {each['case'].replace(', 0 deg/s', ''): each['ours'] for each in rows}
    except (ValueError, KeyError, TypeError) as error:
        raise NightError(f'{datasheet}: not a document of startracker datasheet --json') from error


def measure(images: Iterable[TimedImage], camera: Camera, site: Site | None, tracking: bool
            ) -> Night:
    """Return what the images of a camera show, with the motion that fits them; NightError."""
    frames = observe(images, camera, site)
    known = [index for index, frame in enumerate(frames) if frame.alone is not None]
    if len(known) < _LEAST_FRAMES:
        raise NightError(f'{len(known)} of {len(frames)} images are identified, at least '
                         f'{_LEAST_FRAMES} are needed')
    stamps = np.array([frames[index].stamp_ns for index in known])
    quaternions = np.array([frames[index].alone for index in known])
    motion = fit_motion(stamps, quaternions, tracking)
    off_rad = np.linalg.norm(attitude_error(quaternions, motion.icrf(stamps)), axis=1)
    for index in np.array(known)[off_rad > _WRONG_RAD]:
        frames[index] = frames[index]._replace(alone=None)
    found = int(np.sum(off_rad <= _WRONG_RAD))
    if found < _LEAST_FRAMES:
        does = 'turns at a constant rate' if tracking else 'stands still on the Earth'
        raise NightError(f'{found} of {len(known)} attitudes are those of a camera that {does}, '
                         f'at least {_LEAST_FRAMES} are needed')
    rate_rad_s = float(np.linalg.norm(motion.rate_rad_s))
    if rate_rad_s > _TURNING_RAD_S and not tracking:
        raise NightError(f'the camera turns by {rate_rad_s / ARCSEC:.3g} arcsec/s on the Earth: '
                         '--tracking, if that is the rate of its mount')
    return Night(camera, frames, motion, tracking, site is not None)
