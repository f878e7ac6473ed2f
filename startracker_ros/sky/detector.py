"""Image sensor: starlight to digital numbers."""

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln, ndtr, xlogy

from startracker_ros.camera import Camera
from startracker_ros.options import option, Options
from startracker_ros.sky.sampling import TableSampler


@dataclass(frozen=True)
class DetectorOptions(Options):
    """Optics and image sensor of a small-satellite star tracker.

    A star of V = 0 sends 1000 photons s^-1 cm^-2 A^-1 near 5500 A (Bessell, Castelli and
    Plez 1998). An aperture of 15 mm (1.8 cm^2), a band of 3000 A and 0.38 of transmission
    times quantum efficiency make 2e6 electrons/s of it. V = 6 then gives 800 electrons in
    0.1 s, a signal to noise ratio of 23 over the 4 pi sigma^2 pixels of its image.
    """

    psf_sigma_px: float = option(0.8, 'width of a star image, Gaussian', unit='px',
                                 low=0.3, high=10.0)
    exposure_s: float = option(0.1, 'exposure time', unit='s', low=1e-4, high=60.0)
    zero_flux_e_s: float = option(2e6, 'electrons per second from a star of magnitude 0',
                                  unit='e-/s', low=1.0, high=1e12)
    background_e: float = option(20.0, 'sky and dark current in each pixel of an exposure',
                                 unit='e-', low=0.0, high=5000.0)
    read_noise_e: float = option(5.0, 'read noise, 1 sigma', unit='e-', low=0.1, high=100.0)
    gain_e_per_dn: float = option(4.0, 'electrons to one digital number', unit='e-/DN',
                                  low=0.25, high=1000.0)
    bias_dn: float = option(64.0, 'digital number of no electrons', unit='DN',
                            low=0.0, high=10000.0)
    full_well_e: float = option(15000.0, 'electrons that a pixel holds', unit='e-',
                                low=100.0, high=1e7)
    bit_depth: int = option(12, 'bits of a digital number; 8 gives mono8, more mono16',
                            low=8, high=16)
    noise: bool = option(True, 'photon and read noise; off gives the expected image')


class Detector:
    """Renders stars; the same generator state gives the same image."""

    def __init__(self, camera: Camera, options: DetectorOptions = DetectorOptions()) -> None:
        """Prepare tables for one camera."""
        self.options = options
        self._shape = (camera.height, camera.width)
        self._dtype = np.uint8 if options.bit_depth == 8 else np.uint16
        # The light beyond 5 sigma, 6e-7 of the star, is left out: it moves a centroid by
        # less than 2e-6 sigma.
        self._half = int(np.ceil(5 * options.psf_sigma_px))
        self._background = self._background_sampler() if options.noise else None

    @property
    def margin_px(self) -> float:
        """How far outside the image a star can be and still shed light into it."""
        return float(self._half)

    def flux_e(self, magnitude: np.ndarray) -> np.ndarray:
        """Return the electrons that stars of magnitude (...,) release in one exposure."""
        options = self.options
        return options.zero_flux_e_s * options.exposure_s * 10 ** (-0.4 * np.asarray(
            magnitude, float))

    def flux_dn(self, magnitude: np.ndarray) -> np.ndarray:
        """Return the same in digital numbers, as a centroid extractor would sum them."""
        return self.flux_e(magnitude) / self.options.gain_e_per_dn

    def render(self, uv: np.ndarray, magnitude: np.ndarray,
               rng: np.random.Generator) -> np.ndarray:
        """Return the image (H, W), uint8 or uint16, of stars at uv (N, 2) px.

        Light adds up, so most of the frame is plain background, drawn from its table; only
        the pixels that starlight reaches are computed one by one.
        """
        options = self.options
        pixel, electrons = self._starlight(np.asarray(uv, float), self.flux_e(magnitude))
        electrons = electrons + options.background_e
        count = self._shape[0] * self._shape[1]
        if options.noise:
            image = self._background.draw(count, rng)
            collected = np.minimum(rng.poisson(electrons), options.full_well_e)
            collected = collected + options.read_noise_e * rng.standard_normal(len(pixel))
        else:
            plain = min(options.background_e, options.full_well_e)
            image = np.full(count, self._digitise(plain), self._dtype)
            collected = np.minimum(electrons, options.full_well_e)
        # A pixel that two stars reach is listed twice with the same expectation; whichever
        # of its two equally valid draws is written last stands.
        image[pixel] = self._digitise(collected)
        return image.reshape(self._shape)

    def _starlight(self, uv: np.ndarray, flux_e: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return flat indices (M,) of the pixels with starlight and their electrons (M,)."""
        centre = np.rint(uv).astype(int)
        offset = np.arange(-self._half, self._half + 1)
        edge = np.arange(-self._half, self._half + 2) - 0.5
        # A Gaussian integrated over square pixels is the product of one share per axis.
        share = np.diff(ndtr(((centre - uv)[..., None] + edge) / self.options.psf_sigma_px))
        electrons = flux_e[:, None, None] * share[:, 1, :, None] * share[:, 0, None, :]
        column, row = np.moveaxis(centre[..., None] + offset, 1, 0)
        height, width = self._shape
        inside = (((row >= 0) & (row < height))[:, :, None]
                  & ((column >= 0) & (column < width))[:, None, :])
        pixel = (row[:, :, None] * width + column[:, None, :])[inside]
        total = np.zeros(height * width)
        np.add.at(total, pixel, electrons[inside])
        return pixel, total[pixel]

    def _digitise(self, electrons: np.ndarray) -> np.ndarray:
        options = self.options
        dn = np.floor(electrons / options.gain_e_per_dn + options.bias_dn + 0.5)
        return np.clip(dn, 0, 2 ** options.bit_depth - 1).astype(self._dtype)

    def _background_sampler(self) -> TableSampler:
        """Return the distribution of a pixel without stars: Poisson, read noise, rounding."""
        options = self.options
        mean, read_noise = options.background_e, options.read_noise_e
        spread = 12 * np.sqrt(mean) + 20
        count = np.arange(max(0, int(mean - spread)), int(mean + spread) if mean else 1)
        poisson = np.exp(xlogy(count, mean) - mean - gammaln(count + 1))
        collected = np.minimum(count, options.full_well_e)
        low, high = self._digitise(np.array([collected[0] - 9 * read_noise,
                                             collected[-1] + 9 * read_noise]))
        values = np.arange(int(low), int(high) + 1).astype(self._dtype)
        upper = (values[:-1] + 0.5 - options.bias_dn) * options.gain_e_per_dn
        below = ndtr((upper[:, None] - collected) / read_noise) @ poisson
        # Rounding of the sums can leave differences of -1e-16 in the tails.
        return TableSampler(values, np.maximum(np.diff(below, prepend=0.0, append=1.0), 0.0))
