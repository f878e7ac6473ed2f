"""Local background and noise on a coarse mesh, measured in the smoothed image."""

from dataclasses import dataclass

import cv2
import numpy as np

TILE_PX = 64
SAMPLES = 16  # per side of a tile
QUANTISATION_DN = 12 ** -0.5  # standard deviation of rounding to whole DN
SIGMA_OF_MAD = 1.4826  # of a normal distribution
TAIL = 0.95  # the quantile that shows a skewed noise and is not yet made of stars
TAIL_SIGMAS = 1.6449  # of a normal distribution
TAIL_SAMPLES = 16384
MAX_TAIL = 1.5  # beyond this it is stars after all


@dataclass(frozen=True)
class Mesh:
    """Background of an image of `shape`; both arrays (rows, columns) float32, a value per tile.

    level in DN; noise, 1 sigma in DN, is that of the smoothed image.
    """

    level: np.ndarray
    noise: np.ndarray
    shape: tuple[int, int]

    def threshold(self, sigmas: float) -> np.ndarray:
        """Return level + sigmas * noise for every pixel (H, W) float32."""
        return _spread(self.level + sigmas * self.noise, self.shape)

    def at(self, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return level and noise (N,) float64 at pixels uv (N, 2), bilinear as in threshold()."""
        rows, columns = self.level.shape
        height, width = self.shape
        x = (uv[:, 0] + 0.5) * columns / width + 0.5
        y = (uv[:, 1] + 0.5) * rows / height + 0.5
        i = np.clip(y.astype(int), 0, rows)
        j = np.clip(x.astype(int), 0, columns)
        y, x = y - i, x - j
        both = np.stack([_extend(self.level), _extend(self.noise)])
        level, noise = ((1 - y) * ((1 - x) * both[:, i, j] + x * both[:, i, j + 1])
                        + y * ((1 - x) * both[:, i + 1, j] + x * both[:, i + 1, j + 1]))
        return level, noise


def measure_background(smooth: np.ndarray, noise_gain: float) -> Mesh:
    """Return the mesh of a smoothed image (H, W) float32: median and scaled MAD of each tile.

    noise_gain is the factor by which the smoothing reduces white noise. The smoothed
    image is measured because averaging undoes the quantisation that makes the MAD of an
    8-bit image 0 or 1, and because correlated noise then counts as what it does to a star.
    Where the noise is skewed, as in a camera whose background is cut off at zero, the MAD
    is scaled up to the upper tail, which is where false stars come from.
    """
    height, width = smooth.shape
    rows, columns = (max(1, round(size / TILE_PX)) for size in smooth.shape)
    y = ((np.arange(rows * SAMPLES) + 0.5) * height / (rows * SAMPLES)).astype(int)
    x = ((np.arange(columns * SAMPLES) + 0.5) * width / (columns * SAMPLES)).astype(int)
    samples = smooth[y[:, None], x]
    level = _tile_median(samples)
    excess = samples - _spread(level, samples.shape)
    noise = np.maximum(cv2.medianBlur(SIGMA_OF_MAD * _tile_median(np.abs(excess)), 3),
                       noise_gain * QUANTISATION_DN)
    excess = (excess / _spread(noise, samples.shape)).ravel()
    excess = excess[::max(1, excess.size // TAIL_SAMPLES)]
    rank = int(TAIL * excess.size)
    tail = np.partition(excess, rank)[rank] / TAIL_SIGMAS
    return Mesh(level, noise * np.float32(np.clip(tail, 1, MAX_TAIL)), smooth.shape)


def _tile_median(samples: np.ndarray) -> np.ndarray:
    """Return the median of each SAMPLES x SAMPLES tile."""
    rows, columns = samples.shape[0] // SAMPLES, samples.shape[1] // SAMPLES
    tiles = samples.reshape(rows, SAMPLES, columns, SAMPLES).swapaxes(1, 2)
    middle = SAMPLES ** 2 // 2
    return np.partition(tiles.reshape(rows, columns, -1), middle)[..., middle].copy()


def _extend(mesh: np.ndarray) -> np.ndarray:
    """Return the mesh with one more tile on each side, continued straight (a lone tile: flat)."""
    for _ in mesh.shape:
        first, second = mesh[:1], mesh[1:2] if len(mesh) > 1 else mesh[:1]
        last, before = mesh[-1:], mesh[-2:-1] if len(mesh) > 1 else mesh[:1]
        mesh = np.concatenate([2 * first - second, mesh, 2 * last - before]).T
    return np.ascontiguousarray(mesh)


def _spread(mesh: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return the mesh interpolated bilinearly to (H, W), straight on to the borders."""
    border = [round(size / tiles) for size, tiles in zip(shape, mesh.shape)]
    canvas = cv2.resize(_extend(mesh), (shape[1] + 2 * border[1], shape[0] + 2 * border[0]),
                        interpolation=cv2.INTER_LINEAR)
    return canvas[border[0]:border[0] + shape[0], border[1]:border[1] + shape[1]]
