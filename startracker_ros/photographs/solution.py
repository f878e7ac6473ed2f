# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What one image shows: its stars, attitude and camera."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.identify.identification import Identification
from startracker_ros.core.maths.rotation import (
    ARCSEC, multiply, pointing_from_quaternion, radec_from_unit)
from startracker_ros.core.stages.annotate import BODY, FOUND, IDENTIFIED
from startracker_ros.core.stages.bodies import BodyInImage
from startracker_ros.core.stages.sky_mapping import SkyMapping
from startracker_ros.core.values import Summarised
from startracker_ros.io.images.images import Photograph
from startracker_ros.photographs.deep_sky import deep_sky_in
from startracker_ros.photographs.lens_fit import LensError
from startracker_ros.photographs.picture import annotated, captioned, Colour, TEXT
from startracker_ros.photographs.sip import Cards, image_wcs
from startracker_ros.photographs.sky_marks import DEEP_SKY, NAMED
from startracker_ros.photographs.uncatalogued import Uncatalogued, uncatalogued

MIN_STARS = 4
_MOST_LISTED = 4  # of the uncatalogued, below a picture
_LARGEST_FOV_ERROR = 0.01  # 1 sigma of the angle of an edge, as a share, for a fisheye

STAR = np.dtype([
    ('hip', np.int32), ('magnitude', float), ('ra_deg', float), ('dec_deg', float),
    ('u_px', float), ('v_px', float), ('flux_dn', float), ('snr', float), ('sigma_px', float),
    ('residual_px', float)])
"""A row of Solution.stars."""


class NoSolutionError(ValueError):
    """An image without an attitude, where one is needed; the text says why it has none."""


