// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/noise_fit.h"

#include <cmath>

namespace st {
namespace {

constexpr double PRIOR_PIXELS = 10.0;  // weight of the initial gain
constexpr float OUTLIER = 16.0F;       // variances, to which a squared residual is limited
constexpr float LEAST_FREE = 0.1F;     // share of a pixel's noise that its residual shows at least

/// Whether a term x of the first unknown or y of the second alone explains more.
NoiseModel one_of(double a, double x, double c, double y) {
    return a * x * x >= c * y * y ? NoiseModel{x, 0.0} : NoiseModel{0.0, std::sqrt(y)};
}

}  // namespace

NoiseFit::NoiseFit(int count, int area_px, Arena &arena)
    : area_(area_px),
      capacity_(count < MOST_NOISE_PIXELS / area_px ? count : MOST_NOISE_PIXELS / area_px),
      star_(arena.take<KeptStar>(static_cast<size_t>(capacity_))),
      square_(arena.take<float>(static_cast<size_t>(capacity_) * static_cast<size_t>(area_px))),
      flux_(arena.take<float>(static_cast<size_t>(capacity_) * static_cast<size_t>(area_px))) {}

void NoiseFit::add(int i, const Fit<4> &fit, const FitWork &work) {
    if (stars_ == capacity_) {
        return;
    }
    const Window &window = work.window;
    const Star &star = fit.star;
    const Matrix<4, 4> &C = fit.covariance;
    const ptrdiff_t first = static_cast<ptrdiff_t>(stars_) * area_;
    float *square = square_ + first, *flux = flux_ + first;
    star_[stars_++] = {i, static_cast<float>(window.variance)};
    for (int y = 0; y < window.count; ++y) {
        // h = w J C J^T is the share of a pixel's noise that the fit absorbs, J = (F d a_u, F d_v a,
        // d a, 1): a quadratic form in a_u, a and 1, with coefficients of the row.
        const double d = static_cast<double>(work.rows.share[y]);
        const double fd = star[FLUX] * d;
        const double fdv = star[FLUX] * static_cast<double>(work.rows.d_centre[y]);
        const auto c_uu = static_cast<float>(fd * fd * C[U][U]);
        const auto c_ua = static_cast<float>(2 * fd * (fdv * C[U][V] + d * C[U][FLUX]));
        const auto c_aa = static_cast<float>(fdv * fdv * C[V][V] + 2 * fdv * d * C[V][FLUX] +
                                             d * d * C[FLUX][FLUX]);
        const auto c_u1 = static_cast<float>(2 * fd * C[U][LEVEL]);
        const auto c_11 = static_cast<float>(C[LEVEL][LEVEL]);
        const auto c_a1 = static_cast<float>(2 * (fdv * C[V][LEVEL] + d * C[FLUX][LEVEL]));
        for (int x = 0; x < window.filled; x += LANES) {
            const int k = y * window.filled + x;
            const Lanes a = load(work.columns.share + x), a_u = load(work.columns.d_centre + x);
            const Lanes h = (a_u * (c_uu * a_u + c_ua * a + c_u1) + a * (c_aa * a + c_a1) + c_11) *
                            load(work.weight + k);
            const Lanes model = load(work.model + k), residual = load(work.own + k) - model;
            store(square + k, residual * residual / greater(1.0F - h, all_of(LEAST_FREE)));
            store(flux + k, model * load(window.used + k));
        }
    }
}

NoiseFit::Sums NoiseFit::prior_sums(double gain_dn) {
    return {PRIOR_PIXELS / (gain_dn * gain_dn), 0.0, 0.0, PRIOR_PIXELS / gain_dn, 0.0};
}

void NoiseFit::add_sums(int one, const NoiseModel &noise, Sums &sums) const {
    const auto gain = static_cast<float>(noise.gain_dn);
    const auto error = static_cast<float>(noise.model_error * noise.model_error);
    const float background = star_[one].background;
    Lanes a{}, b{}, c{}, p{}, q{};
    for (int k = one * area_; k < (one + 1) * area_; k += LANES) {
        const Lanes flux = load(flux_ + k), square = load(square_ + k);
        const Lanes variance = background + flux * (gain + error * flux);
        const Lanes limit = OUTLIER * variance, weight = 1.0F / variance;
        const Lanes excess = ((square < limit ? square : limit) - background) * weight;
        const Lanes d_gain = flux * weight, d_error = flux * d_gain;
        a += d_gain * d_gain;
        b += d_gain * d_error;
        c += d_error * d_error;
        p += d_gain * excess;
        q += d_error * excess;
    }
    sums.a += static_cast<double>(sum(a));
    sums.b += static_cast<double>(sum(b));
    sums.c += static_cast<double>(sum(c));
    sums.p += static_cast<double>(sum(p));
    sums.q += static_cast<double>(sum(q));
}

/// Return x and sqrt(y) that solve [a b; b c] [x y] = [p q] best with x, y >= 0.
NoiseModel NoiseFit::solved(const Sums &sums) {
    const auto [a, b, c, p, q] = sums;
    const double determinant = a * c - b * b;
    if (determinant > 0) {
        const double x = (c * p - b * q) / determinant, y = (a * q - b * p) / determinant;
        if (x >= 0 && y >= 0) {
            return {x, std::sqrt(y)};
        }
    }
    return one_of(a, (p > 0 ? p : 0.0) / a, c, c > 0 ? (q > 0 ? q : 0.0) / c : 0.0);
}

}  // namespace st
