"""Optics and image sensor: point sources to digital numbers."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.camera.model import Camera
from startracker_ros.options import option, Options
from startracker_ros.sky.cosmic_rays import add_cosmic_rays
from startracker_ros.sky.fixed_pattern import fixed_pattern
from startracker_ros.sky.noise import digitise, noise_tables, read_out, Readout
from startracker_ros.sky.starlight import add_starlight, reach_px
from startracker_ros.sky.stray_light import stray_light


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
        'South Atlantic Anomaly', unit='1/cm^2/s', low=0.0, high=1e5)
    pixel_pitch_um: float = option(
        5.5, 'side of a pixel; sets the number and the length of cosmic-ray tracks', unit='um',
        low=0.5, high=50.0)
    noise: bool = option(True, 'photon and read noise; off gives the expected image')


class Detector:
    """Renders point sources; the same generator state gives the same image."""

    def __init__(self, camera: Camera, options: DetectorOptions = DetectorOptions(), *,
                 seed: int = 0) -> None:
        """Create the sensor of a camera; the seed determines its fixed pattern."""
        self.options = options
        self._camera = camera
        self._shape = (camera.height, camera.width)
        self._half_px = np.divide([camera.width, camera.height], 2)
        self._axis_px = np.array([camera.cx, camera.cy])
        off_centre = np.abs(self._axis_px - (self._half_px - 0.5))
        self._corner_px = np.linalg.norm(off_centre + self._half_px)
        pattern = fixed_pattern(
            self._shape, np.random.default_rng(seed),
            flat_field_percent=options.flat_field_percent,
            dark_current_e_s=options.dark_current_e_s,
            hot_pixel_fraction=options.hot_pixel_fraction, hot_pixel_e_s=options.hot_pixel_e_s)
        self._response = pattern.response
        stray_light_e = stray_light(camera, peak_e=options.stray_light_e,
                                    angle_deg=options.stray_light_angle_deg,
                                    falloff_deg=options.stray_light_falloff_deg)
        self._background_e = ((options.background_e + stray_light_e) * pattern.response
                              + pattern.dark_e_s * np.float32(options.exposure_s))
        self._light_e = np.empty(self._shape, np.float32)
        self._readout = Readout(*map(np.float32, (
            options.full_well_e, options.read_noise_e, 1 / options.gain_e_per_dn,
            options.bias_dn, 2 ** options.bit_depth - 1)))
        self._tables = noise_tables()
        area_cm2 = camera.width * camera.height * (options.pixel_pitch_um * 1e-4) ** 2
        self._hits_mean = options.cosmic_ray_hits_cm2_s * area_cm2 * options.exposure_s

    @property
    def sharpest_px(self) -> float:
        """Smallest sigma of the PSF in the image."""
        centre = self.options.psf_sigma_px
        return min(centre, self.options.psf_corner_sigma_px or centre)

    @property
    def margin_px(self) -> float:
        """Largest distance from the image of a star whose PSF reaches into it."""
        return float(reach_px(max(self.options.psf_sigma_px, self.options.psf_corner_sigma_px)))

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
        # Constant beyond the corner, so that margin_px is an upper bound.
        distance = np.linalg.norm(uv - self._axis_px, axis=-1) / self._corner_px
        return centre + (corner - centre) * np.minimum(distance, 1) ** 2

    def render(self, uv: np.ndarray, magnitude: np.ndarray, rng: np.random.Generator,
               weight: np.ndarray | float = 1.0) -> np.ndarray:
        """
        Return the image (H, W), uint8 or uint16, of stars at uv (N, 2) px.

        weight (N,) is the fraction of the exposure that each contributes: a moving star is
        several points whose weights add up to 1.
        """
        light_e = self._light_e
        np.copyto(light_e, self._background_e)
        uv = np.ascontiguousarray(uv, float)
        near = self._camera.contains(uv, -self.margin_px)
        add_starlight(uv[near], (self.flux_e(magnitude) * weight)[near],
                      self.psf_sigma_px(uv[near]), self._response, light_e)
        if self._hits_mean:
            # Photon noise is added to their charge as well: 4 % of that of a weak hit.
            add_cosmic_rays(light_e, self._hits_mean, self.options.pixel_pitch_um, rng)
        image = np.empty(self._shape, np.uint16)
        if self.options.noise:
            key = rng.integers(2 ** 64, dtype=np.uint64)
            read_out(light_e.reshape(-1), key, self._readout, self._tables, image.reshape(-1))
        else:
            np.minimum(light_e, self._readout.full_well_e, out=light_e)
            digitise(light_e.reshape(-1), self._readout, image.reshape(-1))
        return image if self.options.bit_depth > 8 else image.astype(np.uint8)
