# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Optics and image sensor: point sources to digital numbers."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.options import option, Options
from startracker_ros.sim.sky import psf
from startracker_ros.sim.sky.artefacts import ArtefactOptions, NO_TRAILS
from startracker_ros.sim.sky.bright_bodies import (
    BodyLight, disc_coverage, discs, pixel_directions, stray_light)
from startracker_ros.sim.sky.charge import add_cosmic_rays, add_trails, bloom
from startracker_ros.sim.sky.fixed_pattern import draw_defects, fixed_pattern, saturated_charge
from startracker_ros.sim.sky.noise import digitise, noise_tables, read_out, readout
from startracker_ros.sim.sky.psf import add_starlight, reach_px

# Fainter ghosts are lost in the noise and would take half of the time.
_FAINTEST_GHOST_E = 1.0
# Stream of random numbers of the defects, in addition to those of the fixed pattern.
_DEFECTS = 100


@dataclass(frozen=True)
class DetectorOptions(Options):
    """
    Optics and image sensor of a small-satellite star tracker.

    A star of V = 0 sends 1000 photons s^-1 cm^-2 A^-1 near 5500 A (Bessell, Castelli and
    Plez 1998). An aperture of 15 mm (1.8 cm^2), a band of 3000 A and 0.38 of transmission
    times quantum efficiency make 2e6 electrons/s of it. V = 6 then gives 800 electrons in
    0.1 s, a signal to noise ratio of 23 over the 4 pi sigma^2 pixels of its image.
    """

    psf_sigma_px: float = option(0.8, 'sigma of the Gaussian PSF', unit='px', low=0.3, high=10.0)
    psf_corner_sigma_px: float = option(
        0.0, 'sigma of the PSF in the farthest corner; it grows with the square of the distance '
        'from the optical axis; 0: as on the axis', unit='px', low=0.0, high=10.0)
    defocus_ring_px: float = option(
        0.0, 'radius of the ring as which a defocused lens with a central obstruction draws a '
        'star; psf_sigma_px is the sigma across it', unit='px', low=0.0, high=20.0)
    coma_corner_px: float = option(
        0.0, 'length of the tail by coma in the farthest corner, outwards; it grows with the '
        'distance from the optical axis', unit='px', low=0.0, high=20.0)
    astigmatism_corner_px: float = option(
        0.0, 'sigma in the farthest corner that adds in quadrature to that of the PSF along the '
        'radius, or across it if negative; it grows with the square of the distance from the '
        'optical axis', unit='px', low=-2.0, high=2.0)
    vignetting_percent: float = option(
        0.0, 'loss of light in the farthest corner; it grows with the square of the distance from '
        'the optical axis', unit='%', low=0.0, high=100.0)
    exposure_s: float = option(0.1, 'exposure time', unit='s', low=1e-4, high=60.0)
    zero_flux_e_s: float = option(2e6, 'electrons per second from a star of magnitude 0',
                                  unit='e-/s', low=1.0, high=1e12)
    background_e: float = option(20.0, 'sky and dark current per pixel and exposure',
                                 unit='e-', low=0.0, high=5000.0)
    read_noise_e: float = option(5.0, 'read noise, 1 sigma', unit='e-', low=0.1, high=100.0)
    gain_e_per_dn: float = option(4.0, 'electrons per digital number', unit='e-/DN',
                                  low=0.25, high=1000.0)
    bias_dn: float = option(64.0, 'digital number of zero electrons', unit='DN', low=0.0,
                            high=10000.0)
    full_well_e: float = option(15000.0, 'electrons at which a pixel saturates', unit='e-',
                                low=100.0, high=1e7)
    bit_depth: int = option(12, 'bits per pixel; 8 gives mono8, more mono16', low=8, high=16)
    motion_smear: bool = option(
        False, 'stars move over the pixels during the exposure; off: they are drawn where they '
        'are at its middle')
    line_time_us: float = option(
        0.0, 'rolling shutter: delay from one row to the next; 0: global shutter', unit='us',
        low=0.0, high=1000.0)
    readout_direction: str = option(
        'down', 'order in which a rolling shutter exposes the rows: down: the top row first, '
        'up: the bottom row first', choices=('down', 'up'))
    dark_current_e_s: float = option(
        0.0, 'dark current per pixel, in addition to background_e', unit='e-/s', low=0.0,
        high=1e5)
    hot_pixel_fraction: float = option(
        0.0, 'fraction of hot pixels; the same seed gives the same ones',
        low=0.0, high=0.1)
    hot_pixel_e_s: float = option(
        20000.0, 'mean dark current of hot pixels, exponentially distributed', unit='e-/s',
        low=0.0, high=1e7)
    flat_field_percent: float = option(
        0.0, 'standard deviation of the sensitivity of the pixels; the same seed gives the same '
        'pattern', unit='%', low=0.0, high=20.0)
    stray_light_e: float = option(
        0.0, 'stray light of the Earth, the Moon or the Sun at the edge nearest to the source',
        unit='e-', low=0.0, high=1e5)
    stray_light_angle_deg: float = option(
        -90.0, 'direction of the source in the image, from +u (right) towards +v (down)',
        unit='deg', low=-360.0, high=360.0)
    stray_light_falloff_deg: float = option(
        4.0, 'angle over which the stray light drops by a factor e', unit='deg',
        low=0.01, high=1000.0)
    cosmic_ray_hits_cm2_s: float = option(
        0.0, 'flux of cosmic rays through the sensor: some 5 in low orbit, thousands in the '
        'South Atlantic Anomaly, 3e4 and more in a proton storm', unit='1/cm^2/s', low=0.0,
        high=1e6)
    pixel_pitch_um: float = option(
        5.5, 'side of a pixel; sets the number and the length of cosmic-ray tracks', unit='um',
        low=0.5, high=50.0)
    blooming: bool = option(
        False, 'charge above the full well flows up and down the column, as in a CCD without '
        'drains')
    row_noise_dn: float = option(
        0.0, 'standard deviation of the offset of each row, new in every image', unit='DN',
        low=0.0, high=1000.0)
    column_pattern_dn: float = option(
        0.0, 'standard deviation of the offset of each column; the same seed gives the same '
        'pattern', unit='DN', low=0.0, high=1000.0)
    noise: bool = option(True, 'photon and read noise; off gives the expected image')


