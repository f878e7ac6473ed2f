// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/streak_filter.h"

#include <cmath>
#include <cstring>

#include "centroid/noise.h"
#include "centroid/smoothing.h"
#include "centroid/streak_fit.h"
#include "maths/clones.h"
#include "maths/sorting.h"

namespace st {
namespace {

constexpr double LEAST_WEIGHT = 1e-4;  // of the filter, over that of its middle: less is left out
constexpr double LEAST_HALF_WEIGHT = 0.03;  // and at half the size
constexpr double HALF_VARIANCE_PX2 = 0.1;   // that its pixels add to the width of a star
// A peak is where the half reaches so much of the threshold, and is at most so much of the noise
// below it: by 4000 peaks of stars of 0.35 to 4 px none is not.
constexpr double LEAST_REACHED = 0.6, MOST_MISSED_SIGMAS = 2.5;
constexpr int NOISE_SAMPLES = 7;    // one pixel of so many along each axis
constexpr int MOST_REACH_PX = 256;  // of the filter; a longer streak is cut
constexpr int BLOCK = 32;           // pixels filtered at a time

/// The flux of a unit streak about the middle of an image: rows of weights, those from first to
/// end - 1 of which count.
struct StreakKernel {
    int across, down;
    float *weight;
    int *first, *end;

