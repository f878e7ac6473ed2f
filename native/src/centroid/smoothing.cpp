// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/smoothing.h"

#include <cmath>

#include "maths/clones.h"

namespace st {
namespace {

/// Return the share of the weights that can be written as means of two neighbours.
double share_of_pairs(const Kernel &kernel) {
    double rest[MOST_WEIGHTS] = {}, share = 0.0;
    for (int k = 0; k <= kernel.radius; ++k) {
        rest[k] = kernel.weights[k];
    }
    rest[0] /= 2;  // the middle one belongs to both sides
    for (int k = kernel.radius; k > 0; --k) {
        const double paired = rest[k - 1] < rest[k] ? rest[k - 1] : rest[k];
        rest[k - 1] -= paired;
        rest[k] -= paired;
        share += 4 * paired;
    }
    return share;
}

/// Fill sums with w_0 row + w_1 (above + below) + w_2 (above_2 + below_2).
template <class T>
__attribute__((always_inline)) inline void weigh_five(
    const T *__restrict above_2, const T *__restrict above, const T *__restrict row,
    const T *__restrict below, const T *__restrict below_2, const float *weights, int count,
    float *__restrict sums) {
    const float w = weights[0], w_1 = weights[1], w_2 = weights[2];
    for (int x = 0; x < count; ++x) {
        sums[x] = w * static_cast<float>(row[x]) +
                  w_1 * (static_cast<float>(above[x]) + static_cast<float>(below[x])) +
                  w_2 * (static_cast<float>(above_2[x]) + static_cast<float>(below_2[x]));
    }
}

/// Add to sums w_0 (above + below) + w_1 (above_2 + below_2).
template <class T>
__attribute__((always_inline)) inline void add_four(
    const T *__restrict above_2, const T *__restrict above, const T *__restrict below,
    const T *__restrict below_2, const float *weights, int count, float *__restrict sums) {
    const float w_1 = weights[0], w_2 = weights[1];
    for (int x = 0; x < count; ++x) {
        sums[x] += w_1 * (static_cast<float>(above[x]) + static_cast<float>(below[x])) +
                   w_2 * (static_cast<float>(above_2[x]) + static_cast<float>(below_2[x]));
    }
}

template <class T>
__attribute__((always_inline)) inline void weigh_down(const T *const *rows, const Kernel &kernel,
                                                      int width, float *line) {
    const int radius = kernel.radius;
    const T *const *middle = rows + radius;
    float *inner = line + radius;
    weigh_five(middle[-2], middle[-1], middle[0], middle[1], middle[2], kernel.weights, width,
               inner);
    for (int k = 3; k < radius; k += 2) {
        add_four(middle[-k - 1], middle[-k], middle[k], middle[k + 1], kernel.weights + k, width,
                 inner);
    }
    for (int k = 1; k <= radius; ++k) {
        line[radius - k] = inner[mirrored(-k, width)];
        line[radius + width - 1 + k] = inner[mirrored(width - 1 + k, width)];
    }
}

}  // namespace

Kernel gaussian_kernel(double sigma_px) {
    double side[MOST_WEIGHTS] = {}, sum = 0.0, squares = 0.0;
    const int count = static_cast<int>(std::ceil(2 * sigma_px)) + 1;
    for (int k = 0; k < count; ++k) {
        const double sigmas = k / sigma_px;
        side[k] = std::exp(-0.5 * (sigmas * sigmas));
        sum += side[k];
    }
    const double total = 2 * sum - side[0];
    Kernel kernel{};
    kernel.radius = count % 2 == 0 ? count : count - 1;
    kernel.sigma_px = sigma_px;
    for (int k = 0; k < count; ++k) {
        side[k] /= total;
        kernel.weights[k] = static_cast<float>(side[k]);
        squares += side[k] * side[k];
    }
    kernel.noise_gain = 2 * squares - side[0] * side[0];
    kernel.pairs = share_of_pairs(kernel);
    return kernel;
}

ST_CLONES void filter_down(const uint16_t *const *rows, const Kernel &kernel, int width,
                           float *line) {
    weigh_down(rows, kernel, width, line);
}

ST_CLONES void filter_down(const float *const *rows, const Kernel &kernel, int width,
                           float *line) {
    weigh_down(rows, kernel, width, line);
}

ST_CLONES void filter_across(const float *line, const Kernel &kernel, int begin, int end,
                             float *target) {
    const float *middle = line + kernel.radius + begin;
    const int count = end - begin;
    weigh_five(middle - 2, middle - 1, middle, middle + 1, middle + 2, kernel.weights, count,
               target + begin);
    for (int k = 3; k < kernel.radius; k += 2) {
        add_four(middle - k - 1, middle - k, middle + k, middle + k + 1, kernel.weights + k, count,
                 target + begin);
    }
}

double filtered_at(const Image &image, const Kernel &kernel, int u, int v) {
    const int radius = kernel.radius;
    double total = 0.0;
    for (int y = -radius; y <= radius; ++y) {
        const uint16_t *row = image.row(mirrored(v + y, image.height));
        double across = 0.0;
        for (int x = -radius; x <= radius; ++x) {
            across += static_cast<double>(kernel.weights[x < 0 ? -x : x]) *
                      row[mirrored(u + x, image.width)];
        }
        total += static_cast<double>(kernel.weights[y < 0 ? -y : y]) * across;
    }
    return total;
}

}  // namespace st
