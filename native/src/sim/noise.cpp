// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Photon and read noise of an image: exact distributions, in one pass.
//
// Each random number is a hash of a key and the index of its pixel (splitmix64 of Steele, Lea and
// Flood 2014, used as a counter-based generator). No draw depends on another one, so loops over pixels
// vectorise. A new key gives an independent image.

#include <algorithm>
#include <cmath>

#include "maths/clones.h"
#include "startracker_sim.h"

namespace {

/// Cells of every table, selected by 8 bits.
constexpr uint32_t CELLS = 256;

/// The normal table has 16 cells per standard deviation, from -8 sigma on.
constexpr int PER_SIGMA = 16;

/// The Poisson tables have means 0, 1/4, 2/4 .. below 64 and counts 0 .. 255.
constexpr float TABLES_PER_UNIT = 4.0F, TABLED_MEAN = 64.0F;
constexpr int LAST_TABLE = 255;

/// Larger means than any full well are drawn as this one.
constexpr float MOST_MEAN = 0x1p30F;

/// Pixels per block: few enough that most blocks are either dark or bright.
constexpr int BLOCK = 256;

/// Purposes of random numbers: elements of the sequence of a key are their keys.
enum Purpose : uint64_t { SMALL_POISSON, REMAINDER, LARGE_POISSON, READ_NOISE };

/// Return element index of the splitmix64 sequence of a key: 64 random bits.
uint64_t word_of(uint64_t key, uint64_t index) {
    uint64_t z = key + (index + 1) * 0x9E3779B97F4A7C15U;
    z = (z ^ (z >> 30U)) * 0xBF58476D1CE4E5B9U;
    z = (z ^ (z >> 27U)) * 0x94D049BB133111EBU;
    return z ^ (z >> 31U);
}

/// Random words of a block, lower and upper half, and entries of a table.
///
/// Look-ups in tables have a loop of their own, so that the other loops vectorise.
struct Draw {
    uint32_t low[BLOCK], high[BLOCK], entry[BLOCK];
};

/// Return the cell given by the lowest 8 bits of a word.
uint32_t cell_of(uint32_t low) {
    return low & (CELLS - 1);
}

/// Return the cell of a word, or the alias in its entry, by the highest 24 bits.
int drawn_cell(uint32_t low, uint32_t high, uint32_t entry) {
    return static_cast<int>(high < (entry & 0xffffff00U) ? cell_of(low) : entry & 0xffU);
}

/// Return the standard normal draw of a word; entry is the table entry of its cell.
///
/// A cell is drawn with its probability, then a triangular density twice as wide as the cell: the
/// total density is piecewise linear. Its error is 2e-4, that of the fourth moment 1e-7.
float normal_of(uint32_t low, uint32_t high, uint32_t entry) {
    const int cell = drawn_cell(low, high, entry);
    const auto triangle = static_cast<int>(((low >> 8U) & 0xfffU) + ((low >> 20U) & 0xfffU));
    return static_cast<float>(cell - (8 * PER_SIGMA + 1)) * (1.0F / PER_SIGMA) +
           static_cast<float>(triangle + 1) * (1.0F / (PER_SIGMA * 4096));
}

/// Return the Poisson draw, for a mean of 64 to MOST_MEAN, of a standard normal draw w.
///
/// Asymptotic expansion of Giles (2016), ACM Trans. Math. Softw. 42(1), Q_N2:
/// l + sqrt(l) w + (2 + w^2) / 6 - w (2 + w^2) / (72 sqrt(l)) + (-8/405 + 7/810 w^2 + w^4 / 270) / l,
/// rounded down, with l the mean.
float large_poisson(float given_mean, float given_normal) {
    const double mean = given_mean, normal = given_normal;
    const double root = std::sqrt(mean), square = normal * normal;
    // Not negative, as no w is below -8.1. g++ does not vectorise std::floor().
    return static_cast<float>(
        static_cast<int>(mean + root * normal + (2 + square) * (1.0 / 6) -
                         normal * (2 + square) * (1.0 / 72) / root +
                         (-8.0 / 405 + square * (7.0 / 810 + square * (1.0 / 270))) / mean));
}

/// Fill low and high of a draw with the halves of words.
ST_CLONES_512 void draw_words(uint64_t key, uint64_t first, int count, Draw &draw) {
    for (int i = 0; i < count; ++i) {
        const uint64_t word = word_of(key, first + static_cast<uint64_t>(i));
        draw.low[i] = static_cast<uint32_t>(word);
        draw.high[i] = static_cast<uint32_t>(word >> 32U);
    }
}

void look_up(const uint32_t *table, int count, uint32_t *entry) {
    for (int i = 0; i < count; ++i) {
        entry[i] = table[entry[i]];
    }
}

/// Enter the largest tabled means not above the means.
ST_CLONES_512 void enter_means(const float *__restrict mean, int count, Draw &draw) {
    for (int i = 0; i < count; ++i) {
        const int level = static_cast<int>(mean[i] * TABLES_PER_UNIT);
        draw.entry[i] = static_cast<uint32_t>(level < LAST_TABLE ? level : LAST_TABLE) * CELLS +
                        cell_of(draw.low[i]);
    }
}

ST_CLONES_512 void take_cells(const Draw &draw, int count, float *__restrict drawn) {
    for (int i = 0; i < count; ++i) {
        drawn[i] = static_cast<float>(drawn_cell(draw.low[i], draw.high[i], draw.entry[i]));
    }
}

/// Add Poisson draws of the differences d between the means and the tabled ones.
///
/// The sum of Poisson draws is Poisson. d is below 1/4: counts above 5, of probability 1e-8, are left
/// out.
ST_CLONES_512 void add_remainder(const float *__restrict mean, const Draw &draw, int count,
                                 float *__restrict drawn) {
    constexpr auto THIRD = static_cast<float>(1.0 / 3), FIFTH = static_cast<float>(1.0 / 5);
    for (int i = 0; i < count; ++i) {
        const float uniform = static_cast<float>(static_cast<int>(draw.high[i] >> 8U)) * 0x1p-24F;
        const float steps = mean[i] * TABLES_PER_UNIT;
        const float d =
            (steps - static_cast<float>(static_cast<int>(steps))) * (1 / TABLES_PER_UNIT);
        // exp(-d) by its series, to 3e-7.
        float term = 1 - d * (1 - d * 0.5F * (1 - d * THIRD * (1 - d * 0.25F * (1 - d * FIFTH))));
        float cumulative = term;
        int extra = uniform > cumulative ? 1 : 0;
        for (const float factor : {1.0F, 0.5F, THIRD, 0.25F}) {
            term *= d * factor;
            cumulative += term;
            extra += uniform > cumulative ? 1 : 0;
        }
        drawn[i] += static_cast<float>(extra);
    }
}

ST_CLONES_512 void enter_cells(int count, Draw &draw) {
    for (int i = 0; i < count; ++i) {
        draw.entry[i] = cell_of(draw.low[i]);
    }
}

ST_CLONES_512 void take_normals(const Draw &draw, int count, float *__restrict drawn) {
    for (int i = 0; i < count; ++i) {
        drawn[i] = normal_of(draw.low[i], draw.high[i], draw.entry[i]);
    }
}

/// Fill drawn with standard normal draws.
void draw_normals(uint64_t key, uint64_t first, const uint32_t *table, int count, Draw &draw,
                  float *drawn) {
    draw_words(key, first, count, draw);
    enter_cells(count, draw);
    look_up(table, count, draw.entry);
    take_normals(draw, count, drawn);
}

/// Replace draws of means of 64 or more; normals become Poisson draws.
ST_CLONES_512 void take_large_poisson(const float *__restrict mean, int count,
                                      float *__restrict normal, float *__restrict drawn) {
    float bounded[BLOCK];
    for (int i = 0; i < count; ++i) {
        const float least = mean[i] > TABLED_MEAN ? mean[i] : TABLED_MEAN;
        bounded[i] = least < MOST_MEAN ? least : MOST_MEAN;
    }
    for (int i = 0; i < count; ++i) {
        normal[i] = large_poisson(bounded[i], normal[i]);
    }
    for (int i = 0; i < count; ++i) {
        const float large = normal[i], small = drawn[i];
        drawn[i] = mean[i] >= TABLED_MEAN ? large : small;
    }
}

/// The same, drawing only the normal ones of these pixels.
void take_few_large_poisson(uint64_t key, uint64_t first, const float *mean,
                            const uint32_t *normal, int count, float *drawn) {
    for (int i = 0; i < count; ++i) {
        if (mean[i] >= TABLED_MEAN) {
            const uint64_t word = word_of(key, first + static_cast<uint64_t>(i));
            const auto low = static_cast<uint32_t>(word);
            drawn[i] = large_poisson(
                std::min(mean[i], MOST_MEAN),
                normal_of(low, static_cast<uint32_t>(word >> 32U), normal[cell_of(low)]));
        }
    }
}

/// Fill bounded with the means, 0 to 64; return how many are larger.
ST_CLONES_512 int bound(const float *__restrict mean, int count, float *__restrict bounded) {
    int large = 0;
    for (int i = 0; i < count; ++i) {
        const float positive = mean[i] > 0 ? mean[i] : 0.0F;
        bounded[i] = positive < TABLED_MEAN ? positive : TABLED_MEAN;
        large += mean[i] >= TABLED_MEAN ? 1 : 0;
    }
    return large;
}

/// Fill drawn with Poisson draws.
void draw_poisson(uint64_t key, uint64_t first, const float *mean, int count,
                  const uint32_t *normal, const uint32_t *poisson, Draw &draw, float *drawn) {
    float work[BLOCK];
    const int large = bound(mean, count, work);
    if (large < count) {
        draw_words(word_of(key, SMALL_POISSON), first, count, draw);
        enter_means(work, count, draw);
        look_up(poisson, count, draw.entry);
        take_cells(draw, count, drawn);
        draw_words(word_of(key, REMAINDER), first, count, draw);
        add_remainder(work, draw, count, drawn);
    }
    if (large > BLOCK / 8) {
        draw_normals(word_of(key, LARGE_POISSON), first, normal, count, draw, work);
        take_large_poisson(mean, count, work, drawn);
    } else if (large > 0) {
        take_few_large_poisson(word_of(key, LARGE_POISSON), first, mean, normal, count, drawn);
    }
}

/// Add read noise to electrons up to the full well.
ST_CLONES_512 void amplify(const st_readout &readout, const float *__restrict noise, int count,
                           float *__restrict electrons) {
    for (int i = 0; i < count; ++i) {
        const float kept = electrons[i] < readout.full_well_e ? electrons[i] : readout.full_well_e;
        electrons[i] = kept + readout.read_noise_e * noise[i];
    }
}

ST_CLONES_512 void digitise(const float *__restrict electrons, int count,
                            const st_readout &readout, uint16_t *__restrict image) {
    const float zero_dn = readout.bias_dn + 0.5F;
    for (int i = 0; i < count; ++i) {
        float dn = electrons[i] * readout.dn_per_e + zero_dn;
        dn = dn > 0 ? dn : 0.0F;
        image[i] =
            static_cast<uint16_t>(static_cast<int>(dn < readout.top_dn ? dn : readout.top_dn));
    }
}

}  // namespace

