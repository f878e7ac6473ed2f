"""Tracks of charged particles through the sensor."""

import numpy as np

# Depth of the silicon from which pixels collect charge; typical of CMOS sensors.
DEPTH_UM = 10.0
# Most probable charge of a minimum ionising particle in thin silicon, and the width of its
# distribution (Particle Data Group, Passage of particles through matter, silicon detectors).
_E_PER_UM, _WIDTH_E_PER_UM = 70.0, 10.0
# Tracks are drawn in steps of a quarter pixel and cut at 200 px.
_STEPS_PER_PX = 4
_MAX_LENGTH_PX = 200.0


def add_cosmic_rays(light: np.ndarray, hits_mean: float, pitch_um: float,
                    rng: np.random.Generator) -> None:
    """
    Add to light (H, W) the electrons of a Poisson number of particles.

    The flux is isotropic. The charge per length follows the distribution of Moyal (1955), an
    approximation of the Landau distribution.
    """
    height, width = light.shape
    for _ in range(rng.poisson(hits_mean)):
        # For an isotropic flux through a plane, sin^2 of the zenith angle is uniform.
        sine2 = min(rng.random(), 1 - 1e-6)
        azimuth = rng.uniform(0, 2 * np.pi)
        length_px = min(DEPTH_UM / pitch_um * np.sqrt(sine2 / (1 - sine2)), _MAX_LENGTH_PX)
        e_per_um = _E_PER_UM - _WIDTH_E_PER_UM * np.log(rng.standard_normal() ** 2)
        electrons = max(e_per_um, 0.0) * np.hypot(DEPTH_UM, length_px * pitch_um)
        steps = int(np.ceil(length_px * _STEPS_PER_PX)) + 1
        along = np.linspace(0, length_px, steps)
        column = np.rint(rng.uniform(-0.5, width - 0.5) + along * np.cos(azimuth)).astype(int)
        row = np.rint(rng.uniform(-0.5, height - 0.5) + along * np.sin(azimuth)).astype(int)
        inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        np.add.at(light, (row[inside], column[inside]), electrons / steps)
