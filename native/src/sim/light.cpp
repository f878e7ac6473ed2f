// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Light on the image sensor, and charge that is not light: stars, trails of satellites, tracks of
// cosmic rays, and what flows out of full pixels.

#include <algorithm>
#include <cmath>

#include "maths/clones.h"
#include "startracker_sim.h"

namespace {

/// Reach of stars and trails in sigma. Cutting the rest, 6e-7 of the light, shifts a centroid by less
/// than 2e-6 sigma.
constexpr double REACH = 5;

/// Capacity for the pixels along one axis of an image of a star.
constexpr double MOST_SIGMA_PX = 100;
constexpr int MOST_SIDE_PX = 2 * static_cast<int>(REACH * MOST_SIGMA_PX) + 1;

/// Steps in which tracks are drawn.
constexpr int STEPS_PER_PX = 4;

/// Columns that are bloomed at a time.
constexpr int STRIP = 64;

/// Fill fraction (size) with the integral of a unit Gaussian at 0 over pixels.
///
/// Pixel i spans x_i - 1/2 to x_i + 1/2 with x_i = first + i; its fraction is
/// (erf((x_i + 1/2) / (sigma sqrt 2)) - erf((x_i - 1/2) / (sigma sqrt 2))) / 2.
void pixel_fractions(double first, double sigma, int size, double *fraction) {
    const double scale = 1 / (sigma * std::sqrt(2.0));
    double lower = std::erf((first - 0.5) * scale);
    for (int i = 0; i < size; ++i) {
        const double upper = std::erf((first + i + 0.5) * scale);
        fraction[i] = (upper - lower) / 2;
        lower = upper;
    }
}

/// Fill a row of columns (count) with the charge carried to it, and add half of its own excess.
ST_CLONES void flow(float full, int count, float *__restrict line, float *__restrict carried) {
    // All cases, from which the next loop chooses: both vectorise.
    float filled[STRIP], left[STRIP], added[STRIP], vacant[STRIP];
    for (int i = 0; i < count; ++i) {
        vacant[i] = full - line[i];
        filled[i] = line[i] + carried[i];
        left[i] = carried[i] - vacant[i];
        added[i] = carried[i] - vacant[i] / 2;
    }
    for (int i = 0; i < count; ++i) {
        const bool is_over = vacant[i] < 0, fits = carried[i] < vacant[i];
        const float charge = fits ? filled[i] : full, rest = fits ? 0.0F : left[i];
        line[i] = is_over ? line[i] : charge;
        carried[i] = is_over ? added[i] : rest;
    }
}

}  // namespace

