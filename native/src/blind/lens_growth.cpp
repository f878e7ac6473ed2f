// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "blind/lens_growth.h"

#include <algorithm>
#include <cmath>

#include "attitude/triad.h"
#include "identify/false_alarm.h"

namespace st {
namespace {

constexpr int STAGES = 12, BASE = 4;
constexpr double GATE_SQUARE = 9.0;
// Probability of a random spot in the gate of a star at most.
constexpr double MOST_CHANCE = 0.15;
constexpr double LEAST_ERROR_PX = 1.0;
// After each stage at least one star more than before, of the first ones.
constexpr int FIRST_STARS = 5, GROWING = 3;
constexpr double MOST_ERROR = 0.02;  // of the longest side: the four stars do not fit the lens
constexpr int PARAMETER_STARS = 6;
constexpr double LEAST_FARTHEST_RAD = 1.0;
// Beyond no lens sees stars: images have a black margin.
constexpr double WIDEST_COS = -0.12186934340514748;  // of 97 deg

int matched(const int32_t *star, int spots) {
    return static_cast<int>(
        std::count_if(star, star + spots, [](int32_t one) { return one >= 0; }));
}

/// Return how probable it is that so many spots are matched by chance.
double chance(const LensFit &fit, const SkyAndSpots &seen, const int32_t *star, bool *chosen) {
    const Lens &lens = fit.view.lens;
    const Matrix3 R = matrix_from_quaternion(fit.view.q);
    int in_image = 0;
    for (int k = 0; k < seen.stars; ++k) {
        const Vector3 sensor = sensor_direction(R, seen.direction[k]);
        in_image += sensor[2] >= WIDEST_COS && shows(lens, project(lens, sensor));
    }
    Point mean{0.0, 0.0};
    for (int i = 0; i < seen.spots; ++i) {
        mean = {mean.x + seen.spot[i].x / seen.spots, mean.y + seen.spot[i].y / seen.spots};
    }
    double spread = 0.0;
    for (int i = 0; i < seen.spots; ++i) {
        const double du = seen.spot[i].x - mean.x, dv = seen.spot[i].y - mean.y;
        spread += (du * du + dv * dv) / seen.spots;
        chosen[i] = star[i] >= 0;
    }
    // A disc of radius R has the mean square R^2 / 2.
    const double area =
        std::fmin(2 * M_PI * spread, static_cast<double>(lens.width) * lens.height);
    const double error_px = std::fmax(fit.error_px, LEAST_ERROR_PX);
    const double p = std::fmin(in_image * M_PI * GATE_SQUARE * error_px * error_px / area, 1.0);
    const int m = matched(star, seen.spots) - PARAMETER_STARS, n = seen.spots - PARAMETER_STARS;
    return m <= 0 ? 1.0
                  : fisher_combined(binomial_tail(m, n, p) *
                                    order_probability(star, chosen, seen.spots));
}

}  // namespace

void gated_stars(const LensFit &fit, int parameters, double error_px, const SkyAndSpots &seen,
                 int32_t *star, double *best) {
    const Lens &lens = fit.view.lens;
    const Matrix3 R = matrix_from_quaternion(fit.view.q);
    const double least = std::fmax(least_cosine(lens), WIDEST_COS);
    const double largest =
        MOST_CHANCE * lens.width * lens.height / (M_PI * std::max(seen.spots, 1));
    std::fill(star, star + seen.spots, -1);
    std::fill(best, best + seen.spots, INFINITY);
    for (int k = 0; k < seen.stars; ++k) {
        const Vector3 sensor = sensor_direction(R, seen.direction[k]);
        if (sensor[2] < least) {
            continue;
        }
        const Point plane = plane_point(lens.equidistant, sensor), pixel = pixel_of(lens, plane);
        if (!shows(lens, pixel)) {
            continue;
        }
        const Matrix<2, MOST_PARAMETERS> H = derivatives(lens, plane, pixel, parameters);
        const Matrix<2, MOST_PARAMETERS> HP = H * fit.P;
        double uu = error_px * error_px, vv = uu, uv = 0.0;
        for (int i = 0; i < MOST_PARAMETERS; ++i) {
            uu += HP[0][i] * H[0][i];
            vv += HP[1][i] * H[1][i];
            uv += HP[0][i] * H[1][i];
        }
        const double determinant = uu * vv - uv * uv;
        if (!(GATE_SQUARE * std::sqrt(determinant) < largest)) {
            continue;
        }
        int nearest = -1;
        double nearest_square = GATE_SQUARE;
        for (int i = 0; i < seen.spots; ++i) {
            const double du = seen.spot[i].x - pixel.x, dv = seen.spot[i].y - pixel.y;
            // Most spots are outside the rectangle around the gate.
            if (du * du > GATE_SQUARE * uu || dv * dv > GATE_SQUARE * vv) {
                continue;
            }
            const double square = (vv * du * du - 2 * uv * du * dv + uu * dv * dv) / determinant;
            if (square < nearest_square) {
                nearest = i;
                nearest_square = square;
            }
        }
        if (nearest >= 0 && nearest_square < best[nearest]) {
            star[nearest] = k;
            best[nearest] = nearest_square;
        }
    }
}

SpotWork::SpotWork(int spots, Arena &arena) {
    const auto count = static_cast<size_t>(spots);
    square = arena.take<double>(count);
    best = arena.take<double>(count);
    before = arena.take<int32_t>(count);
    star = arena.take<int32_t>(count);
    chosen = arena.take<bool>(count);
}

double grow_lens(const LensPrior &prior, const SkyAndSpots &seen, const int32_t spot[4],
                 const int32_t four[4], LensFit &fit, const SpotWork &work) {
    int32_t *star = work.star;
    Vector3 sensor[BASE], icrf[BASE];
    std::fill(star, star + seen.spots, -1);
    for (int i = 0; i < BASE; ++i) {
        sensor[i] = unproject(prior.start, seen.spot[spot[i]]);
        icrf[i] = seen.direction[four[i]];
        star[spot[i]] = four[i];
    }
    fit.view = {prior.start, quaternion_from_matrix(triad({BASE, sensor, icrf, nullptr}, 0, 1))};
    const double most_px = MOST_ERROR * std::max(prior.start.width, prior.start.height);
    for (int stage = 0; stage < STAGES; ++stage) {
        fit_lens(prior, seen, star, work.square, fit);
        if (!(fit.error_px < most_px && fit.view.lens.farthest_rad > LEAST_FARTHEST_RAD)) {
            return 1.0;
        }
        std::copy(star, star + seen.spots, work.before);
        gated_stars(fit, prior.parameters, std::fmax(fit.error_px, LEAST_ERROR_PX), seen, star,
                    work.best);
        if (matched(star, seen.spots) < FIRST_STARS + std::min(stage, GROWING)) {
            return 1.0;
        }
        if (std::equal(star, star + seen.spots, work.before)) {
            break;
        }
    }
    return chance(fit, seen, star, work.chosen);
}

}  // namespace st
