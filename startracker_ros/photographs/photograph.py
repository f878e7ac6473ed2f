# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Attitude and lens of a photograph of a camera that nobody has calibrated."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np
from startracker_ros.core.astro.aberration import apparent_directions
from startracker_ros.core.astro.observer_motion import AT_REST, Observer
from startracker_ros.core.attitude.result import AttitudeEstimate
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.centroids import Centroids, ROUND
from startracker_ros.core.identify.identification import Identification, IdentificationOptions
from startracker_ros.core.integrity.systematic_errors import with_observer_error
from startracker_ros.core.maths.rotation import (
    conjugate, matrix_from_quaternion, multiply, pointing_from_quaternion, quaternion_from_axes)
from startracker_ros.core.stages.bodies import Bodies, BodyInImage
from startracker_ros.core.stages.sky_mapping import SkyMapping
from startracker_ros.photographs import blind
from startracker_ros.photographs.blind import BlindIdentifier, COARSEST_PIXEL_DEG, LIKELY_DEG
from startracker_ros.photographs.detections import Detections, FEW_LISTS
from startracker_ros.photographs.estimated_lens import estimate_lens, EstimatedLens
from startracker_ros.photographs.ladder import Attempt, ATTEMPTS, LadderIdentifier
from startracker_ros.photographs.same_camera import Known, SameCamera
from startracker_ros.photographs.searched_fields import HIGHEST_DEG, LOWEST_DEG
from startracker_ros.photographs.solution import MIN_STARS, Solution
from startracker_ros.photographs.tiled import Fields, Place, TiledIdentifier
from startracker_ros.photographs.tiles import TiledCatalogue
from startracker_ros.photographs.unknown_lens import (
    FISHEYES, Lenses, RECTILINEAR, UnknownLensIdentifier)

# Of the nominal camera and of any field; unknown lenses are certain. With a catalogue of the user
# as well, near a position and anywhere. Quads of the field that is given may be wrong half as
# often, and so may the lens of another image: by quads and by few stars, each tried twice.
_SEARCHES, _TILED_SEARCHES, _OF_GIVEN, _OF_ANOTHER = 2, 4, 0.5, 0.125
# A wider lens may be a part of a cropped image, or a fisheye, some of whose stars another lens
# explains: these are searched too. A lens of the field that is given is mostly right.
_CENTRED_DEG, _WIDEST_DEG, _WIDEST_GIVEN_DEG = 28.0, 45.0, 90.0
_SAME_FOCUS = 0.002  # of the focal length, where nobody has touched the lens
_SMALL_RAD = 1e-4  # step from the middle of an image towards its edge


class _Search(NamedTuple):
    """
    How one image is searched.

    any_field is whether that is of other fields than of the camera. A lens of up to enough_deg
    that an earlier search of any field finds needs no such search; with last_resort no lens does.
    """

    camera: Camera
    identify: Callable[[Iterable[Centroids]], Iterator[Attempt]]
    identify_mirrored: Callable[[Iterable[Centroids]], Iterator[Attempt]]
    fov_error: float
    attempts: float
    fields: str
    enough_deg: float = _WIDEST_GIVEN_DEG
    any_field: bool = True
    last_resort: bool = False