@dataclass(frozen=True, repr=False)
class Solution(Summarised):
    """
    What one image shows.

    Attributes:
        centroids: Detections of the image (Centroids), those of false stars included.
        identification: Which catalogue star each of them is (Identification).
        camera: The lens, fitted to the stars where `fitted`.
        lens_px: 1 sigma error per axis that the lens leaves in the pixel of a star, px.
        sky: Pixels to ICRS directions and back; None without an attitude.
        bodies: Planets, Moon and Sun in the image; empty without an attitude.
        dropped: The camera that was given, where the image has another field of view.
        turned_over: Whether the rows are in the other order than those of the image that was
            given: that one is mirrored.
        mirrored: Whether the image that was given is mirrored: it is solved flipped from left to
            right, and all pixels are of the flipped image.
        fitted: Whether the lens is fitted to this image, not that of a calibrated camera.
        lens_error: The error of the fitted lens at each pixel (LensError); else None.
        photograph: The image as it was solved, with the order of the rows of its file.
        epoch_year: Julian year of the star places.
        lens_from: The image whose lens was used to identify the stars; empty for none.

    The attitude is that of the sensor axes of `camera`, +z its optical axis: star directions
    turned by it and projected by `camera` are the pixels of the stars. Pointing and roll are
    those of the middle of the image where `fitted`, else of the optical axis.

    """

    centroids: Centroids
    identification: Identification
    camera: Camera
    lens_px: float = float('nan')
    sky: SkyMapping | None = None
    bodies: tuple[BodyInImage, ...] = ()
    dropped: Camera | None = None
    turned_over: bool = False
    mirrored: bool = False
    fitted: bool = False
    lens_error: LensError | None = None
    photograph: Photograph | None = None
    epoch_year: float = float('nan')
    lens_from: str = ''

    @classmethod
    def none(cls, camera: Camera, centroids: Centroids, status: str, reason: str) -> 'Solution':
        """Return the solution without an attitude; an empty reason is that of too few stars."""
        count = len(centroids)
        if status == 'ok':
            status = 'too_few_stars'
            reason = (f'{count} detections that may be stars, at least {MIN_STARS} are needed: '
                      'expose longer, or take a wider field')
        nothing = Identification(status, reason, np.zeros(count, np.int32),
                                 np.full(count, np.nan), np.full(count, np.nan), None, 1.0, 1.0)
        return cls(centroids, nothing, camera)

    def of_tries(self, count: int) -> 'Solution':
        """Return the solution as that of one of so many searches."""
        found = self.identification
        return replace(self, identification=replace(found, false_alarm_probability=min(
            count * found.false_alarm_probability, 1.0)))

    @property
    def solved(self) -> bool:
        """Whether there is an attitude."""
        return self.identification.attitude is not None

    @property
    def status(self) -> str:
        """Return 'identified', or what kind of reason there is for no attitude."""
        return self.identification.status

    @property
    def reason(self) -> str:
        """Why there is no attitude; empty with one."""
        return '' if self.solved else self.identification.reason

    @property
    def quaternion(self) -> np.ndarray | None:
        """
        Attitude (4,) float64 of the sensor axes of `camera`: q_icrf_from_sensor; else None.

        In the order x, y, z, w: v_icrf = R(q) v_sensor.
        """
        attitude = self.identification.attitude
        return None if attitude is None else attitude.quaternion

    @property
    def covariance_sensor(self) -> np.ndarray | None:
        """Covariance (3, 3) rad^2 of the error about sensor axes, None without an attitude."""
        attitude = self.identification.attitude
        return None if attitude is None else attitude.covariance_sensor

    @property
    def ra_deg(self) -> float:
        """Right ascension of the middle of the image, or of a calibrated axis, deg; else NaN."""
        return self._pointing_deg[0]

    @property
    def dec_deg(self) -> float:
        """Declination of the middle of the image, or of a calibrated axis, deg; else NaN."""
        return self._pointing_deg[1]

    @property
    def roll_deg(self) -> float:
        """Position angle of image up, from celestial north through east, deg; else NaN."""
        return self._pointing_deg[2]

    @property
    def fov_deg(self) -> float:
        """
        Horizontal field of view with the distortion, deg; NaN without an attitude.

        NaN as well for a fisheye whose stars leave the angle of one of these edges uncertain by
        1 % (1 sigma) and more, or which has a black margin there.
        """
        if not self.solved or not self._shows_its_edges:
            return float('nan')
        return float(np.degrees(self.camera.seen_x_rad))

    @property
    def _shows_its_edges(self) -> bool:
        """Return whether the angles of the left and of the right edge are known."""
        camera = self.camera
        if self.lens_error is None or not camera.model.equidistant:
            return True
        edges = np.array([[-0.5, camera.cy], [camera.width - 0.5, camera.cy]])
        return bool((self.lens_error.relative(edges) < _LARGEST_FOV_ERROR).all())

    @property
    def matched(self) -> int:
        """Number of identified stars."""
        return self.identification.matched

    @property
    def residual_arcsec(self) -> float:
        """Rms angle between stars and catalogue directions, arcsec; NaN without an attitude."""
        attitude = self.identification.attitude
        if attitude is None:
            return float('nan')
        return float(np.sqrt(np.mean(attitude.residual_rad ** 2)) / ARCSEC)

    @property
    def false_alarm(self) -> float:
        """Probability that the best candidate is chance."""
        return self.identification.false_alarm_probability

    @property
    def stars(self) -> np.ndarray:
        """
        The identified stars, in the order of `centroids`.

        Returns:
            Structured array (N,), empty without an attitude: `hip` (int32, Hipparcos number), and
            as float64 `magnitude` (V, of the catalogue, of close doubles together), `ra_deg` and
            `dec_deg` (of the centroid by this attitude and lens, ICRS), `u_px` and `v_px`
            (centroid, (0, 0) the centre of the top-left pixel), `flux_dn`, `snr`, `sigma_px`
            (1 sigma per axis) and `residual_px` (centroid from catalogue).
            `pandas.DataFrame(solution.stars)` takes it.

        """
        found = self.identification
        row = np.flatnonzero(found.hip) if self.sky is not None else np.empty(0, int)
        seen, stars = self.centroids.select(row), np.zeros(len(row), STAR)
        if self.sky is not None:
            ra, dec = radec_from_unit(self.sky.directions(seen.uv))
            stars['ra_deg'], stars['dec_deg'] = np.degrees(ra) % 360, np.degrees(dec)
        stars['u_px'], stars['v_px'] = seen.uv.T
        for name, column in (
                ('hip', found.hip[row]), ('magnitude', found.magnitude[row]),
                ('flux_dn', seen.flux), ('snr', seen.snr), ('sigma_px', seen.sigma_px),
                ('residual_px', found.residual_px[row])):
            stars[name] = column
        return stars

    @cached_property
    def uncatalogued(self) -> tuple[Uncatalogued, ...]:
        """
        Bright detections without a catalogue star, a planet, the Moon or the Sun there.

        Returns:
            Brightest first, each with `u`, `v` (px), `ra_deg`, `dec_deg` (ICRS) and `magnitude` (V
            by the identified stars, of a saturated one too faint). They are brighter than half of
            the identified stars: a planet where the time of the image is unknown, a comet, a
            nova, a satellite, a nebula, a lamp, a letter.

        """
        if self.sky is None or self.photograph is None:
            return ()
        return uncatalogued(
            self.photograph.image, self.centroids, self.identification, self.sky,
            self.epoch_year, self.bodies, self.lens_error)

    def annotate(self, name: str = '', *, deep_sky: bool = False) -> np.ndarray:
        """
        Draw the image with its stars, constellations and planets, as `solve --annotate` does.

        Args:
            name: What stands before the pointing in the text below the image.
            deep_sky: Whether Messier, NGC and IC objects are named.

        Returns:
            Picture (H', W, 3) uint8 in the order red, green, blue, upright, with H' > H for the
            text. Without an attitude it has the detections alone, and the reason.

        Raises:
            MissingLibraryError: deep_sky without the library PyOngc.

        """
        assert self.photograph is not None
        objects = deep_sky_in(self.sky) if deep_sky and self.sky is not None else []
        picture = annotated(self.photograph.image, self.centroids.uv, self.identification.hip,
                            self.sky, self.epoch_year, self.bodies, deep_sky=objects,
                            unknown=self.uncatalogued)
        return captioned(picture, self._caption(name, bool(objects)))

    def _caption(self, name: str, deep_sky: bool) -> list[tuple[str, Colour]]:
        """Return what stands below a picture: what it shows, and what its marks mean."""
        field = '' if np.isnan(self.fov_deg) else f'field {self.fov_deg:.3f} deg, '
        found = (f'RA {self.ra_deg:.4f} deg, Dec {self.dec_deg:+.4f} deg, roll '
                 f'{self.roll_deg:.2f} deg, {field}{self.matched} stars, '
                 f'residual {self.residual_arcsec:.2f} arcsec, ICRS, epoch J{self.epoch_year:.2f}'
                 if self.sky is not None else f'not solved: {self.reason}')
        lines = [(f'{name}: {found}' if name else found, TEXT)]
        if self.sky is not None:
            lines += [('green circle: identified star with its name or number in Hipparcos',
                       IDENTIFIED),
                      ('blue: constellations, bright stars that are not identified', NAMED)]
        if self.bodies:
            lines.append(('yellow circle: planet, Moon or Sun', BODY))
        if deep_sky:
            lines.append(('violet: Messier, NGC and IC objects', DEEP_SKY))
        lines.append(('orange circle: spot that is not identified', FOUND))
        if self.uncatalogued:
            places = [f'V {one.magnitude:.1f} at RA {one.ra_deg:.4f}, Dec {one.dec_deg:+.4f} deg'
                      for one in self.uncatalogued[:_MOST_LISTED]]
            more = len(self.uncatalogued) - len(places)
            lines.append((f'orange with a magnitude: bright, without a catalogue star: '
                          f'{"; ".join(places)}{f"; {more} more" if more else ""}', FOUND))
        return lines

    def wcs(self) -> Cards:
        """
        Return the FITS header of the image, as `solve --wcs` writes it.

        Returns:
            Values by keyword: TAN or, of fisheyes, ZPN, with SIP polynomials where the lens needs
            them, for rows in the order of the file or array. `astropy.wcs.WCS(solution.wcs())`
            takes it. Positions are astrometric ICRS: the fit absorbs aberration and refraction.

        Raises:
            NoSolutionError: The image has no attitude.
            WcsError: No FITS projection has the lens to within 0.5 px.

        """
        if self.sky is None:
            raise NoSolutionError(self.reason)
        assert self.photograph is not None
        return image_wcs(self.sky, self.photograph.mirrored, self.photograph.bottom_up,
                         self.centroids.uv[self.identification.hip > 0])

    def summary(self) -> dict[str, str]:
        """Return the figures of repr()."""
        if not self.solved:
            return {'solved': 'False', 'reason': repr(self.reason)}
        return {'solved': 'True', 'ra_deg': f'{self.ra_deg:.4f}', 'dec_deg': f'{self.dec_deg:.4f}',
                'roll_deg': f'{self.roll_deg:.4f}', 'fov_deg': f'{self.fov_deg:.4f}',
                'matched': str(self.matched), 'residual_arcsec': f'{self.residual_arcsec:.2f}'}

    @property
    def _pointing_deg(self) -> tuple[float, float, float]:
        if self.quaternion is None:
            return float('nan'), float('nan'), float('nan')
        axes = self.quaternion
        if self.fitted:
            axes = multiply(axes, self.camera.middle_axes)
        ra_deg, dec_deg, roll_deg = np.degrees(pointing_from_quaternion(axes))
        return float(ra_deg), float(dec_deg), float(roll_deg)
