"""
Photon and read noise of a whole image: exact distributions, compiled, one pass.

Each random number is a hash of a key and the index of its pixel (splitmix64 of Steele, Lea
and Flood 2014, read by counter), so that no draw waits for the one before and the
processor works on several pixels at once. A fresh key gives an independent image.
"""

from functools import lru_cache
import math
from typing import NamedTuple

import numpy as np
from startracker_ros.compiled import compiled, inlined

# Cells of every table, chosen with 8 bits.
_CELLS = 256
# Normal numbers are laid out in 16 cells to the standard deviation, from -8 on.
_PER_SIGMA = 16
# Poisson distributions of mean 0, 1/4, 2/4 .. below 64, of counts 0 .. 255 each.
_STEPS = 4
_FEW = 64
# Pixels that are handled together: few enough that light and dark parts take their own way.
_BLOCK = 256
_U, _U32, _F = np.uint64, np.uint32, np.float32


class NoiseTables(NamedTuple):
    """
    Alias tables: normal (256,) of the cells of the normal distribution, poisson (65536,).

    An entry keeps the probability to stay in its cell in its upper 24 bits, and in the lower 8
    the cell to go to otherwise (Walker 1977, Vose 1991).
    """

    normal: np.ndarray
    poisson: np.ndarray


class _Draw(NamedTuple):
    """
    Random words of a block, (_BLOCK,) uint32 each: their halves, and entries of a table.

    To read a table takes a loop of its own: the processor does the others for several pixels
    at once.
    """

    low: np.ndarray
    high: np.ndarray
    entry: np.ndarray


class Readout(NamedTuple):
    """What the amplifier does: e-, e-, DN/e-, DN, DN; all float32."""

    full_well_e: np.float32
    read_noise_e: np.float32
    dn_per_e: np.float32
    bias_dn: np.float32
    top_dn: np.float32


@lru_cache(maxsize=1)
def noise_tables() -> NoiseTables:
    """Return the tables, which are the same for every sensor."""
    # The triangles of _normals() add 1/6 of a squared cell to the variance.
    cell = np.arange(_CELLS)[None]
    variance = 1 - 1 / (6 * _PER_SIGMA ** 2)
    bell = np.exp(-(cell / _PER_SIGMA - 8) ** 2 / (2 * variance))
    mean = np.arange(_FEW * _STEPS)[:, None] / _STEPS
    log_factorial = np.array([math.lgamma(count + 1) for count in range(_CELLS)])
    # A mean of zero counts as the least there is, to have a logarithm.
    poisson = np.exp(cell * np.log(np.maximum(mean, 1e-300)) - mean - log_factorial)
    return NoiseTables(_alias_tables(_shares(bell))[0], _alias_tables(_shares(poisson)).ravel())


def _shares(weights: np.ndarray) -> np.ndarray:
    """Return weights (M, 256) with a mean of 1 to the row."""
    return weights / weights.sum(axis=1, keepdims=True) * _CELLS


@compiled
def _alias_tables(shares: np.ndarray) -> np.ndarray:
    """Return alias tables (M, 256) uint32 of shares (M, 256), which are used up."""
    table = np.empty(shares.shape, np.uint32)
    poor, rich = np.empty(_CELLS, np.uint32), np.empty(_CELLS, np.uint32)
    for row in range(len(shares)):
        share = shares[row]
        poor_count = rich_count = 0
        for cell in range(_CELLS):
            table[row, cell] = (2 ** 24 - 1) << 8 | cell
            if share[cell] < 1:
                poor[poor_count] = cell
                poor_count += 1
            else:
                rich[rich_count] = cell
                rich_count += 1
        while poor_count and rich_count:
            taker, giver = poor[poor_count - 1], rich[rich_count - 1]
            poor_count -= 1
            stay_24 = min(np.rint(share[taker] * 2 ** 24), 2 ** 24 - 1)
            table[row, taker] = np.uint32(stay_24) << _U32(8) | giver
            share[giver] -= 1 - share[taker]
            if share[giver] < 1:
                poor[poor_count] = giver
                poor_count += 1
                rich_count -= 1
    return table


@compiled
def read_out(mean: np.ndarray, key: np.uint64, readout: Readout, tables: NoiseTables,
             image: np.ndarray) -> None:
    """Fill image (N,) uint16 with what a sensor reads where mean (N,) float32 e- fall."""
    count, normal = np.empty(_BLOCK, np.float32), np.empty(_BLOCK, np.float32)
    draw = _Draw(np.empty(_BLOCK, np.uint32), np.empty(_BLOCK, np.uint32),
                 np.empty(_BLOCK, np.uint32))
    for start in range(0, len(mean), _BLOCK):
        expected = mean[start:start + _BLOCK]
        held, noise = count[:len(expected)], normal[:len(expected)]
        first = _U(start)
        many = _many(expected)
        if many < len(expected):
            _few_counts(_word(key, _U(0)), first, expected, tables.poisson, draw, held)
            _add_rest(_word(key, _U(1)), first, expected, held)
        if many > _BLOCK // 8:
            _normals(_word(key, _U(2)), first, tables.normal, draw, noise)
            _many_counts(expected, noise, held)
        elif many > 0:
            _few_many_counts(_word(key, _U(2)), first, expected, tables.normal, held)
        _normals(_word(key, _U(3)), first, tables.normal, draw, noise)
        for i in range(len(held)):
            fits = held[i] < readout.full_well_e
            held[i] = ((held[i] if fits else readout.full_well_e)
                       + readout.read_noise_e * noise[i])
        digitise(held, readout, image[start:start + _BLOCK])


@compiled
def _many(mean: np.ndarray) -> int:
    """Return how many of the means are 64 or more."""
    many = 0
    for i in range(len(mean)):
        many += mean[i] >= _F(_FEW)
    return many


