# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Photon and read noise of an image by the native library: tables of exact distributions."""

from functools import lru_cache
import math
from typing import NamedTuple

import numpy as np
from startracker_ros.core.native import library, READOUT

# As native/src/sim/noise.cpp has them: cells of every table; those of the normal table per
# standard deviation, from -8 sigma on; Poisson tables per unit of the mean, below 64.
_CELLS = 256
_PER_SIGMA = 16
_TABLES_PER_UNIT = 4
_TABLED_MEAN = 64


class NoiseTables(NamedTuple):
    """
    Alias tables: normal (256,) of the cells of the normal distribution, poisson (65536,).

    The upper 24 bits of an entry are the probability of its own cell, the lower 8 bits the
    alias, which is drawn otherwise (Walker 1977, Vose 1991).
    """

    normal: np.ndarray
    poisson: np.ndarray


@lru_cache(maxsize=1)
def noise_tables() -> NoiseTables:
    """Return the tables; they do not depend on the sensor."""
    # The triangular density within a cell adds 1/6 cell^2 to the variance.
    cell = np.arange(_CELLS)[None]
    variance = 1 - 1 / (6 * _PER_SIGMA ** 2)
    bell = np.exp(-(cell / _PER_SIGMA - 8) ** 2 / (2 * variance))
    mean = np.arange(_TABLED_MEAN * _TABLES_PER_UNIT)[:, None] / _TABLES_PER_UNIT
    log_factorial = np.array([math.lgamma(count + 1) for count in range(_CELLS)])
    # 1e-300 stands for a mean of 0, which has no logarithm.
    poisson = np.exp(cell * np.log(np.maximum(mean, 1e-300)) - mean - log_factorial)
    return NoiseTables(_alias_tables(bell), _alias_tables(poisson))


def _alias_tables(weights: np.ndarray) -> np.ndarray:
    """Return alias tables (M 256,) uint32 of weights (M, 256)."""
    probability = weights / weights.sum(axis=1, keepdims=True) * _CELLS
    table = np.empty(weights.size, np.uint32)
    library().st_alias_tables(probability.ctypes.data, len(weights), table.ctypes.data)
    return table


def readout(full_well_e: float, read_noise_e: float, dn_per_e: float, bias_dn: float,
            top_dn: float) -> np.ndarray:
    """Return a READOUT: amplifier and converter; top_dn is the largest digital number."""
    return np.array((full_well_e, read_noise_e, dn_per_e, bias_dn, top_dn), READOUT)


def read_out(mean: np.ndarray, key: int, readout: np.ndarray, tables: NoiseTables,
             offset_e: np.ndarray | None, image: np.ndarray) -> None:
    """
    Fill image (...,) uint16 with digital numbers for expected electrons mean (...,) float32.

    Poisson noise, saturation at the full well, normal read noise, conversion. offset_e (...,)
    float32 is added before the conversion. The same key, 64 bits, gives the same image.
    """
    library().st_read_out(
        mean.ctypes.data, mean.size, key, readout.ctypes.data, tables.normal.ctypes.data,
        tables.poisson.ctypes.data, None if offset_e is None else offset_e.ctypes.data,
        image.ctypes.data)


def digitise(electrons: np.ndarray, readout: np.ndarray, image: np.ndarray) -> None:
    """Fill image (...,) uint16 with the digital numbers of electrons (...,) float32."""
    library().st_digitise(electrons.ctypes.data, electrons.size, readout.ctypes.data,
                          image.ctypes.data)