    int columns() const { return 2 * across + 1; }
    int rows() const { return 2 * down + 1; }
    float *row(int y) const { return weight + static_cast<ptrdiff_t>(y) * columns(); }
};

int reach_of(double streak_px, double sigma_px) {
    const double reach = std::ceil(std::fabs(streak_px) / 2 + (2.5 * sigma_px + 1));
    return reach < MOST_REACH_PX ? static_cast<int>(reach) : MOST_REACH_PX;
}

/// Return the kernel over its energy: the filtered image is the flux.
StreakKernel kernel_of(double u_px, double v_px, double sigma_px, double least_weight,
                       Arena &arena) {
    StreakKernel kernel{};
    kernel.across = reach_of(u_px, sigma_px);
    kernel.down = reach_of(v_px, sigma_px);
    const int rows = kernel.rows(), columns = kernel.columns();
    kernel.weight = arena.take<float>(static_cast<size_t>(rows) * static_cast<size_t>(columns));
    kernel.first = arena.take<int>(static_cast<size_t>(rows));
    kernel.end = arena.take<int>(static_cast<size_t>(rows));
    StreakStar star = streak_at({0.0, 0.0}, {u_px, v_px}, sigma_px);
    const StreakShape shape(star);
    const double least = least_weight * shape.share_at(0.0, 0.0);
    double energy = 0.0;
    for (int y = 0; y < rows; ++y) {
        float *row = kernel.row(y);
        kernel.first[y] = columns;
        kernel.end[y] = 0;
        for (int x = 0; x < columns; ++x) {
            const double share = shape.share_at(x - kernel.across, y - kernel.down);
            row[x] = static_cast<float>(share);
            energy += share * share;
            if (share > least) {
                kernel.first[y] = kernel.first[y] < x ? kernel.first[y] : x;
                kernel.end[y] = x + 1;
            }
        }
    }
    for (int k = 0; k < rows * columns; ++k) {
        kernel.weight[k] = static_cast<float>(static_cast<double>(kernel.weight[k]) / energy);
    }
    return kernel;
}

/// Fill sum (BLOCK) with filtered pixels, whose lines of the kernel are given from x on.
ST_CLONES void filter_block(const StreakKernel &kernel, const float *const *line, int x,
                            float *__restrict sum) {
    for (int i = 0; i < BLOCK; ++i) {
        sum[i] = 0.0F;
    }
    for (int y = 0; y < kernel.rows(); ++y) {
        const float *row = kernel.row(y), *from = line[y] + x;
        int k = kernel.first[y];
        // Each sum is read and written once for four products.
        for (; k + 4 <= kernel.end[y]; k += 4) {
            const float a = row[k], b = row[k + 1], c = row[k + 2], d = row[k + 3];
            for (int i = 0; i < BLOCK; ++i) {
                sum[i] =
                    (((sum[i] + a * from[k + i]) + b * from[k + 1 + i]) + c * from[k + 2 + i]) +
                    d * from[k + 3 + i];
            }
        }
        for (; k < kernel.end[y]; ++k) {
            for (int i = 0; i < BLOCK; ++i) {
                sum[i] += row[k] * from[k + i];
            }
        }
    }
}

/// Replace a plane by itself after the filter, and by 0 in blocks of a row (BLOCK pixels) that
/// wanted(v, block) does not want; the image is mirrored at its borders.
template <class Wanted>
void filter(const Plane<float> &plane, const StreakKernel &kernel, Wanted wanted, Arena &arena) {
    const Arena::Scope scope(arena);
    const int width = plane.width, height = plane.height, kept = kernel.rows();
    const int extended = width + 2 * kernel.across + BLOCK;
    const auto length = static_cast<size_t>(extended);
    auto *lines = arena.take<float>(length * static_cast<size_t>(kept));
    auto **line = arena.take<const float *>(static_cast<size_t>(kept));
    const auto line_of = [=](int v) {
        return lines + static_cast<ptrdiff_t>(v % kept) * extended;
    };
    for (int below = 0; below < height + kernel.down; ++below) {
        if (below < height) {
            const float *row = plane.row(below);
            float *extension = line_of(below);
            std::memcpy(extension + kernel.across, row,
                        sizeof(float) * static_cast<size_t>(width));
            for (int x = 0; x < kernel.across; ++x) {
                extension[x] = row[mirrored(x - kernel.across, width)];
            }
            for (int x = width + kernel.across; x < extended; ++x) {
                extension[x] = row[mirrored(x - kernel.across, width)];
            }
        }
        const int v = below - kernel.down;
        if (v < 0) {
            continue;
        }
        for (int y = 0; y < kept; ++y) {
            line[y] = line_of(mirrored(v + y - kernel.down, height));
        }
        float *target = plane.row(v);
        for (int x = 0; x < width; x += BLOCK) {
            float sums[BLOCK] = {};
            if (wanted(v, x / BLOCK)) {
                filter_block(kernel, line, x, sums);
            }
            const int whole = width - x < BLOCK ? width - x : BLOCK;
            std::memcpy(target + x, sums, static_cast<size_t>(whole) * sizeof(float));
        }
    }
}

/// Return the noise of an image by a part of its pixels.
double noise_of(const Plane<float> &flux, Arena &arena) {
    const Arena::Scope scope(arena);
    const int most = (flux.width / NOISE_SAMPLES + 1) * (flux.height / NOISE_SAMPLES + 1);
    auto *sample = arena.take<float>(static_cast<size_t>(most));
    int count = 0;
    for (int v = 0; v < flux.height; v += NOISE_SAMPLES) {
        for (int u = 0; u < flux.width; u += NOISE_SAMPLES) {
            sample[count++] = flux.at(u, v);
        }
    }
    const auto level = static_cast<float>(median(sample, count));
    for (int k = 0; k < count; ++k) {
        sample[k] = std::fabs(sample[k] - level);
    }
    return SIGMA_PER_MAD * median(sample, count);
}

/// Fill half with the sums of 2 x 2 pixels; a last odd row or column counts twice.
void halve(const Plane<float> &plane, const Plane<float> &half) {
    for (int v = 0; v < half.height; ++v) {
        const float *above = plane.row(2 * v);
        const float *below = plane.row(2 * v + 1 < plane.height ? 2 * v + 1 : 2 * v);
        float *sums = half.row(v);
        for (int u = 0; u < plane.width / 2; ++u) {
            sums[u] = (above[2 * u] + above[2 * u + 1]) + (below[2 * u] + below[2 * u + 1]);
        }
        if (plane.width % 2 != 0) {
            sums[half.width - 1] = 2 * (above[plane.width - 1] + below[plane.width - 1]);
        }
    }
}

/// Fill may_be, of blocks of the rows of the half, with whether the half, or what is next to it,
/// reaches a value.
void mark(const Plane<float> &half, float least, const Plane<uint8_t> &may_be) {
    std::memset(may_be.value, 0, static_cast<size_t>(may_be.size()));
    const auto set = [&may_be](int u, int v) {
        for (int y = v > 0 ? v - 1 : 0; y <= v + 1 && y < may_be.height; ++y) {
            may_be.at(2 * u / BLOCK, y) = 1;
        }
    };
    for (int v = 0; v < half.height; ++v) {
        const float *row = half.row(v);
        for (int u = 0; u < half.width; ++u) {
            if (row[u] >= least) {
                set(u > 0 ? u - 1 : 0, v);
                set(u + 1 < half.width ? u + 1 : u, v);
            }
        }
    }
}

Plane<float> half_of(int width, int height, Arena &arena) {
    const int w = (width + 1) / 2, h = (height + 1) / 2;
    return {arena.take<float>(static_cast<size_t>(w) * static_cast<size_t>(h)), w, h};
}

}  // namespace

double filter_streaks(const Plane<float> &plane, const Streak &streak, double sigma_px,
                      double threshold_sigmas, Arena &arena) {
    const Arena::Scope scope(arena);
    const Plane<float> half = half_of(plane.width, plane.height, arena);
    const int blocks = (plane.width + BLOCK - 1) / BLOCK;
    const Plane<uint8_t> may_be{
        arena.take<uint8_t>(static_cast<size_t>(blocks) * static_cast<size_t>(half.height)),
        blocks, half.height};
    halve(plane, half);
    {
        const Arena::Scope of_half(arena);
        const double half_sigma_px = std::sqrt(sigma_px * sigma_px / 4 + HALF_VARIANCE_PX2);
        const StreakKernel kernel =
            kernel_of(streak.u_px / 2, streak.v_px / 2, half_sigma_px, LEAST_HALF_WEIGHT, arena);
        filter(half, kernel, [](int, int) { return true; }, arena);
        const double sigmas =
            std::fmin(LEAST_REACHED * threshold_sigmas, threshold_sigmas - MOST_MISSED_SIGMAS);
        mark(half, static_cast<float>(sigmas * noise_of(half, arena)), may_be);
    }
    const StreakKernel kernel = kernel_of(streak.u_px, streak.v_px, sigma_px, LEAST_WEIGHT, arena);
    const auto wanted = [&may_be](int v, int block) {
        return v % NOISE_SAMPLES == 0 || may_be.at(block, v / 2) != 0;
    };
    filter(plane, kernel, wanted, arena);
    return noise_of(plane, arena);
}

size_t streak_filter_bytes(int width, int height) {
    const auto w = static_cast<size_t>(width), h = static_cast<size_t>(height);
    const size_t reach = MOST_REACH_PX, rows = 2 * reach + 1;
    const size_t kernel = Arena::padded<float>(rows * rows) + 2 * Arena::padded<int>(rows);
    return Arena::padded<float>((w + 1) / 2 * ((h + 1) / 2)) +
           Arena::padded<uint8_t>((w / BLOCK + 1) * (h / 2 + 1)) + kernel +
           Arena::padded<float>((w + 2 * reach + BLOCK) * rows) +
           Arena::padded<const float *>(rows) + Arena::padded<float>((w / 7 + 1) * (h / 7 + 1));
}

}  // namespace st
