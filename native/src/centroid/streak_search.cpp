// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/streak_search.h"

#include <cmath>

#include "centroid/blur.h"
#include "centroid/connected.h"
#include "centroid/misfit.h"
#include "centroid/streak_filter.h"
#include "centroid/streak_fit.h"
#include "maths/sorting.h"

namespace st {
namespace {

constexpr double SMOOTHING_PX = 1.5;  // before the threshold
constexpr double SPOT_SIGMAS = 4.0;
constexpr int LEAST_SPOT_PX = 8;
constexpr int MOST_SPOTS = 60;       // the brightest
constexpr int MOST_NUMBERS = 16384;  // of spots; more are noise
constexpr double SHORTEST_SPOT_PX = 1.5;
constexpr double LENGTH_SHARE = 0.3, LENGTH_PX = 2.0;  // by which two streaks may differ
constexpr int LEAST_AGREEING = 4;
constexpr double AGREEING_SHARE = 0.3;  // of the flux of all spots
constexpr int FITTED = 12;              // spots, the brightest that agree
constexpr int FIT_ITERATIONS = 12;
constexpr double MOST_LENGTH_ERROR = 0.3;  // of a fit, relative
constexpr double SIGMA_FLOOR_PX = 0.05;

// --- the streak on which spots agree ---

/// A bright spot: its streak px by its moments.
struct Spot {
    Place place, streak;
    double flux;
};

struct Spots {
    Spot spot[MOST_SPOTS];
    int count = 0;
};

/// Sums over the pixels of a spot, of the weight times 1, u, v, u^2, u v, v^2; and their box.
struct Sums {
    double m[6];
    Box box;
};

/// Reverse the streaks against the direction of most; at(i) is a streak.
template <class At>
void into_half_plane(int count, At at) {
    double sine = 0.0, cosine = 0.0;
    for (int i = 0; i < count; ++i) {
        const double length = std::hypot(at(i).u, at(i).v),
                     angle = 2 * std::atan2(at(i).v, at(i).u);
        sine += length * std::sin(angle);
        cosine += length * std::cos(angle);
    }
    const double axis = std::atan2(sine, cosine) / 2, c = std::cos(axis), s = std::sin(axis);
    for (int i = 0; i < count; ++i) {
        if (at(i).u * c + at(i).v * s < 0) {
            at(i) = {-at(i).u, -at(i).v};
        }
    }
}

/// Return a spot by its sums. The eigenvalues of the moments differ by L^2 / 12, along and across.
Spot spot_of(const Sums &sums) {
    const double *m = sums.m;
    const double u = m[1] / m[0], v = m[2] / m[0];
    const double uu = m[3] / m[0] - u * u, vv = m[5] / m[0] - v * v, uv = m[4] / m[0] - u * v;
    const double difference = std::hypot(uu - vv, 2 * uv);
    const double angle = std::atan2(2 * uv, uu - vv) / 2, length = std::sqrt(12 * difference);
    return {{u, v}, {length * std::cos(angle), length * std::sin(angle)}, m[0]};
}

Sums *spot_sums(const Plane<float> &smooth, const Connected &spots, int count, Arena &arena) {
    auto *sums = arena.take<Sums>(static_cast<size_t>(count));
    for (int k = 0; k < count; ++k) {
        sums[k] = {};
    }
    for (int v = 0; v < smooth.height; ++v) {
        for (const Run &run : spots.row(v)) {
            Sums &of = sums[run.spot - 1];
            for (int u = run.first; u <= run.last; ++u) {
                const double weight = static_cast<double>(smooth.at(u, v)), x = u, y = v;
                const double power[6] = {1.0, x, y, x * x, x * y, y * y};
                for (int k = 0; k < 6; ++k) {
                    of.m[k] += weight * power[k];
                }
            }
            of.box.add(run, v);
        }
    }
    return sums;
}

/// Return the brightest spots of the thresholded image that do not touch its border.
Spots bright_spots(const Frame &frame, Arena &arena) {
    const Arena::Scope scope(arena);
    const int width = frame.image.width, height = frame.image.height;
    const auto size = static_cast<size_t>(width) * static_cast<size_t>(height);
    const Plane<float> smooth{arena.take<float>(size), width, height};
    Connected connected(width, height, arena);
    auto *limit = arena.take<float>(static_cast<size_t>(width));
    Spots spots;
    subtract_level(frame.image, frame.mesh, smooth, arena);
    blur(smooth, SMOOTHING_PX, arena);
    const double noise = frame.noise_dn() / (2 * std::sqrt(M_PI) * SMOOTHING_PX);
    for (int u = 0; u < width; ++u) {
        limit[u] = static_cast<float>(SPOT_SIGMAS * noise);
    }
    for (int v = 0; v < height; ++v) {
        connected.add_row(smooth.row(v), limit);
    }
    const int count = connected.number();
    if (count > MOST_NUMBERS) {
        return spots;
    }
    const Sums *sums = spot_sums(smooth, connected, count, arena);
    int *order = arena.take<int>(static_cast<size_t>(count));
    int *work = arena.take<int>(static_cast<size_t>(count)), inside = 0;
    for (int k = 0; k < count; ++k) {
        const Box &box = sums[k].box;
        if (box.left > 0 && box.top > 0 && box.right < width - 1 && box.bottom < height - 1 &&
            box.pixels >= LEAST_SPOT_PX) {
            order[inside++] = k;
        }
    }
    sort(order, inside, work, [sums](int a, int b) { return sums[a].m[0] > sums[b].m[0]; });
    for (; spots.count < inside && spots.count < MOST_SPOTS; ++spots.count) {
        spots.spot[spots.count] = spot_of(sums[order[spots.count]]);
    }
    into_half_plane(spots.count, [&spots](int i) -> Place & { return spots.spot[i].streak; });
    return spots;
}

/// Whether another spot has the streak of one, or its opposite.
bool agree(const Spot &one, const Spot &other) {
    const double length = std::hypot(one.streak.u, one.streak.v);
    const double same = std::hypot(one.streak.u - other.streak.u, one.streak.v - other.streak.v);
    const double opposite =
        std::hypot(one.streak.u + other.streak.u, one.streak.v + other.streak.v);
    return std::fmin(same, opposite) < std::fmax(LENGTH_PX, LENGTH_SHARE * length) &&
           length > SHORTEST_SPOT_PX;
}

/// Return the spot with which the brightest group of equal streaks agrees, -1 if that is small. The
/// groups are compared by flux: a long faint streak falls into short pieces, which may be more.
int most_agreed(const Spots &spots) {
    double all = 0.0, most = -1.0;
    int best = -1;
    for (int i = 0; i < spots.count; ++i) {
        double flux = 0.0;
        int agreeing = 0;
        all += spots.spot[i].flux;
        for (int j = 0; j < spots.count; ++j) {
            if (agree(spots.spot[i], spots.spot[j])) {
                flux += spots.spot[j].flux;
                ++agreeing;
            }
        }
        if (agreeing >= LEAST_AGREEING && flux > most) {
            most = flux;
            best = i;
        }
    }
    return most < AGREEING_SHARE * all ? -1 : best;
}

// --- peaks of the filtered image ---

struct FluxPeak {
    float flux;
    int u, v;
};

/// Whether no pixel around this one is brighter.
bool is_top(const Plane<float> &flux, int u, int v) {
    const float here = flux.at(u, v);
    for (int y = v > 0 ? v - 1 : 0; y <= v + 1 && y < flux.height; ++y) {
        for (int x = u > 0 ? u - 1 : 0; x <= u + 1 && x < flux.width; ++x) {
            if (flux.at(x, y) > here) {
                return false;
            }
        }
    }
    return true;
}

/// Fill peaks, of room for MOST_STREAK_PEAKS, with those above a threshold, the brightest first;
/// equal ones keep their order. Return how many there are.
int find_peaks(const Plane<float> &flux, float threshold, FluxPeak *peaks) {
    int count = 0;
    for (int v = 0; v < flux.height; ++v) {
        for (int u = 0; u < flux.width; ++u) {
            const float here = flux.at(u, v);
            if (!(here > threshold) || !is_top(flux, u, v) ||
                (count == MOST_STREAK_PEAKS && !(here > peaks[count - 1].flux))) {
                continue;
            }
            int slot = count < MOST_STREAK_PEAKS ? count++ : count - 1;
            for (; slot > 0 && here > peaks[slot - 1].flux; --slot) {
                peaks[slot] = peaks[slot - 1];
            }
            peaks[slot] = {here, u, v};
        }
    }
    return count;
}

/// Keep the peaks, brightest first, that are not side lobes of brighter ones; return how many.
int keep_alone(const FluxPeak *peaks, int count, const Streak &streak, double sigma_px,
               Place *places, Arena &arena) {
    const Arena::Scope scope(arena);
    auto *flux = arena.take<double>(static_cast<size_t>(count));
    int kept = 0;
    for (int i = 0; i < count; ++i) {
        const Place place{static_cast<double>(peaks[i].u), static_cast<double>(peaks[i].v)};
        const Place moved = streak.at(place);
        const double length = std::hypot(moved.u, moved.v), divisor = std::fmax(length, 1e-9);
        const double c = moved.u / divisor, s = moved.v / divisor;
        const double here = static_cast<double>(peaks[i].flux);
        bool alone = true;
        for (int j = 0; alone && j < kept; ++j) {
            const double u = place.u - places[j].u, v = place.v - places[j].v;
            const double a = std::fabs(u * c + v * s), b = std::fabs(v * c - u * s);
            if (a < length + 3 * sigma_px && b < 3 * sigma_px + 1) {
                alone = here > 1.5 * (flux[j] * std::fmax(1 - a / divisor, 0.1));
            }
        }
        if (alone) {
            flux[kept] = here;
            places[kept++] = place;
        }
    }
    return kept;
}

}  // namespace

FoundStreak estimate_streak(const Frame &frame, double sigma_px, Arena &arena) {
    const Arena::Scope scope(arena);
    const FoundStreak none{{}, 0.0, false};
    const Spots spots = bright_spots(frame, arena);
    const int best = most_agreed(spots);
    if (best < 0) {
        return none;
    }
    StreakFit<7> fit[FITTED];
    Sky sky[FITTED];
    const double variance = frame.noise_dn() * frame.noise_dn();
    int count = 0;
    for (int j = 0; j < spots.count && count < FITTED; ++j) {
        const Spot &spot = spots.spot[j];
        if (agree(spots.spot[best], spot)) {
            fit[count].star = streak_at(spot.place, spot.streak, sigma_px);
            fit[count].star[FLUX] = spot.flux;
            sky[count++] = sky_at(frame.mesh, spot.place, variance);
        }
    }
    const StreakPixels pixels{frame.image, frame.full_scale_dn, sky};
    const NoiseModel noise = initial_noise_model(frame.background_dn(), variance);
    fit_streaks(pixels, fit, count, noise, FIT_ITERATIONS, arena);
    Place places[FITTED], streaks[FITTED];
    double weight[FITTED], sigma[FITTED];
    int good = 0;
    for (int i = 0; i < count; ++i) {
        const StreakStar &star = fit[i].star;
        const double length = star[LENGTH], of_length = fit[i].covariance[LENGTH][LENGTH];
        const double most = MOST_LENGTH_ERROR * length;
        if (misfit(fit[i].chi2, fit[i].dof, star[FLUX], fit[i].covariance[FLUX][FLUX]) <
                MOST_MISFIT &&
            of_length > 0 && of_length < most * most && length > SHORTEST_SPOT_PX) {
            places[good] = {star[U], star[V]};
            streaks[good] = {length * std::cos(star[ANGLE]), length * std::sin(star[ANGLE])};
            weight[good] = 1 / (of_length + SIGMA_FLOOR_PX * SIGMA_FLOOR_PX);
            sigma[good++] = star[SIGMA];
        }
    }
    if (good < LEAST_AGREEING - 1) {
        return none;
    }
    into_half_plane(good, [&streaks](int i) -> Place & { return streaks[i]; });
    return {fit_streak(places, streaks, weight, good, frame.image.width, frame.image.height),
            median(sigma, good), true};
}

int search_streaks(const Frame &frame, const Streak &streak, double sigma_px,
                   double threshold_sigmas, Place *places, Arena &arena) {
    const Arena::Scope scope(arena);
    const int width = frame.image.width, height = frame.image.height;
    const Plane<float> flux{
        arena.take<float>(static_cast<size_t>(width) * static_cast<size_t>(height)), width,
        height};
    auto *peaks = arena.take<FluxPeak>(MOST_STREAK_PEAKS);
    if (peaks == nullptr) {
        return 0;
    }
    subtract_level(frame.image, frame.mesh, flux, arena);
    const double noise = filter_streaks(flux, streak, sigma_px, threshold_sigmas, arena);
    const int count = find_peaks(flux, static_cast<float>(threshold_sigmas * noise), peaks);
    return keep_alone(peaks, count, streak, sigma_px, places, arena);
}

size_t streak_search_bytes(int width, int height) {
    const auto w = static_cast<size_t>(width), h = static_cast<size_t>(height);
    // Of the background, of the blur and of the spots; they follow each other.
    const size_t image = Arena::padded<float>(w * h);
    const size_t connected = Connected::bytes(width, height) + Arena::padded<float>(w);
    const size_t spots = image + connected + Arena::padded<Sums>(MOST_NUMBERS) +
                         2 * Arena::padded<int>(MOST_NUMBERS);
    const size_t blurred = 2 * image + connected + 34 * Arena::padded<float>(w + 64);
    const size_t search = image + Arena::padded<FluxPeak>(MOST_STREAK_PEAKS) +
                          Arena::padded<double>(MOST_STREAK_PEAKS) +
                          streak_filter_bytes(width, height);
    const size_t most = spots > blurred ? spots : blurred;
    return (most > search ? most : search) + streak_fit_bytes(FITTED);
}

}  // namespace st
