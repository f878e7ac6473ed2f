// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/streak_fit.h"

#include <cmath>

#include "centroid/normal_equations.h"

namespace st {
namespace {

constexpr double REACH_SIGMAS = 3.5;  // of the pixels that are fitted, from the line
constexpr double REACH_PX = 1.0;
constexpr int SLOPE_PX = 8;  // reach over which the slope of the background is taken
constexpr double CONVERGED_STREAK_PX = 1e-3;
constexpr double MOST_STEP_PX = 0.7;
constexpr double MOST_STEP_SHARE = 0.15;  // of the length
constexpr double MOST_ANGLE_STEP = 0.1;
constexpr double LEAST_SIGMA_PX = 0.2, MOST_SIGMA_PX = 8.0;
constexpr double LEAST_FLUX_DN = 1e-3;
constexpr double OUTLIER_SIGMAS = 5.0;  // a brighter pixel was hit by a particle,
constexpr double OUTLIER_SHARE = 0.5;   // if it also exceeds the model by this share of the peak
constexpr double SQRT_HALF = 0.70710678118654752440;
constexpr double DENSITY = 0.39894228040143267794;  // 1 / sqrt(2 pi)

double greater_of(double a, double b) {
    return a > b ? a : b;
}

double limited(double value, double most) {
    value = value < -most ? -most : value;
    return value > most ? most : value;
}

/// The pixels top .. bottom - 1, left .. right - 1.
struct Box {
    int top, bottom, left, right;
};

/// Return a whole number within 0 .. most; 0 for NaN.
int index_within(double value, int most) {
    return value > 0 ? value < most ? static_cast<int>(value) : most : 0;
}

/// Return the pixels within reach of a streak; none where it is not finite.
Box box_of(const StreakStar &star, double reach, const Image &image) {
    const double half = star[LENGTH] / 2;
    const double across = half * std::fabs(std::cos(star[ANGLE])) + reach;
    const double down = half * std::fabs(std::sin(star[ANGLE])) + reach;
    return {index_within(std::ceil(star[V] - down), image.height),
            index_within(std::floor(star[V] + down) + 1, image.height),
            index_within(std::ceil(star[U] - across), image.width),
            index_within(std::floor(star[U] + across) + 1, image.width)};
}

double width_of(double sigma) {
    return std::sqrt(sigma * sigma + 1.0 / 12);
}

/// Whether the flux of one streak may reach the pixels of another.
bool may_reach(const StreakStar &one, const StreakStar &other) {
    const double reach = (one[LENGTH] + other[LENGTH]) / 2 +
                         2 * (REACH_SIGMAS * greater_of(one[SIGMA], other[SIGMA]) + REACH_PX);
    const double u = one[U] - other[U], v = one[V] - other[V];
    return u * u + v * v < reach * reach;
}

/// Fill N and g of streak i and its chi-square and degrees of freedom; others (count) are streaks
/// whose flux may be among its pixels.
template <int P>
void normal_equations(const StreakPixels &pixels, int i, const StreakShape *others, int count,
                      const NoiseModel &noise, bool clip, StreakFit<P> &fit, Vector<P> &g) {
    const StreakShape shape(fit.star);
    const double width = shape.width(), half = shape.length() / 2;
    const double reach = REACH_SIGMAS * width + REACH_PX;
    const Box box = box_of(fit.star, reach, pixels.image);
    const double peak = shape.flux() * DENSITY / width / greater_of(shape.length(), 2 * width);
    const double background = pixels.sky[i].variance, level = fit.star[LEVEL];
    Matrix<P, P> &N = fit.covariance;
    Vector<P> row;
    N = {};
    g = {};
    double chi2 = 0.0;
    int used = 0;
    for (int y = box.top; y < box.bottom; ++y) {
        for (int x = box.left; x < box.right; ++x) {
            const double a = shape.along(x, y), b = shape.across(x, y);
            if (std::fabs(b) > reach || std::fabs(a) > half + reach ||
                pixels.image.at(x, y) >= pixels.full_scale_dn) {
                continue;
            }
            const double model = shape.derivatives(a, b, row);
            double of_others = 0.0;
            for (int j = 0; j < count; ++j) {
                of_others += others[j].flux() * others[j].share_at(x, y);
            }
            const double residual = pixels.above(i, x, y) - of_others - level - model;
            const double variance = pixel_variance(noise, background, model + of_others);
            if (clip && residual > OUTLIER_SHARE * peak &&
                residual * residual > OUTLIER_SIGMAS * OUTLIER_SIGMAS * variance) {
                continue;
            }
            const double weight = 1 / variance;
            for (int p = 0; p < P; ++p) {
                const double weighted = row[p] * weight;
                g[p] += weighted * residual;
                for (int q = p; q < P; ++q) {
                    N[p][q] += weighted * row[q];
                }
            }
            chi2 += residual * residual * weight;
            ++used;
        }
    }
    Equations<P>::make_regular(N);
    fit.chi2 = chi2;
    fit.dof = used > P ? used - P : 0;
}

/// Move a streak by the limited step N^-1 g; return the length of the step in px.
template <int P>
double move_streak(StreakStar &star, const Matrix<P, P> &covariance, const Vector<P> &g) {
    const double most = greater_of(MOST_STEP_PX, MOST_STEP_SHARE * star[LENGTH]);
    double longest = 0.0;
    for (int p = 0; p < P; ++p) {
        double step = 0.0;
        for (int q = 0; q < P; ++q) {
            step += covariance[p][q] * g[q];
        }
        if (p == ANGLE) {
            step = limited(step, MOST_ANGLE_STEP);
        } else if (p != FLUX && p != LEVEL) {
            step = limited(step, most);
            longest = greater_of(std::fabs(step), longest);
        }
        star[p] += step;
    }
    star[FLUX] = star[FLUX] < LEAST_FLUX_DN ? LEAST_FLUX_DN : star[FLUX];
    star[SIGMA] = star[SIGMA] < LEAST_SIGMA_PX ? LEAST_SIGMA_PX : star[SIGMA];
    star[SIGMA] = star[SIGMA] > MOST_SIGMA_PX ? MOST_SIGMA_PX : star[SIGMA];
    star[LENGTH] = star[LENGTH] < LEAST_LENGTH_PX ? LEAST_LENGTH_PX : star[LENGTH];
    return longest;
}

}  // namespace

StreakShape::StreakShape(const StreakStar &star)
    : u_(star[U]),
      v_(star[V]),
      flux_(star[FLUX]),
      sigma_(star[SIGMA]),
      length_(star[LENGTH]),
      c_(std::cos(star[ANGLE])),
      s_(std::sin(star[ANGLE])),
      width_(width_of(star[SIGMA])) {}

double StreakShape::share_at(double x, double y) const {
    const double a = along(x, y), b = across(x, y), half = length_ / 2;
    if (std::fabs(b) > 6 * width_ || std::fabs(a) > half + 6 * width_) {
        return 0.0;
    }
    const double z = b / width_;
    return DENSITY / width_ * std::exp(-0.5 * (z * z)) *
           (0.5 *
            (std::erf((a + half) / width_ * SQRT_HALF) -
             std::erf((a - half) / width_ * SQRT_HALF)) /
            length_);
}

template <int P>
double StreakShape::derivatives(double a, double b, Vector<P> &row) const {
    const double z1 = (a + length_ / 2) / width_, z2 = (a - length_ / 2) / width_;
    const double phi1 = DENSITY * std::exp(-0.5 * z1 * z1);
    const double phi2 = DENSITY * std::exp(-0.5 * z2 * z2);
    const double h = 0.5 * (std::erf(z1 * SQRT_HALF) - std::erf(z2 * SQRT_HALF)) / length_;
    const double z = b / width_, g = DENSITY / width_ * std::exp(-0.5 * (z * z));
    const double h_a = (phi1 - phi2) / (width_ * length_), g_b = -b / (width_ * width_) * g;
    row[U] = flux_ * (s_ * g_b * h - c_ * h_a * g);
    row[V] = flux_ * (-c_ * g_b * h - s_ * h_a * g);
    row[FLUX] = g * h;
    row[LEVEL] = 1.0;
    if constexpr (P > LEVEL + 1) {
        row[LENGTH] = flux_ * g * ((phi1 + phi2) / (2 * width_) - h) / length_;
        row[ANGLE] = flux_ * (h_a * b * g - g_b * a * h);
        row[SIGMA] = flux_ * sigma_ / width_ *
                     (h * g * (b * b / (width_ * width_) - 1) / width_ -
                      g * (z1 * phi1 - z2 * phi2) / (width_ * length_));
    }
    return flux_ * g * h;
}

Sky sky_at(const Mesh &mesh, Place place, double variance) {
    const int u = static_cast<int>(std::rint(place.u)), v = static_cast<int>(std::rint(place.v));
    const Slope slope = slope_at(mesh, u, v, SLOPE_PX);
    return {background_at(mesh, u, v).level - slope.across * u - slope.down * v, slope.across,
            slope.down, variance};
}

StreakStar streak_at(Place place, Place streak_px, double sigma_px) {
    const double length = std::hypot(streak_px.u, streak_px.v);
    return {{place.u, place.v, 0.0, 0.0, sigma_px, greater_of(length, LEAST_LENGTH_PX),
             std::atan2(streak_px.v, streak_px.u)}};
}

template <int P>
void fit_streaks(const StreakPixels &pixels, StreakFit<P> *fit, int count, const NoiseModel &noise,
                 int iterations, Arena &arena) {
    const Arena::Scope scope(arena);
    const auto n = static_cast<size_t>(count);
    // What may reach what is that of the start.
    StreakStar *start = arena.take<StreakStar>(n);
    StreakShape *others = arena.take<StreakShape>(n);
    bool *converged = arena.take<bool>(n);
    for (int i = 0; i < count; ++i) {
        start[i] = fit[i].star;
        converged[i] = false;
    }
    Vector<P> g;
    for (int k = 0; k <= iterations; ++k) {
        for (int i = 0; i < count; ++i) {
            if (converged[i] && k < iterations) {
                continue;
            }
            int near = 0;
            for (int j = 0; j < count; ++j) {
                if (j != i && may_reach(start[i], start[j])) {
                    others[near++] = StreakShape(fit[j].star);
                }
            }
            normal_equations(pixels, i, others, near, noise, k > 1, fit[i], g);
            invert(fit[i].covariance);
            if (k < iterations) {
                converged[i] =
                    move_streak(fit[i].star, fit[i].covariance, g) < CONVERGED_STREAK_PX;
            }
        }
    }
}

template void fit_streaks(const StreakPixels &, StreakFit<4> *, int, const NoiseModel &, int,
                          Arena &);
template void fit_streaks(const StreakPixels &, StreakFit<7> *, int, const NoiseModel &, int,
                          Arena &);

size_t streak_fit_bytes(int count) {
    const auto n = static_cast<size_t>(count);
    return Arena::padded<StreakStar>(n) + Arena::padded<StreakShape>(n) + Arena::padded<bool>(n);
}

double flux_at(const StreakPixels &pixels, int i, const StreakStar &star) {
    const StreakShape shape(star);
    const Box box = box_of(star, REACH_SIGMAS * star[SIGMA] + REACH_PX, pixels.image);
    double n = 0.0, m = 0.0, mm = 0.0, d = 0.0, md = 0.0;
    for (int y = box.top; y < box.bottom; ++y) {
        for (int x = box.left; x < box.right; ++x) {
            const double share = shape.share_at(x, y), value = pixels.above(i, x, y);
            n += 1;
            m += share;
            mm += share * share;
            d += value;
            md += share * value;
        }
    }
    return greater_of((n * md - m * d) / greater_of(n * mm - m * m, 1e-12), LEAST_FLUX_DN);
}

double photon_gain(const StreakPixels &pixels, const StreakFit<4> *fit, int count,
                   const NoiseModel &noise) {
    double above = 0.0, total = 0.0;
    Vector<4> row;
    for (int i = 0; i < count; ++i) {
        const StreakStar &star = fit[i].star;
        const StreakShape shape(star);
        const double background = pixels.sky[i].variance;
        const Box box = box_of(star, shape.width(), pixels.image);
        for (int y = box.top; y < box.bottom; ++y) {
            for (int x = box.left; x < box.right; ++x) {
                if (!(pixels.image.at(x, y) < pixels.full_scale_dn)) {
                    continue;
                }
                const double model = shape.derivatives(shape.along(x, y), shape.across(x, y), row);
                const double variance = pixel_variance(noise, background, model);
                const double residual = pixels.above(i, x, y) - star[LEVEL] - model;
                const double most = OUTLIER_SIGMAS * OUTLIER_SIGMAS * variance;
                const double square = residual * residual < most ? residual * residual : most;
                const double weight = model / (variance * variance);
                above += weight * (square - background);
                total += weight * model;
            }
        }
    }
    return total > 0 ? greater_of(above / total, noise.gain_dn) : noise.gain_dn;
}

}  // namespace st