class PhotographSolver:
    """
    Solves photographs at one epoch; the lens is fitted to each.

    A nominal camera is believed first, then any field of view is searched as if none were given:
    both together are as strict as one identification. Before them is the lens of another image, if
    that is known. Lenses of which nothing is known, not the centre either, are the last, and
    certain: of cropped images, and fisheyes. A catalogue of the user is searched before all
    others, for the narrow fields that it is made for.
    """

    def __init__(self, epoch_year: float, options: IdentificationOptions = IdentificationOptions(),
                 catalogue: TiledCatalogue | None = None) -> None:
        """Databases are built, or loaded, when they are first searched."""
        self._count = _SEARCHES + _OF_GIVEN + 4 * _OF_ANOTHER + (
            0 if catalogue is None else _TILED_SEARCHES)
        options = replace(options, false_alarm_max=options.false_alarm_max / self._count)
        self._fov_error = options.fov_error_percent / 100
        self._tiled = None if catalogue is None else TiledIdentifier(
            catalogue, epoch_year, options)
        self._blind = BlindIdentifier(epoch_year, options)
        self._unknown = UnknownLensIdentifier(epoch_year, self._blind.wide_quads)
        self._given, self._another = (SameCamera(self._blind, self._unknown, replace(
            options, false_alarm_max=share * options.false_alarm_max))
            for share in (_OF_GIVEN, _OF_ANOTHER))
        self._ladder = lru_cache(maxsize=4)(partial(
            LadderIdentifier, epoch_year=epoch_year, options=options))

    def solve(self, image: np.ndarray, nominal: Camera | None = None,
              observer: Observer = AT_REST, bodies: Bodies = Bodies(),
              place: Place | None = None, known: Known | None = None) -> Solution:
        """
        Return the attitude and the lens of image (H, W) uint8 or uint16, or why not.

        nominal is the camera as far as it is known; observer is how the camera moved; bodies are
        not stars; place is where the image is, for the catalogue of the user; known is what
        another image of the camera has shown.
        """
        detections = Detections(image, None if known is None else known.fixed)
        if known is not None:
            solution = self._of_known(detections, known, nominal, observer, bodies)
            if solution is not None:
                return replace(solution, lens_from=known.source)
            if known.certain:
                most = max(detections, key=len, default=Centroids.empty())
                return Solution.none(
                    known.camera, most, 'no_candidate', f'{len(most)} detections, but not the '
                    f'stars of {known.source} and its lens; other lenses were searched in images '
                    'before, in vain: solve this one alone to search them')
        extraction = detections.extraction
        if len(extraction.centroids) < MIN_STARS:
            most = max(detections, key=len, default=Centroids.empty())
            if len(most) < MIN_STARS:
                camera = _likely(image.shape) if nominal is None else nominal
                return (self._of_peaks(detections, nominal, observer, bodies)
                        or Solution.none(camera, most, extraction.status, extraction.reason))
        return self.solve_lists(detections, image.shape, nominal, observer, bodies, place)

    def solve_lists(self, lists: Iterable[Centroids], shape: tuple[int, int],
                    nominal: Camera | None = None, observer: Observer = AT_REST,
                    bodies: Bodies = Bodies(), place: Place | None = None) -> Solution:
        """
        Return what solve() does, from lists of the spots of an image of shape (H, W) px.

        The lists are tried in turn.
        """
        bright, others = _any_field(self._blind, lists, shape)
        searches = [
            bright,
            _unknown_lens(self._unknown, shape, RECTILINEAR,
                          f'{_CENTRED_DEG:g} to 100 deg off centre', _CENTRED_DEG),
            _unknown_lens(self._unknown, shape, FISHEYES, 'fisheyes up to 190 deg', _WIDEST_DEG),
            others]
        narrow, lacks = self._narrow(None, shape, place)
        searches[:0] = narrow
        if nominal is not None:
            narrow, more_lacks = self._narrow(nominal, shape, place)
            coarse = _coarse(nominal)
            # Quads of its scale are fast; the ladder has lenses of other shapes.
            searches[:0] = narrow if coarse else [
                *narrow, self._quads_of(nominal), self._lenses_about(nominal)]
            lacks = [*dict.fromkeys(more_lacks + lacks), *([coarse] if coarse else [])]
        first = searches[0]
        rejected = ''
        best: Solution | None = None
        for search in searches:
            given = best is not None and best.dropped is None and nominal is not None
            enough_deg = _WIDEST_GIVEN_DEG if given else search.enough_deg
            if best is not None and (search.last_resort
                                     or best.camera.seen_x_rad <= np.radians(enough_deg)):
                continue
            solved, why_not = first_lens(search.identify(lists), search.fov_error)
            rejected = rejected or why_not
            if solved is None:
                mirrored = '' if best else _mirrored(lists, search, shape[1])
                if mirrored:
                    return Solution.none(first.camera, max(lists, key=len), 'mirrored', mirrored)
                continue
            solution, why_not = self._solution(
                solved, search.fov_error, search.attempts, observer, bodies)
            rejected = why_not or rejected
            if solution is not None and (best is None or solution.matched > best.matched):
                best = replace(solution, dropped=nominal) if search.any_field else solution
        if best is not None:
            return best
        most = max(lists, key=len)
        tried = ', '.join(dict.fromkeys(search.fields for search in searches))
        unexplained = '; '.join([
            f'{len(most)} detections, but no known stars among them; searched: {tried}',
            *([f'the best try: {rejected}'] if rejected else []), *lacks,
            'if it is the night sky: focus, expose longer, or subtract a dark frame'])
        return Solution.none(first.camera, most, 'no_candidate', unexplained)

    def _quads_of(self, nominal: Camera) -> _Search:
        """Return the search of a nominal camera as of a known lens."""
        known = Known(nominal, np.empty((0, 4)), '', error=self._fov_error)
        return _Search(
            nominal, partial(self._given.identify, known=known), lambda _: iter(()),
            self._fov_error, 1 / _OF_GIVEN, _about(nominal), any_field=False)

    def _lenses_about(self, nominal: Camera) -> _Search:
        """Return the search of a nominal camera by lenses of many shapes."""
        ladder = self._ladder(nominal)
        return _Search(nominal, ladder.identify, ladder.identify_mirrored, self._fov_error,
                       ATTEMPTS, _about(nominal), any_field=False)

    def _of_peaks(self, detections: Detections, nominal: Camera | None, observer: Observer,
                  bodies: Bodies) -> Solution | None:
        """
        Return what an image with fewer than MIN_STARS detections shows, None for nothing.

        Its peaks may be stars of a nominal camera: of any field they would be too few.
        """
        if nominal is None or _coarse(nominal):
            return None
        search = self._lenses_about(nominal)
        solved, _ = first_lens(search.identify(detections), search.fov_error)
        return None if solved is None else self._solution(
            solved, search.fov_error, search.attempts, observer, bodies)[0]

    def _of_known(self, lists: Iterable[Centroids], known: Known, nominal: Camera | None,
                  observer: Observer, bodies: Bodies) -> Solution | None:
        """Return what an image shows by the lens of another one, None for nothing."""
        solved, _ = first_lens(self._another.identify(lists, known), known.error)
        attempts = 1 / _OF_ANOTHER
        if solved is None and nominal is not None and not _coarse(nominal):
            solved, _ = first_lens(self._ladder(nominal).identify_few(
                lists, known.camera, _SAME_FOCUS, _OF_ANOTHER), known.error)
            attempts = FEW_LISTS / _OF_ANOTHER
        if solved is None:
            return None
        return self._solution(solved, known.error, attempts, observer, bodies)[0]

    def _solution(self, solved: tuple[Attempt, EstimatedLens], fov_error: float, attempts: float,
                  observer: Observer, bodies: Bodies) -> tuple[Solution | None, str]:
        """Return the solution of an accepted lens, or why it is rejected without the bodies."""
        attempt, lens, seen = _without_bodies(*solved, bodies, fov_error)
        if lens.rejected:
            return None, lens.rejected
        found = _identification(attempt, lens, attempts * self._count, observer)
        return Solution(attempt.centroids, found, lens.camera, lens.sigma_px,
                        SkyMapping(lens.camera, lens.attitude.quaternion), seen, fitted=True,
                        lens_error=lens.error), ''

    def _narrow(self, nominal: Camera | None, shape: tuple[int, int], place: Place | None
                ) -> tuple[list[_Search], list[str]]:
        """Return the searches with the catalogue of the user, and what it lacks for others."""
        searches, lacks = list[_Search](), list[str]()
        if self._tiled is None:
            return searches, lacks
        for one in (None,) if place is None else (place, None):
            fields = self._tiled.fields_about(nominal, self._fov_error, one)
            if fields is None:
                continue
            lack = self._tiled.lack(one, fields)
            if not lack:
                searches.append(_with_tiles(self._tiled, shape, fields, one, nominal))
            elif one is place:
                lacks.append(lack)
        return searches, lacks