extern "C" {

void st_add_starlight(const double *uv, const double *electrons, const double *sigma_px,
                      size_t count, const float *response, int32_t width, int32_t height,
                      float *light) {
    double across[MOST_SIDE_PX], down[MOST_SIDE_PX];
    for (size_t n = 0; n < count; ++n) {
        const double u = uv[2 * n], v = uv[2 * n + 1], sigma = sigma_px[n];
        const double reach = std::ceil(REACH * sigma);
        const double left_px = std::rint(u) - reach, top_px = std::rint(v) - reach;
        // Written so that NaN is left out.
        if (!(sigma <= MOST_SIGMA_PX && left_px < width && top_px < height &&
              left_px + 2 * reach >= 0 && top_px + 2 * reach >= 0)) {
            continue;
        }
        const int left = static_cast<int>(left_px), top = static_cast<int>(top_px);
        const int size = 2 * static_cast<int>(reach) + 1;
        pixel_fractions(left - u, sigma, size, across);
        pixel_fractions(top - v, sigma, size, down);
        for (int i = std::max(0, -top); i < std::min(size, height - top); ++i) {
            const ptrdiff_t row = ptrdiff_t{top + i} * width;
            for (int j = std::max(0, -left); j < std::min(size, width - left); ++j) {
                const ptrdiff_t pixel = row + left + j;
                light[pixel] = static_cast<float>(light[pixel] + electrons[n] * down[i] *
                                                                     across[j] * response[pixel]);
            }
        }
    }
}

/// At distance d from the centre line a pixel gets peak_e sigma / s exp(-d^2 / (2 s^2)), with
/// s^2 = sigma^2 + 1/12: the Gaussian widened by the pixel, its flux across the trail kept.
void st_add_trails(const double *trails, size_t count, double peak_e, double sigma_px,
                   const float *response, int32_t width, int32_t height, float *light) {
    const double s = std::sqrt(sigma_px * sigma_px + 1.0 / 12), reach = REACH * s;
    for (size_t n = 0; n < count; ++n) {
        const double u = trails[4 * n], v = trails[4 * n + 1], du = trails[4 * n + 2],
                     dv = trails[4 * n + 3];
        for (int row = 0; row < height; ++row) {
            // Distance of pixel (column, row): |dv (column - u) - du (row - v)|.
            const double across = du * (row - v);
            int first = 0, last = width - 1;
            if (std::fabs(dv) * width > 1e-9) {
                const double middle = u + across / dv, half = reach / std::fabs(dv);
                first = static_cast<int>(std::clamp<double>(std::ceil(middle - half), 0, width));
                last =
                    static_cast<int>(std::clamp<double>(std::floor(middle + half), -1, width - 1));
            } else if (std::fabs(across) > reach) {
                continue;
            }
            for (int column = first; column <= last; ++column) {
                const double d = dv * (column - u) - across;
                const ptrdiff_t pixel = ptrdiff_t{row} * width + column;
                light[pixel] = static_cast<float>(
                    light[pixel] +
                    peak_e * sigma_px / s * std::exp(-d * d / (2 * s * s)) * response[pixel]);
            }
        }
    }
}

void st_add_tracks(const double *tracks, size_t count, int32_t width, int32_t height,
                   float *light) {
    for (size_t n = 0; n < count; ++n) {
        const double *track = tracks + 5 * n;
        const double u = track[0], v = track[1], azimuth = track[2], length_px = track[3];
        const int steps = static_cast<int>(std::ceil(length_px * STEPS_PER_PX)) + 1;
        const double along = length_px / std::max(steps - 1, 1);
        const double across = along * std::cos(azimuth), down = along * std::sin(azimuth);
        for (int step = 0; step < steps; ++step) {
            const double row = std::rint(v + step * down), column = std::rint(u + step * across);
            if (0 <= row && row < height && 0 <= column && column < width) {
                float &pixel =
                    light[static_cast<ptrdiff_t>(row) * width + static_cast<ptrdiff_t>(column)];
                pixel = static_cast<float>(pixel + track[4] / steps);
            }
        }
    }
}

/// Half of the excess of each pixel flows up, half down, and fills every pixel to the full well until
/// none is left; what reaches the edge of the image is lost. Full pixels end eight standard deviations
/// of the photon noise above the full well, at which the read-out clips: a full pixel has no
/// photon noise.
void st_bloom(float *light, int32_t width, int32_t height, double full_well_e) {
    const auto full = static_cast<float>(full_well_e);
    const float brim = full + 8 * std::sqrt(full);
    for (int left = 0; left < width; left += STRIP) {
        const int count = std::min(STRIP, width - left);
        float carried[STRIP] = {};
        for (int row = 0; row < height; ++row) {
            flow(full, count, light + ptrdiff_t{row} * width + left, carried);
        }
        std::fill_n(carried, STRIP, 0.0F);
        for (int row = height - 1; row >= 0; --row) {
            float *line = light + ptrdiff_t{row} * width + left;
            flow(full, count, line, carried);
            for (int i = 0; i < count; ++i) {
                line[i] = line[i] >= full ? brim : line[i];
            }
        }
    }
}

}  // extern "C"