extern "C" {

/// Vose (IEEE Trans. Software Eng. 17, 1991): cells below the mean are filled up by cells above it, their
/// aliases. The upper 24 bits of an entry are the probability of its own cell, the lower 8 bits
/// the alias, which is drawn otherwise (Walker 1977).
void st_alias_tables(double *probability, size_t rows, uint32_t *table) {
    uint32_t small[CELLS], large[CELLS];
    for (size_t row = 0; row < rows; ++row) {
        double *p = probability + row * CELLS;
        uint32_t *entry = table + row * CELLS;
        int small_count = 0, large_count = 0;
        for (uint32_t cell = 0; cell < CELLS; ++cell) {
            entry[cell] = 0xffffffU << 8U | cell;
            if (p[cell] < 1) {
                small[small_count++] = cell;
            } else {
                large[large_count++] = cell;
            }
        }
        while (small_count > 0 && large_count > 0) {
            const uint32_t cell = small[--small_count], alias = large[large_count - 1];
            const double own_24 = std::min(std::rint(p[cell] * 0x1p24), 0x1p24 - 1);
            entry[cell] = static_cast<uint32_t>(own_24) << 8U | alias;
            p[alias] -= 1 - p[cell];
            if (p[alias] < 1) {
                small[small_count++] = alias;
                --large_count;
            }
        }
    }
}

void st_read_out(const float *mean, size_t count, uint64_t key, const st_readout *readout,
                 const uint32_t *normal, const uint32_t *poisson, const float *offset_e,
                 uint16_t *image) {
    Draw draw;
    float electrons[BLOCK], noise[BLOCK];
    for (size_t first = 0; first < count; first += BLOCK) {
        const int size = static_cast<int>(std::min<size_t>(BLOCK, count - first));
        draw_poisson(key, first, mean + first, size, normal, poisson, draw, electrons);
        draw_normals(word_of(key, READ_NOISE), first, normal, size, draw, noise);
        amplify(*readout, noise, size, electrons);
        for (int i = 0; offset_e != nullptr && i < size; ++i) {
            electrons[i] += offset_e[first + static_cast<size_t>(i)];
        }
        digitise(electrons, size, *readout, image + first);
    }
}

void st_digitise(const float *electrons, size_t count, const st_readout *readout,
                 uint16_t *image) {
    for (size_t first = 0; first < count; first += BLOCK) {
        digitise(electrons + first, static_cast<int>(std::min<size_t>(BLOCK, count - first)),
                 *readout, image + first);
    }
}

}  // extern "C"
