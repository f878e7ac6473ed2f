// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/background.h"

#include <cmath>

#include "maths/clones.h"
#include "maths/sorting.h"

namespace st {
namespace {

constexpr double LEAST_TILE_SIGMAS = 16.0;  // side of the smallest tile: most of it is sky
constexpr double BEND_SIGMAS =
    0.25;                            // of the level within a tile, from which on tiles are halved,
constexpr double BENT_SHARE = 0.25;  // in so many of them
constexpr double CHANGED_SIGMAS = 1.5;  // of a pixel, by which the level has changed
constexpr double CHANGED_SHARE = 0.25;  // at so many places
constexpr int SAMPLE_ROWS = 8;          // rows sampled in a tile; each has to be filtered,
constexpr int SAMPLES = 16;             // so that the pixels along it cost little
constexpr int OF_TILE = SAMPLE_ROWS * SAMPLES;
constexpr double TAIL_QUANTILE = 0.95;  // shows a skewed noise and is not yet made of stars
constexpr double TAIL_SIGMAS = 1.6449;  // the same quantile of a normal distribution
constexpr int TAIL_SAMPLES = 16384;
constexpr double MAX_SIGMAS = 100.0;                     // to which samples are limited
constexpr double MAX_TAIL_RATIO = 1.5;                   // a longer tail is made of stars
constexpr int STEPS_PER_DN = 256;                        // of samples as int32
constexpr double QUANTISATION_DN = 0.28867513459481287;  // of whole DN: 12^-1/2

constexpr int RING_PX = 9;  // from a star, where a change of the level is measured
constexpr Pixel RING[] = {{9, 0},  {8, 3},  {6, 6},  {3, 8},   {0, 9},   {-3, 8},
                          {-6, 6}, {-8, 3}, {-9, 0}, {-8, -3}, {-6, -6}, {-3, -8},
                          {0, -9}, {3, -8}, {6, -6}, {8, -3}};
constexpr int RING_PIXELS = sizeof(RING) / sizeof(RING[0]);

/// Return the value of this rank, from 0, among values: bisection by counting, which unlike a
/// partition has no branches that depend on the data.
ST_CLONES int order_statistic(const int32_t *values, int count, int rank) {
    int32_t low = values[0], high = values[0];
    for (int k = 1; k < count; ++k) {
        low = values[k] < low ? values[k] : low;
        high = values[k] > high ? values[k] : high;
    }
    while (low < high) {
        const int32_t middle = static_cast<int32_t>((static_cast<int64_t>(low) + high) >> 1);
        int32_t below = 0;
        for (int k = 0; k < count; ++k) {
            below += values[k] <= middle ? 1 : 0;
        }
        if (below > rank) {
            high = middle;
        } else {
            low = middle + 1;
        }
    }
    return low;
}

/// Number of tiles along a side, whose halves are rounded to even.
int tiles_along(int side_px, int tile_px) {
    const int tiles = static_cast<int>(std::nearbyint(static_cast<double>(side_px) / tile_px));
    return tiles > 1 ? tiles : 1;
}

/// Extrapolate the inner tiles linearly into the border; a single tile stays flat.
void extend(double *tile, int rows, int columns) {
    const int width = columns + 2;
    const int second = rows < 2 ? rows : 2, last_but_one = rows - 1 > 1 ? rows - 1 : 1;
    for (int j = 1; j <= columns; ++j) {
        tile[j] = 2 * tile[width + j] - tile[second * width + j];
        tile[(rows + 1) * width + j] = 2 * tile[rows * width + j] - tile[last_but_one * width + j];
    }
    const int right = columns - 1 > 1 ? columns - 1 : 1, left = columns < 2 ? columns : 2;
    for (int i = 0; i < rows + 2; ++i) {
        double *row = tile + i * width;
        row[0] = 2 * row[1] - row[left];
        row[columns + 1] = 2 * row[columns] - row[right];
    }
}

/// Fill samples (rows, columns, SAMPLE_ROWS, SAMPLES), in steps, of the smoothed image.
void sample(const Image &image, const Kernel &kernel, const Mesh &mesh, int32_t *samples,
            Arena &arena) {
    const Arena::Scope scope(arena);
    const int across = mesh.columns * SAMPLES;
    auto *down = arena.take<float>(static_cast<size_t>(image.width + 2 * kernel.radius));
    auto *line = arena.take<float>(static_cast<size_t>(image.width));
    auto *u = arena.take<int>(static_cast<size_t>(across));
    for (int k = 0; k < across; ++k) {
        u[k] = static_cast<int>((k + 0.5) * image.width / across);
    }
    const uint16_t *rows[2 * MOST_WEIGHTS];
    for (int i = 0; i < mesh.rows; ++i) {
        for (int k = 0; k < SAMPLE_ROWS; ++k) {
            const int v =
                static_cast<int>((i + (k + 0.5) / SAMPLE_ROWS) * image.height / mesh.rows);
            for (int y = -kernel.radius; y <= kernel.radius; ++y) {
                rows[kernel.radius + y] = image.row(mirrored(v + y, image.height));
            }
            filter_down(rows, kernel, image.width, down);
            filter_across(down, kernel, 0, image.width, line);
            for (int j = 0; j < mesh.columns; ++j) {
                int32_t *row = samples + ((i * mesh.columns + j) * SAMPLE_ROWS + k) * SAMPLES;
                for (int m = 0; m < SAMPLES; ++m) {
                    row[m] = static_cast<int32_t>(line[u[j * SAMPLES + m]] * STEPS_PER_DN);
                }
            }
        }
    }
}

/// Subtract the level, linear between the middles of the tiles, from samples.
void subtract_level(const Mesh &mesh, int32_t *samples, Arena &arena) {
    const Arena::Scope scope(arena);
    auto *at_tile = arena.take<double>(static_cast<size_t>(mesh.columns + 2));
    float before_middle[SAMPLES], after_middle[SAMPLES];
    for (int m = 0; m < SAMPLES; ++m) {
        const float from_middle = (static_cast<float>(m) + 0.5f) / SAMPLES - 0.5f;
        before_middle[m] = from_middle < 0 ? from_middle : 0.0f;
        after_middle[m] = from_middle > 0 ? from_middle : 0.0f;
    }
    for (int i = 0; i < mesh.rows; ++i) {
        for (int k = 0; k < SAMPLE_ROWS; ++k) {
            interpolate_row(mesh, mesh.level, i + 0.5 + (k + 0.5) / SAMPLE_ROWS, at_tile);
            for (int j = 0; j < mesh.columns; ++j) {
                const auto middle = static_cast<float>(STEPS_PER_DN * at_tile[j + 1]);
                const auto before =
                    static_cast<float>(STEPS_PER_DN * (at_tile[j + 1] - at_tile[j]));
                const auto after =
                    static_cast<float>(STEPS_PER_DN * (at_tile[j + 2] - at_tile[j + 1]));
                int32_t *row = samples + ((i * mesh.columns + j) * SAMPLE_ROWS + k) * SAMPLES;
                for (int m = 0; m < SAMPLES; ++m) {
                    row[m] -= static_cast<int32_t>(middle + before_middle[m] * before +
                                                   after_middle[m] * after);
                }
            }
        }
    }
}

/// Fill scatter (rows, columns) with the scaled MAD in DN of samples without level.
void measure_scatter(const Mesh &mesh, const int32_t *samples, double *scatter) {
    int32_t deviation[OF_TILE];
    for (int i = 0; i < mesh.rows * mesh.columns; ++i) {
        for (int k = 0; k < OF_TILE; ++k) {
            const int32_t value = samples[i * OF_TILE + k];
            deviation[k] = value < 0 ? -value : value;
        }
        scatter[i] =
            SIGMA_PER_MAD * order_statistic(deviation, OF_TILE, OF_TILE / 2) / STEPS_PER_DN;
    }
}

/// Return the median of a tile and the eight around it, those of the border repeated.
double median_of_nine(const Mesh &mesh, const double *tile, int i, int j) {
    double around[9];
    for (int k = 0; k < 9; ++k) {
        int row = i + k / 3 - 1, column = j + k % 3 - 1;
        row = row < 0 ? 0 : row < mesh.rows ? row : mesh.rows - 1;
        column = column < 0 ? 0 : column < mesh.columns ? column : mesh.columns - 1;
        insert_sorted(around, k, tile[row * mesh.columns + column]);
    }
    return around[4];
}

/// Return the ratio of the upper tail of samples to that of a normal distribution.
double tail_ratio(const Mesh &mesh, const int32_t *samples, Arena &arena) {
    const Arena::Scope scope(arena);
    const int tiles = mesh.rows * mesh.columns, all = tiles * OF_TILE;
    const int step = all / TAIL_SAMPLES > 1 ? all / TAIL_SAMPLES : 1;
    const int of_tile = (OF_TILE + step - 1) / step;
    auto *tail = arena.take<int32_t>(static_cast<size_t>(tiles * of_tile));
    for (int i = 0; i < mesh.rows; ++i) {
        for (int j = 0; j < mesh.columns; ++j) {
            const int one = i * mesh.columns + j;
            const double noise = mesh.noise[(i + 1) * (mesh.columns + 2) + j + 1] * STEPS_PER_DN;
            for (int k = 0; k < of_tile; ++k) {
                const double sigmas = samples[one * OF_TILE + k * step] / noise;
                tail[one * of_tile + k] = static_cast<int32_t>(
                    (sigmas < MAX_SIGMAS ? sigmas : MAX_SIGMAS) * STEPS_PER_DN);
            }
        }
    }
    const int rank = static_cast<int>(TAIL_QUANTILE * (tiles * of_tile));
    const double ratio = static_cast<double>(order_statistic(tail, tiles * of_tile, rank)) /
                         STEPS_PER_DN / TAIL_SIGMAS;
    return ratio < 1.0 ? 1.0 : ratio < MAX_TAIL_RATIO ? ratio : MAX_TAIL_RATIO;
}

/// Return the median of the inner tiles.
double median_inside(const Mesh &mesh, const double *tile, Arena &arena) {
    const Arena::Scope scope(arena);
    auto *values = arena.take<double>(static_cast<size_t>(mesh.rows * mesh.columns));
    for (int i = 0; i < mesh.rows; ++i) {
        for (int j = 0; j < mesh.columns; ++j) {
            values[i * mesh.columns + j] = tile[(i + 1) * (mesh.columns + 2) + j + 1];
        }
    }
    return median(values, mesh.rows * mesh.columns);
}

/// Measure level and noise from SAMPLE_ROWS x SAMPLES pixels of each tile, and their medians.
void measure(const Image &image, const Kernel &kernel, Mesh &mesh, Arena &arena) {
    const Arena::Scope scope(arena);
    const int tiles = mesh.rows * mesh.columns, width = mesh.columns + 2;
    auto *samples = arena.take<int32_t>(static_cast<size_t>(tiles * OF_TILE));
    auto *scatter = arena.take<double>(static_cast<size_t>(tiles));
    sample(image, kernel, mesh, samples, arena);
    for (int i = 0; i < mesh.rows; ++i) {
        for (int j = 0; j < mesh.columns; ++j) {
            mesh.level[(i + 1) * width + j + 1] =
                static_cast<double>(order_statistic(samples + (i * mesh.columns + j) * OF_TILE,
                                                    OF_TILE, OF_TILE / 2)) /
                STEPS_PER_DN;
        }
    }
    extend(mesh.level, mesh.rows, mesh.columns);
    subtract_level(mesh, samples, arena);
    measure_scatter(mesh, samples, scatter);
    const double least = kernel.noise_gain * QUANTISATION_DN;
    for (int i = 0; i < mesh.rows; ++i) {
        for (int j = 0; j < mesh.columns; ++j) {
            const double noise = median_of_nine(mesh, scatter, i, j);
            mesh.noise[(i + 1) * width + j + 1] = noise > least ? noise : least;
        }
    }
    const double ratio = tail_ratio(mesh, samples, arena);
    for (int i = 1; i <= mesh.rows; ++i) {
        for (int j = 1; j <= mesh.columns; ++j) {
            mesh.noise[i * width + j] *= ratio;
        }
    }
    extend(mesh.noise, mesh.rows, mesh.columns);
    mesh.median_level = median_inside(mesh, mesh.level, arena);
    mesh.median_noise = median_inside(mesh, mesh.noise, arena);
}

/// Whether the level of many tiles is not a plane between those around them.
bool is_bent(const Mesh &mesh) {
    const int width = mesh.columns + 2;
    int bent = 0;
    for (int i = 1; i <= mesh.rows; ++i) {
        for (int j = 1; j <= mesh.columns; ++j) {
            const double *here = mesh.level + i * width + j;
            const double across = std::fabs(here[-1] - 2 * here[0] + here[1]) / 8;
            const double down = std::fabs(here[-width] - 2 * here[0] + here[width]) / 8;
            bent += (across > down ? across : down) > BEND_SIGMAS * mesh.median_noise ? 1 : 0;
        }
    }
    return bent > BENT_SHARE * (mesh.rows * mesh.columns);
}

ST_CLONES void mix(const float *__restrict above, const float *__restrict below, float share,
                   int count, float *__restrict row) {
    const float kept = 1.0f - share;
    for (int u = 0; u < count; ++u) {
        row[u] = above[u] * kept + below[u] * share;
    }
}

ST_CLONES void fill_steps(const uint16_t *__restrict row, int count, int32_t *__restrict steps) {
    for (int u = 0; u < count; ++u) {
        const int32_t step = row[u + 1] - row[u];
        steps[u] = step < 0 ? -step : step;
    }
}

}  // namespace

size_t most_tiles(int width, int height) {
    return (static_cast<size_t>(width) / LEAST_TILE_PX + 3) *
           (static_cast<size_t>(height) / LEAST_TILE_PX + 3);
}

Mesh measure_background(const Image &image, const Kernel &kernel, double *level, double *noise,
                        Arena &arena) {
    Mesh mesh{level, noise, 0, 0, 0.0, 0.0, 0.0, 0.0};
    for (int side = TILE_PX;;) {
        mesh.rows = tiles_along(image.height, side);
        mesh.columns = tiles_along(image.width, side);
        measure(image, kernel, mesh, arena);
        side /= 2;
        if (side < LEAST_TILE_SIGMAS * kernel.sigma_px || side < LEAST_TILE_PX || !is_bent(mesh)) {
            break;
        }
    }
    mesh.tiles_down = static_cast<double>(mesh.rows) / image.height;
    mesh.tiles_across = static_cast<double>(mesh.columns) / image.width;
    return mesh;
}

OverImage::OverImage(const Mesh &mesh, const double *tile, int width, int height, Arena &arena)
    : mesh_(mesh),
      tile_(tile),
      width_(width),
      height_(height),
      places_(arena.take<Between>(static_cast<size_t>(width))),
      over_{arena.take<float>(static_cast<size_t>(width)),
            arena.take<float>(static_cast<size_t>(width))} {
    for (int u = 0; u < width; ++u) {
        places_[u] = between(u, width, mesh.columns);
    }
}

OverImage::Between OverImage::between(int pixel, int pixels, int tiles) {
    const double scale = static_cast<double>(tiles) / pixels;
    const auto place = static_cast<float>((pixel + 0.5) * scale - 0.5);
    const int first = static_cast<int>(std::floor(place));
    if (first < 0) {
        return {0, 0, 0.0f};
    }
    if (first >= tiles - 1) {
        return {tiles - 1, tiles - 1, 0.0f};
    }
    return {first, first + 1, place - static_cast<float>(first)};
}

float OverImage::across(int tile_row, const Between &place) const {
    const double *row = tile_ + (tile_row + 1) * (mesh_.columns + 2) + 1;
    return static_cast<float>(row[place.first]) * (1.0f - place.share) +
           static_cast<float>(row[place.second]) * place.share;
}

void OverImage::fill(int v, float *row) {
    const Between down = between(v, height_, mesh_.rows);
    for (int i = down.first; i <= down.second; ++i) {
        if (filled_[i % 2] != i) {
            for (int u = 0; u < width_; ++u) {
                over_[i % 2][u] = across(i, places_[u]);
            }
            filled_[i % 2] = i;
        }
    }
    mix(over_[down.first % 2], over_[down.second % 2], down.share, width_, row);
}

float OverImage::at(int u, int v) const {
    const Between down = between(v, height_, mesh_.rows);
    return across(down.first, places_[u]) * (1.0f - down.share) +
           across(down.second, places_[u]) * down.share;
}

void subtract_level(const Image &image, const Mesh &mesh, const Plane<float> &plane,
                    Arena &arena) {
    const Arena::Scope scope(arena);
    OverImage level(mesh, mesh.level, image.width, image.height, arena);
    for (int v = 0; v < image.height; ++v) {
        const uint16_t *row = image.row(v);
        float *above = plane.row(v);
        level.fill(v, above);
        for (int u = 0; u < image.width; ++u) {
            above[u] = static_cast<float>(row[u]) - above[u];
        }
    }
}

double pixel_noise(const Image &image, Arena &arena) {
    const Arena::Scope scope(arena);
    const int rows = (image.height + SAMPLE_ROWS - 1) / SAMPLE_ROWS, of_row = image.width - 1;
    const int count = rows * of_row;
    auto *steps = arena.take<int32_t>(static_cast<size_t>(count));
    for (int i = 0; i < rows; ++i) {
        fill_steps(image.row(i * SAMPLE_ROWS), of_row, steps + i * of_row);
    }
    const int upper = order_statistic(steps, count, count / 2);
    const int lower = count % 2 != 0 ? upper : order_statistic(steps, count, count / 2 - 1);
    const double noise = SIGMA_PER_MAD * ((lower + upper) / 2.0) / std::sqrt(2.0);
    return noise > QUANTISATION_DN ? noise : QUANTISATION_DN;
}

bool has_changed(const Mesh &mesh, const Image &image, const Place *places, int count,
                 double noise_dn) {
    int changed = 0;
    for (int i = 0; i < count; ++i) {
        const int u = static_cast<int>(places[i].u), v = static_cast<int>(places[i].v);
        if (!(RING_PX <= u && u < image.width - RING_PX && RING_PX <= v &&
              v < image.height - RING_PX)) {
            continue;
        }
        // A slope leaves the median of a ring as it is.
        const double level = background_at(mesh, u, v).level;
        int darker = 0, not_brighter = 0;
        for (const Pixel &beside : RING) {
            const int value = image.at(u + beside.u, v + beside.v);
            darker += value < level - CHANGED_SIGMAS * noise_dn ? 1 : 0;
            not_brighter += value <= level + CHANGED_SIGMAS * noise_dn ? 1 : 0;
        }
        changed += darker > RING_PIXELS / 2 || not_brighter <= RING_PIXELS / 2 ? 1 : 0;
    }
    return changed > CHANGED_SHARE * count;
}

}  // namespace st
