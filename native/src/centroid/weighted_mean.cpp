// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/weighted_mean.h"

#include <cmath>

namespace st {
namespace {

constexpr double SEGMENT_SIGMAS = 3.0;  // noise of a pixel, above which it belongs to a star
constexpr int PHASES = 32;  // positions of a star in its pixel over which its error is averaged
constexpr int STRIDE = 13;  // of a lattice with one point in each of 32 columns and 32 rows
constexpr double CONVERGED = 1e-3;  // of the iterative threshold: share of the range
constexpr int MOST_ITERATIONS = 30;
constexpr double FAR_SIGMAS = 8.0;  // noise never lifts a pixel that far to the threshold

/// Return the threshold of a window of count pixels above a background of this variance.
double threshold_of(const Segmentation &segmentation, const double *grey, int count,
                    double variance) {
    if (segmentation.threshold_dn > 0) {
        return segmentation.factor * segmentation.threshold_dn;
    }
    double threshold = SEGMENT_SIGMAS * std::sqrt(variance);
    if (segmentation.iterative) {
        const double iterative = iterative_threshold(grey, count);
        threshold = threshold > iterative ? threshold : iterative;
    }
    return segmentation.factor * threshold;
}

double weight_of(st_centroid_method method, double grey, double threshold) {
    switch (method) {
        case ST_BINARY:
            return 1.0;
        case ST_GREY:
            return grey;
        case ST_SQUARED:
            return grey * grey;
        default:
            return grey - threshold;
    }
}

struct Expected {
    double mean, square;
};

/// Return the means of the weight of a pixel and of its square, over normal noise.
Expected expected(st_centroid_method method, double grey, double sigma, double threshold) {
    const double a = (threshold - grey) / sigma;
    if (a > FAR_SIGMAS) {
        return {0.0, 0.0};
    }
    const double above = 0.5 * std::erfc(a * std::sqrt(0.5));
    if (method == ST_BINARY) {
        return {above, above};
    }
    const double density = std::exp(-0.5 * a * a) / std::sqrt(2 * M_PI);
    // Moments of a standard normal distribution over z > a; grey is m + s z.
    const double second = above + a * density, third = (a * a + 2) * density;
    const double fourth = 3 * above + (a * a + 3) * a * density;
    const double m = method == ST_THRESHOLDED ? grey - threshold : grey, s = sigma;
    const double square = m * m * above + 2 * m * s * density + s * s * second;
    if (method == ST_SQUARED) {
        return {square, m * m * m * m * above + 4 * (m * m * m) * s * density +
                            6 * m * m * s * s * second + 4 * m * (s * s * s) * third +
                            s * s * s * s * fourth};
    }
    return {m * above + s * density, square};
}

/// Return the expected square error, of both axes, of a star at u, v of a window whose grey values
/// are in grey_work.
///
/// Per axis it is the bias and the noise of the mean, E_k the mean and V_k the variance of the
/// weight of pixel k:
///
///     (x - u)^2 + sum((x_k - x)^2 V_k) / sum(E_k)^2,  x = sum(x_k E_k) / sum(E_k)
double square_error_at(st_centroid_method method, const NoiseModel &noise, double threshold,
                       const Window &window, double u, double v, GreyWork &grey_work) {
    const int count = window.count;
    double total = 0.0, across = 0.0, down = 0.0;
    for (int y = 0; y < count; ++y) {
        for (int x = 0; x < count; ++x) {
            const int k = y * count + x;
            grey_work.variance[k] = 0.0;
            if (window.used[y * window.filled + x] > 0.0F) {
                const double variance = pixel_variance(noise, window.variance, grey_work.grey[k]);
                const Expected weight =
                    expected(method, grey_work.grey[k], std::sqrt(variance), threshold);
                grey_work.variance[k] = weight.square - weight.mean * weight.mean;
                total += weight.mean;
                across += weight.mean * x;
                down += weight.mean * y;
            }
        }
    }
    across /= total;
    down /= total;
    double noise_sum = 0.0;
    for (int y = 0; y < count; ++y) {
        for (int x = 0; x < count; ++x) {
            noise_sum += grey_work.variance[y * count + x] *
                         ((x - across) * (x - across) + (y - down) * (y - down));
        }
    }
    return (across - u) * (across - u) + (down - v) * (down - v) + noise_sum / (total * total);
}

/// Return the mean square error per axis in px^2 of a star, averaged over PHASES.
double square_error(st_centroid_method method, const Star &star, const NoiseModel &noise,
                    const Segmentation &segmentation, const Window &window, GreyWork &grey_work) {
    const int count = window.count, middle = count / 2;
    double error = 0.0;
    for (int phase = 0; phase < PHASES; ++phase) {
        const double u = middle + (phase + 0.5) / PHASES - 0.5;
        const double v = middle + (phase * STRIDE % PHASES + 0.5) / PHASES - 0.5;
        profile(u, star[SIGMA], 0, count, grey_work.columns);
        profile(v, star[SIGMA], 0, count, grey_work.rows);
        for (int y = 0; y < count; ++y) {
            for (int x = 0; x < count; ++x) {
                const double used = static_cast<double>(window.used[y * window.filled + x]);
                grey_work.grey[y * count + x] =
                    used * star[FLUX] * grey_work.rows.share[y] * grey_work.columns.share[x];
            }
        }
        const double threshold =
            threshold_of(segmentation, grey_work.grey, count * count, window.variance);
        error += square_error_at(method, noise, threshold, window, u, v, grey_work);
    }
    return error / (2 * PHASES);
}

}  // namespace

WeightedMean weighted_mean(st_centroid_method method, const Star &star, const NoiseModel &noise,
                           const Segmentation &segmentation, const FitWork &work,
                           GreyWork &grey_work) {
    const Window &window = work.window;
    const int count = window.count;
    // Saturated pixels count with their value: without them there would be a hole.
    for (int y = 0; y < count; ++y) {
        for (int x = 0; x < count; ++x) {
            grey_work.grey[y * count + x] =
                static_cast<double>(work.own[y * window.filled + x]) + star[LEVEL];
        }
    }
    const double threshold =
        threshold_of(segmentation, grey_work.grey, count * count, window.variance);
    double total = 0.0, across = 0.0, down = 0.0;
    for (int y = 0; y < count; ++y) {
        for (int x = 0; x < count; ++x) {
            const double grey = grey_work.grey[y * count + x];
            if (grey >= threshold) {
                const double weight = weight_of(method, grey, threshold);
                total += weight;
                across += weight * x;
                down += weight * y;
            }
        }
    }
    return {window.left + across / total, window.top + down / total,
            std::sqrt(square_error(method, star, noise, segmentation, window, grey_work))};
}

double iterative_threshold(const double *grey, int count) {
    double low = grey[0], high = grey[0];
    for (int k = 1; k < count; ++k) {
        low = grey[k] < low ? grey[k] : low;
        high = grey[k] > high ? grey[k] : high;
    }
    double threshold = (low + high) / 2;
    for (int iteration = 0; iteration < MOST_ITERATIONS; ++iteration) {
        int bright = 0;
        double total = 0.0, bright_total = 0.0;
        for (int k = 0; k < count; ++k) {
            total += grey[k];
            if (grey[k] >= threshold) {
                ++bright;
                bright_total += grey[k];
            }
        }
        if (bright == 0 || bright == count) {
            break;
        }
        const double before = threshold;
        threshold = (bright_total / bright + (total - bright_total) / (count - bright)) / 2;
        if (std::fabs(threshold - before) < CONVERGED * (high - low)) {
            break;
        }
    }
    return threshold;
}

}  // namespace st