def _mirrored(lists: Iterable[Centroids], search: _Search, width: int) -> str:
    """Return what a mirrored image shows, empty if it is not mirrored."""
    flipped = [replace(centroids, uv=[width - 1, 0] + centroids.uv * [-1, 1],
                       covariance=ROUND) for centroids in lists]
    solved, _ = first_lens(search.identify_mirrored(flipped), search.fov_error)
    if solved is None:
        return ''
    _, lens = solved
    ra_deg, dec_deg, _ = np.degrees(pointing_from_quaternion(
        multiply(lens.attitude.quaternion, lens.camera.middle_axes)))
    return (f'mirrored: flipped from left to right it shows {lens.matched} stars about right '
            f'ascension {ra_deg:.2f}, declination {dec_deg:.2f} deg; flip it with --mirror')


def _likely(shape: tuple[int, int]) -> Camera:
    """Return the camera that stands for that of an image of shape (H, W)."""
    height, width = shape
    return Camera.from_fov(width, height, LIKELY_DEG)


def _coarse(nominal: Camera) -> str:
    """Return why the pixels of a nominal camera resolve no stars, empty if they do."""
    pixel_deg = float(np.degrees(nominal.pixel_rad))
    return (f'of {np.degrees(nominal.fov_x_rad):.3g} deg a pixel is {pixel_deg:.2g} deg wide: '
            f'more than {COARSEST_PIXEL_DEG} resolves no stars'
            if pixel_deg > COARSEST_PIXEL_DEG else '')


def _any_field(identifier: BlindIdentifier, lists: Iterable[Centroids], shape: tuple[int, int]
               ) -> tuple[_Search, _Search]:
    """
    Return the searches of an image of shape (H, W) of any field: by the brightest stars, by all.

    The second one takes the longest of all searches, and continues the first one.
    """
    bright, others = identifier.identify_in_parts(lists, shape)
    first = _Search(
        _likely(shape), lambda _: bright,
        lambda flipped: identifier.identify_quickly(flipped, shape),
        blind.LENS_ERROR, blind.ATTEMPTS,
        f'{LOWEST_DEG:g} to {HIGHEST_DEG:g} deg')
    return first, first._replace(identify=lambda _: others, identify_mirrored=lambda _: iter(()),
                                 last_resort=True)


