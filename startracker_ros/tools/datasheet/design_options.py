# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a design is made of: the sensor, the lens, and what is wanted of them."""

from dataclasses import dataclass

from startracker_ros.core.options import option, Options


@dataclass(frozen=True)
class DesignOptions(Options):
    """The sensor, the lens, and what is wanted of them."""

    width: int = option(1024, 'columns of the sensor', unit='px', low=64, high=16384)
    height: int = option(1024, 'rows of the sensor', unit='px', low=64, high=16384)
    pixel_um: float = option(5.5, 'side of a pixel', unit='um', low=0.5, high=50.0)
    full_well_e: float = option(15000.0, 'electrons at which a pixel saturates', unit='e-',
                                low=100.0, high=1e7)
    read_noise_e: float = option(5.0, 'read noise, 1 sigma', unit='e-', low=0.1, high=100.0)
    dark_e_s: float = option(50.0, 'dark current of a pixel', unit='e-/s', low=0.0, high=1e5)
    bit_depth: int = option(12, 'bits of a pixel, from 0 to the full well', unit='bit', low=8,
                            high=16)
    qe: float = option(0.5, 'quantum efficiency, mean over the band', low=0.01, high=1.0)
    focal_mm: float = option(26.8, 'focal length', unit='mm', low=1.0, high=5000.0)
    f_number: float = option(1.8, 'focal length over aperture', low=0.5, high=64.0)
    transmission: float = option(0.75, 'of the lens', low=0.01, high=1.0)
    bandwidth_nm: float = option(300.0, 'width of the band', unit='nm', low=10.0, high=1000.0)
    psf_sigma_px: float = option(0.8, 'sigma of the image of a star', unit='px', low=0.3,
                                 high=10.0)
    background_e_s: float = option(200.0, 'sky and stray light in a pixel', unit='e-/s', low=0.0,
                                   high=5000.0)
    rate_deg_s: float = option(0.3, 'rate across the boresight', unit='deg/s', low=0.0,
                               high=20.0)
    accuracy_arcsec: float = option(5.0, 'wanted error across the boresight, 1 sigma, of a single '
                                    'image', unit='arcsec', low=1e-3, high=3600.0)
