// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "integrity/stamp_jitter.h"

#include <cmath>

#include "integrity/checks.h"
#include "maths/sorting.h"
#include "maths/symmetric.h"

namespace st {
namespace {

using namespace checks;

constexpr double MEMORY = 0.95;  // of the rates of the frames before
/// Variance of a prediction of an oscillation by three attitudes, over that of one of them.
constexpr double PREDICTED = 6.0;
constexpr double FADES = 0.98;  // from frame to frame, a variance that the last do not show
/// The timestamp errors of frames that are stamped on arrival, on a machine that is not loaded.
constexpr double DOUBT_S = limit(STAMP_ERRORS, "first_s");
constexpr int DOUBT_FRAMES = STAMP_ERRORS.frames;
/// Mean size of a product of two times in a row, over the variance of one frame:
/// 6 (2 / pi) (sqrt(1 - c^2) + c asin c) of their correlation c = -2/3.
constexpr double MEAN_SIZE = 4.7;
constexpr double LIMIT_SIGMAS = 2.5;  // a longer time, as of a jump of the rate, counts as this

double least(double a, double b) {
    return b < a ? b : a;
}

double most(double a, double b) {
    return b > a ? b : a;
}

bool is_zero(const Vector3 &v) {
    return v[0] == 0 && v[1] == 0 && v[2] == 0;
}

// --- the variance of the stamps ---

/// r + s^2 by times, the mean r, and the number of products.
struct WhiteVariance {
    double seen, noise;
    int products;
};

/// Return the size beyond which a time counts as this: of their median, NaN without any.
double limit_of(const double *times_s) {
    double size[COMPARED_FRAMES];
    int count = 0;
    for (int k = 0; k < COMPARED_FRAMES; ++k) {
        if (!std::isnan(times_s[k])) {
            size[count++] = std::fabs(times_s[k]);
        }
    }
    return count > 0 ? LIMIT_SIGMAS * SIGMA_PER_MAD * median(size, count) : NAN;
}

WhiteVariance white_variance(const double *times_s, const double *variances_s2) {
    const double limit = limit_of(times_s);
    double product = 0.0, noise = 0.0, total = 0.0;
    int products = 0;
    for (int k = 1; k < COMPARED_FRAMES; ++k) {
        if (std::isfinite(times_s[k] * times_s[k - 1])) {
            // Where the body hardly turns a time says little.
            const double weight = 1 / (variances_s2[k] * variances_s2[k - 1]);
            product += weight * (least(most(times_s[k], -limit), limit) *
                                 least(most(times_s[k - 1], -limit), limit));
            noise += std::sqrt(weight);
            total += weight;
            ++products;
        }
    }
    return products > 0 ? WhiteVariance{-product / total / 4, noise / total, products}
                        : WhiteVariance{0.0, 0.0, 0};
}

/// Return s^2 out of the mean product of successive times, 0 where it is not significant. expected is
/// whether there were timestamp errors so far.
double stamp_variance(const Differences &memory, bool expected) {
    const auto [seen, noise, products] = white_variance(memory.times_s, memory.variances_s2);
    if (products < limit(STAMP_ERRORS, "products")) {
        return 0.0;
    }
    const double least_seen =
        expected ? limit(STAMP_ERRORS, "expected") : limit(STAMP_ERRORS, "many");
    const double significant = (least_seen + limit(STAMP_ERRORS, "few") / products) * noise;
    double across = 0.0;
    for (const auto &axis : memory.across_s) {
        across += white_variance(axis, memory.variances_s2).seen;
    }
    const double shaken = across > significant ? across - noise : 0.0;
    if (seen <= significant + limit(STAMP_ERRORS, "shaken") * shaken) {
        return 0.0;
    }
    return seen - noise - shaken;
}

/// Return the standard deviation that the first frames do not exclude.
double doubt(const StampJitter &jitter) {
    if (jitter.frames > 2 * DOUBT_FRAMES) {
        return 0.0;
    }
    const Differences &memory = jitter.differences;
    double sum = 0.0;
    int products = 0;
    for (int k = 1; k < COMPARED_FRAMES; ++k) {
        const double size = std::fabs(memory.times_s[k] * memory.times_s[k - 1]);
        if (std::isfinite(size)) {
            sum += size;
            ++products;
        }
    }
    if (products == 0) {
        return DOUBT_S;
    }
    const double size_s2 = sum / products / MEAN_SIZE;
    const double noise_s2 = memory.variances_s2[COMPARED_FRAMES - 1];
    if (jitter.frames > DOUBT_FRAMES) {
        return least(DOUBT_S, std::sqrt(most(size_s2 - 2 * noise_s2, 0.0)));
    }
    // n products of two normal values are on average so much too small, in one case of twenty.
    const double factor = 1 + 20.0 / (products * products);
    return least(DOUBT_S, std::sqrt(factor * (size_s2 + noise_s2)));
}

// --- from frame to frame ---

void shift(double *values, double newest) {
    for (int k = 0; k + 1 < COMPARED_FRAMES; ++k) {
        values[k] = values[k + 1];
    }
    values[COMPARED_FRAMES - 1] = newest;
}

/// Add t_k, u_k and r of a frame; false where the predicted rate w is zero.
bool add_difference(const AttitudeAt &before, const AttitudeAt &predicted,
                    const AttitudeAt &corrected, const Vector3 &turn, const Matrix3 &R_inverse,
                    double interval_ratio, Differences &memory) {
    const Vector3 &rate = predicted.rate_rad_s;
    if (is_zero(rate)) {
        return false;
    }
    const Vector3 between = rotation_between(before.quaternion, predicted.quaternion);
    const Vector3 correction = rotation_between(predicted.quaternion, corrected.quaternion);
    const Vector3 weight = R_inverse * rate;
    double along = 0.0, square = 0.0;
    Vector3 difference;
    for (int i = 0; i < 3; ++i) {
        const double step = between[i] + turn[i] - memory.left[i];
        difference[i] = step - memory.step[i] * interval_ratio;
        along += weight[i] * difference[i];
        square += weight[i] * rate[i];
        memory.left[i] = turn[i] - correction[i];
        memory.step[i] = step;
    }
    shift(memory.times_s, along / square);
    shift(memory.variances_s2, 1 / square);
    // One of x and y is across the rate, or both are.
    const double speed2 = dot(rate, rate), axes = 1 + rate[2] * rate[2] / speed2;
    for (int axis = 0; axis < 2; ++axis) {
        shift(memory.across_s[axis],
              (difference[axis] - rate[axis] * along / square) / std::sqrt(axes * speed2));
    }
    return true;
}

/// Remember the error of a prediction; errors of the stamps are such errors as well.
void add_recent(const Vector3 &along, const Vector3 &turn, double speed2, StampJitter &jitter) {
    const double product = dot(along, turn);
    if (jitter.recents == RECENT_PREDICTIONS) {
        for (int k = 0; k + 1 < RECENT_PREDICTIONS; ++k) {
            jitter.recent[k] = jitter.recent[k + 1];
        }
        --jitter.recents;
    }
    jitter.recent[jitter.recents++] = {product * product / speed2 - PREDICTED, speed2};
}

/// Return the largest standard deviation that the recent predictions allow.
double most_by_recent(const StampJitter &jitter) {
    if (jitter.frames <= DOUBT_FRAMES || jitter.recents == 0) {
        return INFINITY;
    }
    double excess = 0.0, weight_s2 = 0.0;
    for (int k = 0; k < jitter.recents; ++k) {
        excess += jitter.recent[k].excess;
        weight_s2 += jitter.recent[k].speed2;
    }
    return std::sqrt(most(excess, 0.0) / weight_s2);
}

}  // namespace

StampJitter start_jitter() {
    StampJitter jitter{};
    interrupt_jitter(jitter);
    Differences &memory = jitter.differences;
    for (int k = 0; k < COMPARED_FRAMES; ++k) {
        memory.times_s[k] = memory.variances_s2[k] = NAN;
        memory.across_s[0][k] = memory.across_s[1][k] = NAN;
    }
    return jitter;
}

void interrupt_jitter(StampJitter &jitter) {
    jitter.interval_s = NAN;
    jitter.differences.left = jitter.differences.step = {{NAN, NAN, NAN}};
}

void add_frame(const AttitudeAt &before, const AttitudeAt &predicted, const AttitudeAt &corrected,
               const Vector3 &turn, const Matrix3 &R, StampJitter &jitter) {
    ++jitter.frames;
    const Vector3 &now = corrected.rate_rad_s;
    const double normal = 1 - std::pow(MEMORY, jitter.frames);
    Vector3 mean;
    for (int i = 0; i < 3; ++i) {
        jitter.rate_rad_s[i] = MEMORY * jitter.rate_rad_s[i] + (1 - MEMORY) * now[i];
        mean[i] = jitter.rate_rad_s[i] / normal;
    }
    const double interval_s = static_cast<double>(corrected.stamp_ns - before.stamp_ns) * 1e-9;
    const Matrix3 R_inverse = inverse(R);
    const bool expected = jitter.frames > DOUBT_FRAMES && !is_zero(jitter.turn_rad);
    if (!add_difference(before, predicted, corrected, turn, R_inverse,
                        interval_s / jitter.interval_s, jitter.differences)) {
        interrupt_jitter(jitter);
        return;
    }
    jitter.interval_s = interval_s;
    const double variance_s2 = jitter.differences.variances_s2[COMPARED_FRAMES - 1];
    // A few times that happen to agree do not end what many have shown.
    const double estimated_s2 = most(stamp_variance(jitter.differences, expected),
                                     FADES * jitter.sigma_s * jitter.sigma_s);
    jitter.sigma_s = estimated_s2 > variance_s2 ? std::sqrt(estimated_s2) : 0.0;
    const Vector3 along = R_inverse * now;
    const double speed2 = dot(along, now);
    if (speed2 != 0) {
        add_recent(along, turn, speed2, jitter);
    }
    const double most_s = most_by_recent(jitter);
    jitter.sigma_s = least(jitter.sigma_s, most_s);
    const double sigma_s = least(most(jitter.sigma_s, doubt(jitter)), most_s);
    jitter.turn_rad = scaled(norm(now) > norm(mean) ? now : mean, sigma_s);
}

}  // namespace st