def _with_tiles(identifier: TiledIdentifier, shape: tuple[int, int], fields: Fields,
                place: Place | None, nominal: Camera | None) -> _Search:
    """Return the search of an image of shape (H, W) with a catalogue of the user."""
    height, width = shape
    where = 'anywhere' if place is None else str(place)
    identify = partial(identifier.identify, shape=shape, fields=fields, place=place)
    return _Search(
        nominal or Camera.from_fov(width, height, fields.high_deg), identify,
        partial(identify, quickly=True), blind.LENS_ERROR, blind.ATTEMPTS,
        f'{fields.low_deg:.3g} to {fields.high_deg:.3g} deg in {identifier.catalogue.folder} '
        f'{where}', any_field=nominal is None)


def _unknown_lens(identifier: UnknownLensIdentifier, shape: tuple[int, int], lenses: Lenses,
                  fields: str, enough_deg: float) -> _Search:
    """Return the search of an image of shape (H, W) by lenses of a kind."""
    return _Search(
        _likely(shape),
        partial(identifier.identify, shape=shape, lenses=lenses),
        partial(identifier.identify_mirrored, shape=shape, lenses=lenses),
        blind.LENS_ERROR, 1, fields, enough_deg)


def _about(nominal: Camera) -> str:
    return f'about {np.degrees(nominal.fov_x_rad):.3g} deg'


def first_lens(attempts: Iterable[Attempt], fov_error: float
               ) -> tuple[tuple[Attempt, EstimatedLens] | None, str]:
    """Return the first attempt whose lens is accepted, and why the last other one is not."""
    rejected = ''
    for attempt in attempts:
        if attempt.identification.attitude is None:
            continue
        lens = estimate_lens(attempt, fov_error)
        if not lens.rejected:
            return (attempt, lens), rejected
        rejected = lens.rejected
    return None, rejected


def _without_bodies(attempt: Attempt, lens: EstimatedLens, bodies: Bodies, fov_error: float
                    ) -> tuple[Attempt, EstimatedLens, tuple[BodyInImage, ...]]:
    """Return the lens fitted without the spots of bodies, which may be near a catalogue star."""
    matched = lens.star >= 0
    magnitude = np.where(matched, attempt.onboard.magnitude[lens.star], np.nan)
    mapping = SkyMapping(lens.camera, lens.attitude.quaternion)
    seen, spots = bodies.in_image(mapping), bodies.spots(mapping, attempt.centroids, magnitude)
    if (spots & matched).any():
        found = attempt.identification
        attempt = attempt._replace(
            centroids=attempt.centroids.select(~spots),
            identification=replace(found, hip=found.hip[~spots], magnitude=found.magnitude[~spots],
                                   residual_px=found.residual_px[~spots]))
        lens = estimate_lens(attempt, fov_error)
    return attempt, lens, seen


def _identification(attempt: Attempt, lens: EstimatedLens, attempts: float,
                    observer: Observer) -> Identification:
    """Return the stars of the fitted lens."""
    onboard, known = attempt.onboard, lens.star >= 0
    hip = np.where(known, onboard.hip[lens.star], 0).astype(np.int32)
    magnitude = np.where(known, onboard.magnitude[lens.star], np.nan)
    false_alarm = attempt.identification.false_alarm_probability * attempts
    centroids = attempt.centroids.select(known)
    attitude = _apparent(lens.attitude, lens.camera, observer, centroids.uv,
                         np.hypot(centroids.sigma_px, lens.sigma_px))
    return Identification('identified', f'{lens.matched} stars', hip, magnitude,
                          lens.residual_px, attitude, lens.focal_ratio, min(false_alarm, 1.0))


def _apparent(attitude: AttitudeEstimate, camera: Camera, observer: Observer, uv: np.ndarray,
              sigma: np.ndarray) -> AttitudeEstimate:
    """
    Return an attitude that was fitted to directions without aberration, with it.

    The lens has what differs from that of the middle of the image. uv (N, 2) px with sigma (N,)
    are the stars.
    """
    if observer.state is not None:
        axes = matrix_from_quaternion(multiply(attitude.quaternion, camera.middle_axes))
        z, y = apparent_directions(
            np.stack([axes[:, 2], axes[:, 2] + _SMALL_RAD * axes[:, 1]]), observer.state)
        quaternion = multiply(quaternion_from_axes(z, y), conjugate(camera.middle_axes))
        attitude = replace(
            attitude, quaternion=-quaternion if quaternion[3] < 0 else quaternion)
    return with_observer_error(attitude, observer, camera.unproject(uv), sigma)
