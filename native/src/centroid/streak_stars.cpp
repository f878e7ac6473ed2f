// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/streak_stars.h"

#include <cmath>

#include "centroid/misfit.h"
#include "centroid/point_stars.h"
#include "centroid/streak_fit.h"

namespace st {
namespace {

constexpr int ROUGH_ITERATIONS = 6, FINAL_ITERATIONS = 8;
constexpr int LEAST_PIXELS = 12;  // degrees of freedom of a fit

/// Return the background at a place, with its variance.
Sky sky_of(const Frame &frame, Place place) {
    const int u = static_cast<int>(std::rint(place.u)), v = static_cast<int>(std::rint(place.v));
    const double noise = background_at(frame.mesh, u, v).noise / frame.kernel.noise_gain;
    return sky_at(frame.mesh, place, noise * noise);
}

/// Whether a streak does not end within the image.
bool is_beyond_edge(const Image &image, Place place, Place streak_px, double sigma_px) {
    const double border = std::ceil(EDGE_SIGMAS * sigma_px);
    const double across = border + std::fabs(streak_px.u) / 2;
    const double down = border + std::fabs(streak_px.v) / 2;
    return place.u < across || place.v < down || place.u > image.width - 1 - across ||
           place.v > image.height - 1 - down;
}

bool is_finite(const StreakStar &star) {
    bool finite = true;
    for (const double one : star.element) {
        finite &= std::isfinite(one);
    }
    return finite;
}

/// The fits of an image, count of them, with the place where each started.
struct Fits {
    StreakFit<4> *fit;
    Place *start;
    Sky *sky;
    int count;

    Place place(int i) const { return {fit[i].star[U], fit[i].star[V]}; }
};

/// Whether streak i lies upon a brighter one.
bool is_duplicate(const Fits &fits, int i) {
    const StreakStar &star = fits.fit[i].star;
    for (int j = 0; j < fits.count; ++j) {
        const StreakStar &other = fits.fit[j].star;
        if (!(other[FLUX] > star[FLUX])) {
            continue;
        }
        // The direction is that of the other streak.
        const double u = star[U] - other[U], v = star[V] - other[V];
        const double c = std::cos(other[ANGLE]), s = std::sin(other[ANGLE]);
        if (std::fabs(u * c + v * s) < 0.5 * other[LENGTH] + other[SIGMA] &&
            std::fabs(v * c - u * s) < other[SIGMA]) {
            return true;
        }
    }
    return false;
}

/// Return why fit i is not a streak of a star; ST_REJECTED_COUNT if it is one.
st_rejection kind_of(const Fits &fits, int i, double threshold_sigmas) {
    const StreakFit<4> &fit = fits.fit[i];
    const StreakStar &star = fit.star;
    const double distance = std::hypot(star[U] - fits.start[i].u, star[V] - fits.start[i].v);
    const double variance = fit.covariance[FLUX][FLUX];
    if (!is_finite(star) || fit.dof < LEAST_PIXELS ||
        !(distance < star[LENGTH] / 2 + 3 * star[SIGMA]) || is_duplicate(fits, i)) {
        return ST_REJECTED_NOT_FITTED;
    }
    if (!(star[FLUX] / std::sqrt(variance) >= FAINT * threshold_sigmas)) {
        return ST_REJECTED_FAINT;
    }
    return misfit(fit.chi2, fit.dof, star[FLUX], variance) > MOST_MISFIT ? ST_REJECTED_NOT_STREAKED
                                                                         : ST_REJECTED_COUNT;
}

/// Leave out what is not a streak of a star. All are judged before the first is left out.
void reject(Fits &fits, double threshold_sigmas, Rejections &rejections, Arena &arena) {
    const Arena::Scope scope(arena);
    auto *kind = arena.take<st_rejection>(static_cast<size_t>(fits.count));
    for (int i = 0; i < fits.count; ++i) {
        kind[i] = kind_of(fits, i, threshold_sigmas);
    }
    constexpr st_rejection kinds[] = {ST_REJECTED_NOT_FITTED, ST_REJECTED_FAINT,
                                      ST_REJECTED_NOT_STREAKED};
    for (const st_rejection one : kinds) {
        for (int i = 0; i < fits.count; ++i) {
            if (kind[i] == one) {
                rejections.add(one, fits.place(i).u, fits.place(i).v);
            }
        }
    }
    int kept = 0;
    for (int i = 0; i < fits.count; ++i) {
        if (kind[i] == ST_REJECTED_COUNT) {
            fits.fit[kept] = fits.fit[i];
            fits.start[kept++] = fits.start[i];
        }
    }
    fits.count = kept;
}

st_centroid centroid_of(const StreakFit<4> &fit) {
    const double factor = inflation(fit.chi2, fit.dof), square = factor * factor;
    const double uu = square * fit.covariance[U][U], uv = square * fit.covariance[U][V];
    const double vv = square * fit.covariance[V][V], flux = fit.star[FLUX];
    return {fit.star[U],
            fit.star[V],
            flux,
            flux / std::sqrt(fit.covariance[FLUX][FLUX]) / factor,
            std::sqrt((uu + vv) / 2),
            uu,
            uv,
            vv,
            0.0,
            0.0,
            0.0,
            0.0};
}

}  // namespace

void measure_streaks(const Frame &frame, const Place *places, int count, const Streak &streak,
                     double sigma_px, double threshold_sigmas, List<st_centroid> &stars,
                     Rejections &rejections, Arena &arena) {
    const Arena::Scope scope(arena);
    const auto n = static_cast<size_t>(count);
    Fits fits{arena.take<StreakFit<4>>(n), arena.take<Place>(n), arena.take<Sky>(n), 0};
    const StreakPixels pixels{frame.image, frame.full_scale_dn, fits.sky};
    for (int k = 0; k < count; ++k) {
        const Place moved = streak.at(places[k]);
        if (is_beyond_edge(frame.image, places[k], moved, sigma_px)) {
            rejections.add(ST_REJECTED_EDGE, places[k].u, places[k].v);
            continue;
        }
        const int i = fits.count++;
        StreakStar &star = fits.fit[i].star;
        fits.start[i] = places[k];
        fits.sky[i] = sky_of(frame, places[k]);
        star = streak_at(places[k], moved, sigma_px);
        star[FLUX] = flux_at(pixels, i, star);
    }
    NoiseModel noise =
        initial_noise_model(frame.background_dn(), frame.noise_dn() * frame.noise_dn());
    fit_streaks(pixels, fits.fit, fits.count, noise, ROUGH_ITERATIONS, arena);
    reject(fits, threshold_sigmas, rejections, arena);
    for (int i = 0; i < fits.count; ++i) {
        fits.sky[i] = sky_of(frame, fits.place(i));
    }
    noise = {photon_gain(pixels, fits.fit, fits.count, noise)};
    fit_streaks(pixels, fits.fit, fits.count, noise, FINAL_ITERATIONS, arena);
    reject(fits, threshold_sigmas, rejections, arena);
    for (int i = 0; i < fits.count; ++i) {
        stars.add(centroid_of(fits.fit[i]));
    }
}

size_t streak_stars_bytes(int count) {
    const auto n = static_cast<size_t>(count);
    return Arena::padded<StreakFit<4>>(n) + Arena::padded<Place>(n) + Arena::padded<Sky>(n) +
           Arena::padded<st_rejection>(n) + streak_fit_bytes(count);
}

}  // namespace st
