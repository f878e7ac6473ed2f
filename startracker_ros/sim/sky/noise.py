# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Photon and read noise of an image: exact distributions, compiled, in one pass.

Each random number is a hash of a key and the index of its pixel (splitmix64 of Steele, Lea
and Flood 2014, used as a counter-based generator). No draw depends on another one, so loops
over pixels vectorise. A new key gives an independent image.
"""

from functools import lru_cache
import math
from typing import NamedTuple

import numpy as np
from startracker_ros.core.compiled import compiled, inlined

# Cells of every table, selected by 8 bits.
_CELLS = 256
# The normal table has 16 cells per standard deviation, from -8 sigma on.
_PER_SIGMA = 16
# The Poisson tables have means 0, 1/4, 2/4 .. below 64 and counts 0 .. 255.
_TABLES_PER_UNIT = 4
_TABLED_MEAN = 64
# Pixels per block: few enough that most blocks are either dark or bright.
_BLOCK = 256
_U, _U32, _F = np.uint64, np.uint32, np.float32


class NoiseTables(NamedTuple):
    """
    Alias tables: normal (256,) of the cells of the normal distribution, poisson (65536,).

    The upper 24 bits of an entry are the probability of its own cell, the lower 8 bits the
    alias, which is drawn otherwise (Walker 1977, Vose 1991).
    """

    normal: np.ndarray
    poisson: np.ndarray


class _Draw(NamedTuple):
    """
    Random words of a block, (_BLOCK,) uint32 each: lower and upper half, and table entries.

    Table look-ups have a loop of their own, so that the other loops vectorise.
    """

    low: np.ndarray
    high: np.ndarray
    entry: np.ndarray


class Readout(NamedTuple):
    """Parameters of amplifier and converter, float32; top_dn is the largest digital number."""

    full_well_e: np.float32
    read_noise_e: np.float32
    dn_per_e: np.float32
    bias_dn: np.float32
    top_dn: np.float32


@lru_cache(maxsize=1)
def noise_tables() -> NoiseTables:
    """Return the tables; they do not depend on the sensor."""
    # The triangular density within a cell, of _normal(), adds 1/6 cell^2 to the variance.
    cell = np.arange(_CELLS)[None]
    variance = 1 - 1 / (6 * _PER_SIGMA ** 2)
    bell = np.exp(-(cell / _PER_SIGMA - 8) ** 2 / (2 * variance))
    mean = np.arange(_TABLED_MEAN * _TABLES_PER_UNIT)[:, None] / _TABLES_PER_UNIT
    log_factorial = np.array([math.lgamma(count + 1) for count in range(_CELLS)])
    # 1e-300 stands for a mean of 0, which has no logarithm.
    poisson = np.exp(cell * np.log(np.maximum(mean, 1e-300)) - mean - log_factorial)
    return NoiseTables(_alias_tables(_normalised(bell))[0],
                       _alias_tables(_normalised(poisson)).ravel())


def _normalised(weights: np.ndarray) -> np.ndarray:
    """Return weights (M, 256) scaled to a mean of 1 per row."""
    return weights / weights.sum(axis=1, keepdims=True) * _CELLS


@compiled
def _alias_tables(probability: np.ndarray) -> np.ndarray:
    """
    Return alias tables (M, 256) uint32 of probabilities (M, 256) times 256; overwrites these.

    Vose (1991): cells below the mean are filled up by cells above it, their aliases.
    """
    table = np.empty(probability.shape, np.uint32)
    small, large = np.empty(_CELLS, np.uint32), np.empty(_CELLS, np.uint32)
    for row in range(len(probability)):
        p = probability[row]
        small_count = large_count = 0
        for cell in range(_CELLS):
            table[row, cell] = (2 ** 24 - 1) << 8 | cell
            if p[cell] < 1:
                small[small_count] = cell
                small_count += 1
            else:
                large[large_count] = cell
                large_count += 1
        while small_count and large_count:
            cell, alias = small[small_count - 1], large[large_count - 1]
            small_count -= 1
            own_24 = min(np.rint(p[cell] * 2 ** 24), 2 ** 24 - 1)
            table[row, cell] = np.uint32(own_24) << _U32(8) | alias
            p[alias] -= 1 - p[cell]
            if p[alias] < 1:
                small[small_count] = alias
                small_count += 1
                large_count -= 1
    return table


@compiled
def read_out(mean: np.ndarray, key: np.uint64, readout: Readout, tables: NoiseTables,
             offset_e: np.ndarray, image: np.ndarray) -> None:
    """
    Fill image (N,) uint16 with digital numbers for expected electrons mean (N,) float32.

    Poisson noise, saturation at the full well, normal read noise, conversion. offset_e (N,)
    float32, or (0,) for none, is added before the conversion.
    """
    counts, normals = np.empty(_BLOCK, np.float32), np.empty(_BLOCK, np.float32)
    draw = _Draw(np.empty(_BLOCK, np.uint32), np.empty(_BLOCK, np.uint32),
                 np.empty(_BLOCK, np.uint32))
    for start in range(0, len(mean), _BLOCK):
        expected = mean[start:start + _BLOCK]
        electrons, noise = counts[:len(expected)], normals[:len(expected)]
        first = _U(start)
        large = _number_of_large(expected)
        if large < len(expected):
            _small_poisson(_word(key, _U(0)), first, expected, tables.poisson, draw, electrons)
            _add_remainder(_word(key, _U(1)), first, expected, electrons)
        if large > _BLOCK // 8:
            _normals(_word(key, _U(2)), first, tables.normal, draw, noise)
            _large_poisson(expected, noise, electrons)
        elif large > 0:
            _sparse_large_poisson(_word(key, _U(2)), first, expected, tables.normal, electrons)
        _normals(_word(key, _U(3)), first, tables.normal, draw, noise)
        for i in range(len(electrons)):
            unsaturated = electrons[i] < readout.full_well_e
            electrons[i] = ((electrons[i] if unsaturated else readout.full_well_e)
                            + readout.read_noise_e * noise[i])
        if len(offset_e):
            electrons += offset_e[start:start + _BLOCK]
        digitise(electrons, readout, image[start:start + _BLOCK])


@compiled
def _number_of_large(mean: np.ndarray) -> int:
    """Return the number of means of 64 or more."""
    large = 0
    for i in range(len(mean)):
        large += mean[i] >= _F(_TABLED_MEAN)
    return large


@compiled
def digitise(electrons: np.ndarray, readout: Readout, image: np.ndarray) -> None:
    """Fill image (N,) uint16 with the digital numbers of electrons (N,) float32."""
    for i in range(len(electrons)):
        dn = electrons[i] * readout.dn_per_e + (readout.bias_dn + _F(0.5))
        dn = dn if dn > _F(0) else _F(0)
        image[i] = np.uint16(np.int32(dn if dn < readout.top_dn else readout.top_dn))


@inlined
def _word(key: np.uint64, index: np.uint64) -> np.uint64:
    """Return element index of the splitmix64 sequence of key: 64 random bits."""
    z = key + (index + _U(1)) * _U(0x9E3779B97F4A7C15)
    z = (z ^ (z >> _U(30))) * _U(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> _U(27))) * _U(0x94D049BB133111EB)
    return z ^ (z >> _U(31))


@compiled
def _draw_words(key: np.uint64, first: np.uint64, draw: _Draw, count: int) -> None:
    """Fill low and high of draw with the halves of count words."""
    for i in range(count):
        word = _word(key, first + _U(i))
        draw.low[i], draw.high[i] = np.uint32(word), np.uint32(word >> _U(32))


@compiled
def _look_up(table: np.ndarray, entry: np.ndarray, count: int) -> None:
    """Replace indices into a table by the values there."""
    for i in range(count):
        entry[i] = table[entry[i]]


@inlined
def _cell(low: np.uint32) -> np.uint32:
    """Return the cell (uint32) given by the lowest 8 bits of a word."""
    return low & np.uint32(_CELLS - 1)


@inlined
def _drawn_cell(low: np.uint32, high: np.uint32, entry: np.uint32) -> np.int32:
    """Return the cell of a word, or the alias in its entry, by the highest 24 bits."""
    own = high < (entry & np.uint32(0xffffff00))
    return np.int32(_cell(low) if own else entry & np.uint32(0xff))


@compiled
def _small_poisson(key: np.uint64, first: np.uint64, mean: np.ndarray, table: np.ndarray,
                   draw: _Draw, count: np.ndarray) -> None:
    """Fill count with Poisson draws of the largest tabled means not above the means."""
    low, high, entry = draw
    _draw_words(key, first, draw, len(count))
    for i in range(len(count)):
        limited = mean[i] if mean[i] < _F(_TABLED_MEAN - 0.01) else _F(_TABLED_MEAN - 0.01)
        level = np.uint32(np.int32(limited * _F(_TABLES_PER_UNIT)))
        entry[i] = level * np.uint32(_CELLS) + _cell(low[i])
    _look_up(table, entry, len(count))
    for i in range(len(count)):
        count[i] = _F(_drawn_cell(low[i], high[i], entry[i]))


@compiled
def _add_remainder(key: np.uint64, first: np.uint64, mean: np.ndarray, count: np.ndarray) -> None:
    """
    Add Poisson draws of the differences d between the means and the tabled ones.

    The sum of Poisson draws is Poisson. d is below 1/4: counts above 5, of
    probability 1e-8, are left out.
    """
    for i in range(len(count)):
        word = _word(key, first + _U(i))
        uniform = _F(np.int32(word >> _U(40))) * _F(2.0 ** -24)
        steps = mean[i] * _F(_TABLES_PER_UNIT)
        d = (steps - _F(np.int32(steps))) * _F(1 / _TABLES_PER_UNIT)
        # exp(-d) by its series, to 3e-7.
        term = _F(1) - d * (_F(1) - d * _F(1 / 2) * (_F(1) - d * _F(1 / 3) * (
            _F(1) - d * _F(1 / 4) * (_F(1) - d * _F(1 / 5)))))
        cumulative = term
        extra = _F(1) if uniform > cumulative else _F(0)
        for k in range(1, 5):
            term *= d * _F(1 / k)
            cumulative += term
            extra += _F(1) if uniform > cumulative else _F(0)
        count[i] += extra


@inlined
def _inverse_poisson(mean: float, normal: float) -> int:
    """
    Return the Poisson draw, for a mean of 64 or more, of a standard normal draw w.

    Asymptotic expansion of Giles (2016), ACM Trans. Math. Softw. 42(1), Q_N2:
    l + sqrt(l) w + (2 + w^2) / 6 - w (2 + w^2) / (72 sqrt(l))
    + (-8/405 + 7/810 w^2 + w^4 / 270) / l, rounded down, with l the mean.
    """
    root = math.sqrt(mean)
    square = normal * normal
    return math.floor(mean + root * normal + (2 + square) * (1 / 6)
                      - normal * (2 + square) * (1 / 72) / root
                      + (-8 / 405 + square * (7 / 810 + square * (1 / 270))) / mean)


@compiled
def _large_poisson(mean: np.ndarray, normal: np.ndarray, count: np.ndarray) -> None:
    """Overwrite count by Poisson draws where mean is 64 or more; normal are standard normal."""
    for i in range(len(count)):
        value = _inverse_poisson(np.float64(mean[i]), np.float64(normal[i]))
        count[i] = _F(value) if mean[i] >= _F(_TABLED_MEAN) else count[i]


@compiled
def _sparse_large_poisson(key: np.uint64, first: np.uint64, mean: np.ndarray, table: np.ndarray,
                          count: np.ndarray) -> None:
    """Overwrite count where mean is 64 or more, drawing only the normals for these pixels."""
    for i in range(len(count)):
        if mean[i] >= _F(_TABLED_MEAN):
            word = _word(key, first + _U(i))
            low = np.uint32(word)
            normal = _normal(low, np.uint32(word >> _U(32)), table[_cell(low)])
            count[i] = _F(_inverse_poisson(np.float64(mean[i]), np.float64(normal)))


@compiled
def _normals(key: np.uint64, first: np.uint64, table: np.ndarray, draw: _Draw,
             normal: np.ndarray) -> None:
    """Fill normal with standard normal draws."""
    low, high, entry = draw
    _draw_words(key, first, draw, len(normal))
    for i in range(len(normal)):
        entry[i] = _cell(low[i])
    _look_up(table, entry, len(normal))
    for i in range(len(normal)):
        normal[i] = _normal(low[i], high[i], entry[i])


@inlined
def _normal(low: np.uint32, high: np.uint32, entry: np.uint32) -> np.float32:
    """
    Return the standard normal draw of a word; entry is the table entry of its cell.

    A cell is drawn with its probability, then a triangular density twice as wide as the cell:
    the total density is piecewise linear. Its error is 2e-4, that of the fourth moment 1e-7.
    """
    cell = _drawn_cell(low, high, entry)
    triangle = (np.int32((low >> np.uint32(8)) & np.uint32(0xfff))
                + np.int32((low >> np.uint32(20)) & np.uint32(0xfff)))
    return (_F(cell - np.int32(8 * _PER_SIGMA + 1)) * _F(1 / _PER_SIGMA)
            + _F(triangle + np.int32(1)) * _F(1 / (_PER_SIGMA * 4096)))