class Detector:
    """Renders point sources; the same generator state gives the same image."""

    def __init__(self, camera: Camera, options: DetectorOptions = DetectorOptions(),
                 artefacts: ArtefactOptions = ArtefactOptions(), *, seed: int = 0) -> None:
        """Create the sensor of a camera; the seed determines its fixed pattern."""
        self.options = options
        self._artefacts = artefacts
        self._camera = camera
        self._shape = (camera.height, camera.width)
        self._half_px = np.divide([camera.width, camera.height], 2)
        self._axis_px = np.array([camera.cx, camera.cy])
        off_centre = np.abs(self._axis_px - (self._half_px - 0.5))
        self._corner_px = np.linalg.norm(off_centre + self._half_px)
        self._make_defects(np.random.default_rng(
            np.random.SeedSequence(seed, spawn_key=(_DEFECTS,))))
        self._make_background(np.random.default_rng(seed))
        self._light_e = np.empty(self._shape, np.float32)
        self._readout = readout(options.full_well_e, options.read_noise_e,
                                1 / options.gain_e_per_dn, options.bias_dn,
                                2 ** options.bit_depth - 1)
        self._tables = noise_tables()
        area_cm2 = camera.width * camera.height * (options.pixel_pitch_um * 1e-4) ** 2
        self._hits_mean = options.cosmic_ray_hits_cm2_s * area_cm2 * options.exposure_s

    def _make_background(self, rng: np.random.Generator) -> None:
        """Set the response to light in general and to stars, and the light of every image."""
        camera, options = self._camera, self.options
        pattern = fixed_pattern(
            self._shape, rng, flat_field_percent=options.flat_field_percent,
            dark_current_e_s=options.dark_current_e_s,
            hot_pixel_fraction=options.hot_pixel_fraction, hot_pixel_e_s=options.hot_pixel_e_s)
        self._response = pattern.response
        if options.vignetting_percent:
            pixel = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), -1)
            loss = options.vignetting_percent / 100 * self._field_distance(pixel) ** 2
            self._response *= (1 - loss).astype(np.float32)
        light_e = options.background_e + stray_light(
            camera, peak_e=options.stray_light_e, angle_deg=options.stray_light_angle_deg,
            falloff_deg=options.stray_light_falloff_deg)
        clear = np.ones((1, 1), np.float32)
        for disc in discs(self._artefacts):
            coverage = disc_coverage(pixel_directions(camera), disc)
            light_e = light_e + disc.peak_e * coverage
            clear = clear * (1 - coverage)
        # Stars behind a disc are not visible.
        self._clear = np.broadcast_to(clear, self._shape)
        self._star_response = self._response * clear if clear.size > 1 else self._response
        self._background_e = (light_e * self._response
                              + pattern.dark_e_s * np.float32(options.exposure_s))

    def _make_defects(self, rng: np.random.Generator) -> None:
        options, artefacts = self.options, self._artefacts
        self.defects = defects = draw_defects(
            self._shape, rng, saturated_columns=artefacts.saturated_columns,
            warm_columns=artefacts.warm_columns, dead_columns=artefacts.dead_columns,
            saturated_rows=artefacts.saturated_rows, dead_rows=artefacts.dead_rows)
        height, width = self._shape
        # As in bloom(): a full pixel has no photon noise.
        full_e = options.full_well_e + 8 * np.sqrt(options.full_well_e)
        self._column_e = saturated_charge(width, defects.saturated_columns, full_e)
        self._row_e = saturated_charge(height, defects.saturated_rows, full_e)
        self._column_dn = rng.standard_normal(width) * options.column_pattern_dn
        self._column_dn[defects.warm_columns] += artefacts.warm_column_dn

    @property
    def sharpest_px(self) -> float:
        """Smallest sigma of the PSF in the image."""
        centre = self.options.psf_sigma_px
        return min(centre, self.options.psf_corner_sigma_px or centre)

    @property
    def margin_px(self) -> float:
        """Largest distance from the image of a star whose PSF reaches into it."""
        options = self.options
        sigma_px = max(options.psf_sigma_px, options.psf_corner_sigma_px)
        return (float(reach_px(psf.widest_px(sigma_px, options.coma_corner_px)))
                + psf.tail_px(options.coma_corner_px, options.astigmatism_corner_px)
                + options.defocus_ring_px)

    @property
    def line_time_s(self) -> float:
        """Delay from one row to the one below; negative if the rows are exposed upwards."""
        sign = 1 if self.options.readout_direction == 'down' else -1
        return sign * self.options.line_time_us * 1e-6

    def flux_e(self, magnitude: np.ndarray) -> np.ndarray:
        """Return the electrons that stars of magnitude (...,) release in one exposure."""
        options = self.options
        return options.zero_flux_e_s * options.exposure_s * 10 ** (-0.4 * np.asarray(
            magnitude, float))

    def flux_dn(self, magnitude: np.ndarray) -> np.ndarray:
        """Return the flux in DN of stars of magnitude (...,) in one exposure."""
        return self.flux_e(magnitude) / self.options.gain_e_per_dn

    def psf_sigma_px(self, uv: np.ndarray) -> np.ndarray:
        """Return the sigma (N,) of the PSF at uv (N, 2) px."""
        centre = self.options.psf_sigma_px
        corner = self.options.psf_corner_sigma_px or centre
        return centre + (corner - centre) * self._field_distance(uv) ** 2

    def visible(self, uv: np.ndarray, bodies: BodyLight | None = None) -> np.ndarray:
        """Return whether stars at uv (N, 2) px are in the image and not behind a disc."""
        clear = self._clear if bodies is None else self._clear * bodies.clear
        visible = self._camera.contains(uv)
        last = np.subtract(self._shape[::-1], 1)
        column, row = np.minimum(np.rint(uv[visible]), last).astype(int).T
        visible[visible] = clear[row, column] > 0.5
        return visible

    def ghosts(self, uv: np.ndarray, electrons: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return pixels (M, 2) and electrons (M,) of the ghosts of stars at uv (N, 2) px."""
        electrons = self._artefacts.ghost_ratio * electrons
        bright = electrons > _FAINTEST_GHOST_E
        return 2 * self._axis_px - uv[bright], electrons[bright]

    def expose(self, uv: np.ndarray, magnitude: np.ndarray, rng: np.random.Generator,
               weight: np.ndarray | float = 1.0, trails: np.ndarray = NO_TRAILS,
               bodies: BodyLight | None = None,
               debris: tuple[np.ndarray, np.ndarray] | None = None) -> int:
        """
        Expose the sensor to stars at uv (N, 2) px, trails (M, 4), bright bodies and debris.

        weight (N,) is the fraction of the exposure that each contributes: a moving star is
        several points whose weights add up to 1. debris has uv (K, 2) px
        and V (K,). Returns the number of cosmic-ray hits.
        """
        light_e, artefacts = self._light_e, self._artefacts
        np.copyto(light_e, self._background_e)
        star_response = self._star_response
        if bodies is not None:
            light_e += bodies.light_e * self._response
            star_response = star_response * bodies.clear
        uv, electrons = self._copies(np.ascontiguousarray(uv, float),
                                     self.flux_e(magnitude) * weight)
        near = self._camera.contains(uv, -self.margin_px)
        add_starlight(*self._gaussians(uv[near], electrons[near]), star_response, light_e)
        if debris is not None:
            particles, magnitudes = debris
            add_starlight(particles, self.flux_e(magnitudes),
                          np.full(len(particles), artefacts.debris_sigma_px), star_response,
                          light_e)
        if len(trails):
            add_trails(trails, artefacts.trail_peak_e, artefacts.trail_sigma_px, star_response,
                       light_e)
        hits = 0
        if self._hits_mean:
            # Photon noise is added to their charge as well: 4 % of that of a weak hit.
            hits = add_cosmic_rays(light_e, self._hits_mean, self.options.pixel_pitch_um, rng)
        if self.options.blooming:
            bloom(light_e, self.options.full_well_e)
        if artefacts.saturated_columns:
            light_e += self._column_e
        if artefacts.saturated_rows:
            light_e += self._row_e[:, None]
        light_e[:, self.defects.dead_columns] = 0
        light_e[self.defects.dead_rows] = 0
        return hits

    def read(self, rng: np.random.Generator) -> np.ndarray:
        """Return the image (H, W), uint8 or uint16, of the last exposure."""
        light_e, options = self._light_e, self.options
        image = np.empty(self._shape, np.uint16)
        key = int(rng.integers(2 ** 64, dtype=np.uint64)) if options.noise else None
        offset_e = self._offset_e(rng)
        if key is not None:
            read_out(light_e, key, self._readout, self._tables, offset_e, image)
        else:
            np.minimum(light_e, self._readout['full_well_e'], out=light_e)
            if offset_e is not None:
                light_e += offset_e
            digitise(light_e, self._readout, image)
        return image if options.bit_depth > 8 else image.astype(np.uint8)

    def render(self, uv: np.ndarray, magnitude: np.ndarray, rng: np.random.Generator,
               weight: np.ndarray | float = 1.0) -> np.ndarray:
        """Return the image of an exposure, as expose() and read()."""
        self.expose(uv, magnitude, rng, weight)
        return self.read(rng)

    def _field(self, uv: np.ndarray) -> np.ndarray:
        """Return positions (..., 2) from the optical axis, 1 in the farthest corner."""
        field = (uv - self._axis_px) / self._corner_px
        # Constant beyond the corner, so that margin_px is an upper bound.
        return field / np.maximum(np.linalg.norm(field, axis=-1, keepdims=True), 1)

    def _field_distance(self, uv: np.ndarray) -> np.ndarray:
        """Return distances (...,) from the optical axis, 1 in the farthest corner and beyond."""
        return np.minimum(np.linalg.norm(uv - self._axis_px, axis=-1) / self._corner_px, 1)

    def _copies(self, uv: np.ndarray, electrons: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return uv (M, 2) px and electrons (M,) of stars with second images and ghosts."""
        share = self._artefacts.double_exposure_share
        if share:
            uv = np.concatenate([uv, uv + self._artefacts.double_exposure_shift_px])
            electrons = np.concatenate([(1 - share) * electrons, share * electrons])
        if self._artefacts.ghost_ratio:
            ghost_uv, ghost_electrons = self.ghosts(uv, electrons)
            uv = np.concatenate([uv, ghost_uv])
            electrons = np.concatenate([electrons, ghost_electrons])
        return uv, electrons

    def _gaussians(self, uv: np.ndarray, electrons: np.ndarray) -> psf.PointSources:
        """Return the Gaussians, uv (M, 2) px, electrons (M,), sigma (M,) px, of stars."""
        options = self.options
        sources = uv, electrons, self.psf_sigma_px(uv)
        if options.coma_corner_px:
            sources = psf.with_coma(sources, self._field(uv), options.coma_corner_px)
        if options.astigmatism_corner_px:
            field = np.tile(self._field(uv), (len(sources[0]) // max(len(uv), 1), 1))
            sources = psf.with_astigmatism(sources, field, options.astigmatism_corner_px)
        if options.defocus_ring_px:
            sources = psf.with_ring(sources, options.defocus_ring_px)
        return sources

    def _offset_e(self, rng: np.random.Generator) -> np.ndarray | None:
        """Return the offset of each pixel (H, W) float32 by rows and columns, None for none."""
        options = self.options
        if not (options.row_noise_dn or self._column_dn.any()):
            return None
        row_dn = rng.standard_normal(self._shape[0]) * options.row_noise_dn
        offset_dn = np.add.outer(row_dn, self._column_dn)
        return (offset_dn * options.gain_e_per_dn).astype(np.float32)