@compiled
def digitise(electrons: np.ndarray, readout: Readout, image: np.ndarray) -> None:
    """Fill image (N,) uint16 with the digital numbers of electrons (N,) float32."""
    for i in range(len(electrons)):
        dn = electrons[i] * readout.dn_per_e + (readout.bias_dn + _F(0.5))
        dn = dn if dn > _F(0) else _F(0)
        image[i] = np.uint16(np.int32(dn if dn < readout.top_dn else readout.top_dn))


@inlined
def _word(key: np.uint64, index: np.uint64) -> np.uint64:
    """Return 64 random bits: element index of the sequence splitmix64 that starts at key."""
    z = key + (index + _U(1)) * _U(0x9E3779B97F4A7C15)
    z = (z ^ (z >> _U(30))) * _U(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> _U(27))) * _U(0x94D049BB133111EB)
    return z ^ (z >> _U(31))


@compiled
def _draw_words(key: np.uint64, first: np.uint64, draw: _Draw, count: int) -> None:
    """Fill the halves of draw with count words."""
    for i in range(count):
        word = _word(key, first + _U(i))
        draw.low[i], draw.high[i] = np.uint32(word), np.uint32(word >> _U(32))


@compiled
def _look_up(table: np.ndarray, entry: np.ndarray, count: int) -> None:
    """Replace places in a table by what stands there."""
    for i in range(count):
        entry[i] = table[entry[i]]


@inlined
def _cell(low: np.uint32) -> np.uint32:
    """Return the cell (uint32) that the lowest 8 bits of a word choose."""
    return low & np.uint32(_CELLS - 1)


@inlined
def _picked(low: np.uint32, high: np.uint32, entry: np.uint32) -> np.int32:
    """Return that cell, or where its entry says to go, by the highest 24 bits."""
    stays = high < (entry & np.uint32(0xffffff00))
    return np.int32(_cell(low) if stays else entry & np.uint32(0xff))


@compiled
def _few_counts(key: np.uint64, first: np.uint64, mean: np.ndarray, table: np.ndarray, draw: _Draw,
                count: np.ndarray) -> None:
    """Fill count with Poisson draws of the tabled means at or below the means (under 64)."""
    low, high, entry = draw
    _draw_words(key, first, draw, len(count))
    for i in range(len(count)):
        limited = mean[i] if mean[i] < _F(_FEW - 0.01) else _F(_FEW - 0.01)
        level = np.uint32(np.int32(limited * _F(_STEPS)))
        entry[i] = level * np.uint32(_CELLS) + _cell(low[i])
    _look_up(table, entry, len(count))
    for i in range(len(count)):
        count[i] = _F(_picked(low[i], high[i], entry[i]))


@compiled
def _add_rest(key: np.uint64, first: np.uint64, mean: np.ndarray, count: np.ndarray) -> None:
    """
    Add Poisson draws of what the means exceed the tabled ones by: sums are Poisson again.

    That is less than 1/4, so counts above 5 (1e-8) are left out.
    """
    for i in range(len(count)):
        word = _word(key, first + _U(i))
        uniform = _F(np.int32(word >> _U(40))) * _F(2.0 ** -24)
        steps = mean[i] * _F(_STEPS)
        rest = (steps - _F(np.int32(steps))) * _F(1 / _STEPS)
        # exp(-rest), whose series errs by 3e-7.
        term = _F(1) - rest * (_F(1) - rest * _F(1 / 2) * (_F(1) - rest * _F(1 / 3) * (
            _F(1) - rest * _F(1 / 4) * (_F(1) - rest * _F(1 / 5)))))
        below = term
        more = _F(1) if uniform > below else _F(0)
        for k in range(1, 5):
            term *= rest * _F(1 / k)
            below += term
            more += _F(1) if uniform > below else _F(0)
        count[i] += more


@inlined
def _inverse_poisson(mean: float, normal: float) -> int:
    """
    Return the Poisson draw of a mean of 64 or more that a standard normal draw stands for.

    Asymptotic expansion of Giles (2016), ACM Trans. Math. Softw. 42(1), Q_N2.
    """
    root = math.sqrt(mean)
    square = normal * normal
    return math.floor(mean + root * normal + (2 + square) * (1 / 6)
                      - normal * (2 + square) * (1 / 72) / root
                      + (-8 / 405 + square * (7 / 810 + square * (1 / 270))) / mean)


@compiled
def _many_counts(mean: np.ndarray, normal: np.ndarray, count: np.ndarray) -> None:
    """Overwrite count where mean is 64 or more."""
    for i in range(len(count)):
        value = _inverse_poisson(np.float64(mean[i]), np.float64(normal[i]))
        count[i] = _F(value) if mean[i] >= _F(_FEW) else count[i]


@compiled
def _few_many_counts(key: np.uint64, first: np.uint64, mean: np.ndarray, table: np.ndarray,
                     count: np.ndarray) -> None:
    """Do the same where that is a few of the pixels."""
    for i in range(len(count)):
        if mean[i] >= _F(_FEW):
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
    Return the standard normal draw that a word stands for, whose entry is that of its cell.

    A cell, drawn with its probability, is spread by a triangle twice its width: the density
    is linear in between. It errs by 2e-4 of itself, the fourth moment by 1e-7.
    """
    cell = _picked(low, high, entry)
    spread = (np.int32((low >> np.uint32(8)) & np.uint32(0xfff))
              + np.int32((low >> np.uint32(20)) & np.uint32(0xfff)))
    return (_F(cell - np.int32(8 * _PER_SIGMA + 1)) * _F(1 / _PER_SIGMA)
            + _F(spread + np.int32(1)) * _F(1 / (_PER_SIGMA * 4096)))
