// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/shape.h"

#include <cmath>

namespace st {
namespace {

constexpr double WIDTH_RATIO = 2.0;  // of the alternative hypotheses: half as wide, twice as wide
constexpr double MARGIN = 9.0;       // of chi-square, by which another sigma must be better
constexpr double MOST_ELONGATION = 0.4;
constexpr double COMMON_ELONGATION = 0.08;  // of all spots together,
constexpr double COMMON_SIGMAS = 4.0;       // if it is so significant

/// Return chi-square of a star `ratio` times as wide at the same position, flux and level free.
///
/// With the profile s = a(x) d(y), the data D and sums over pixels with weights w, it is
///
///     sum w D^2 - (sum w D)^2 / W - (sum w s D - sum w s sum w D / W)^2
///                                   / (sum w s^2 - (sum w s)^2 / W),  W = sum w
double chi2_of_width(const Star &star, double ratio, FitWork &work) {
    const Window &window = work.window;
    profile(star[U], star[SIGMA] * ratio, window.left, window.filled, work.other_columns);
    profile(star[V], star[SIGMA] * ratio, window.top, window.count, work.other_rows);
    Lanes total{}, s{}, d{}, ss{}, sd{}, dd{};
    for (int y = 0; y < window.count; ++y) {
        const float of_row = work.other_rows.share[y];
        for (int x = 0; x < window.filled; x += LANES) {
            const int k = y * window.filled + x;
            const Lanes share = of_row * load(work.other_columns.share + x);
            const Lanes weight = load(work.weight + k), own = load(work.own + k);
            const Lanes ws = weight * share, wd = weight * own;
            total += weight;
            s += ws;
            d += wd;
            ss += ws * share;
            sd += ws * own;
            dd += wd * own;
        }
    }
    const double sum_w = static_cast<double>(sum(total)), sum_s = static_cast<double>(sum(s));
    const double sum_d = static_cast<double>(sum(d)), sum_ss = static_cast<double>(sum(ss));
    const double sum_sd = static_cast<double>(sum(sd)), sum_dd = static_cast<double>(sum(dd));
    const double common = sum_sd - sum_s * sum_d / sum_w;
    return sum_dd - sum_d * sum_d / sum_w - common * common / (sum_ss - sum_s * sum_s / sum_w);
}

}  // namespace

Width test_width(const Star &star, double chi2, FitWork &work) {
    const double limit = chi2 - MARGIN;
    return {chi2_of_width(star, 1 / WIDTH_RATIO, work) < limit,
            chi2_of_width(star, WIDTH_RATIO, work) < limit};
}

SpotMoments spot_moments(const Star &star, const FitWork &work) {
    const Window &window = work.window;
    const double per_width = 1 / (8 * star[SIGMA] * star[SIGMA]);
    float down[MOST_SIDE_PX], weight_of_row[MOST_SIDE_PX];
    for (int k = 0; k < window.count; ++k) {
        const double y = window.top + k - star[V];
        down[k] = static_cast<float>(y);
        weight_of_row[k] = static_cast<float>(std::exp(-y * y * per_width));
    }
    Lanes straight{}, oblique{}, size{}, variance{};
    for (int m = 0; m < window.filled; m += LANES) {
        // The sums over y of each column: of D, of the size and of the variance.
        Lanes m_0{}, m_y{}, m_yy{}, size_0{}, size_yy{}, var_0{}, var_yy{}, var_yyyy{};
        for (int k = 0; k < window.count; ++k) {
            const int at = k * window.filled + m;
            const Lanes weight = load(work.weight + at), model = load(work.model + at);
            Lanes own = load(work.own + at);
            const float y = down[k], yy = y * y;
            const Lanes used = weight > 0.0F ? all_of(weight_of_row[k]) : Lanes{};
            const Lanes of_variance = weight > 0.0F ? used * used / weight : Lanes{};
            const Lanes of_size = used * greater(own, model);
            own *= used;
            m_0 += own;
            m_y += own * y;
            m_yy += own * yy;
            size_0 += of_size;
            size_yy += of_size * yy;
            var_0 += of_variance;
            var_yy += of_variance * yy;
            var_yyyy += of_variance * yy * yy;
        }
        Lanes x, g;
        for (int lane = 0; lane < LANES; ++lane) {
            const double across = window.left + m + lane - star[U];
            x[lane] = static_cast<float>(across);
            g[lane] = static_cast<float>(std::exp(-across * across * per_width));
        }
        const Lanes xx = x * x;
        straight += g * (xx * m_0 - m_yy);
        oblique += g * x * m_y;
        size += g * (xx * size_0 + size_yy);
        variance += g * g * (xx * (xx * var_0 + var_yy + var_yy) + var_yyyy);
    }
    return {static_cast<double>(sum(straight)), static_cast<double>(2 * sum(oblique)),
            static_cast<double>(sum(size)), static_cast<double>(sum(variance) / 2)};
}

bool is_elongated(const SpotMoments &moments) {
    return std::hypot(moments.straight, moments.oblique) >
           MOST_ELONGATION * moments.size + 3 * std::sqrt(moments.variance);
}

void Smear::add(const SpotMoments &moments) {
    if (moments.size > 0) {
        const double weight = 1 / (moments.size + std::sqrt(moments.variance));
        straight_ += weight * moments.straight;
        oblique_ += weight * moments.oblique;
        size_ += weight * moments.size;
        variance_ += weight * weight * moments.variance;
    }
}

bool Smear::is_one() const {
    const double length = std::hypot(straight_, oblique_);
    return length > COMMON_SIGMAS * std::sqrt(variance_) && length > COMMON_ELONGATION * size_;
}

}  // namespace st
