// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/spots.h"

#include <cmath>

#include "centroid/background.h"
#include "centroid/blur.h"
#include "centroid/connected.h"
#include "centroid/smoothing.h"
#include "maths/sorting.h"

namespace st {
namespace {

constexpr int CELLS = 8;  // along each side of the image
constexpr double FAINTEST_SHARE = 0.25;
constexpr double FILTER_SIGMA_PX = 1.0;
constexpr double THRESHOLD_SIGMAS = 5.0;
// Least height above the background: quantised and clipped backgrounds have no noise to measure.
constexpr double LEAST_DN = 1.5;
constexpr double MOST_SIDE = 30.0;  // px of a spot, in an image of 1024 px; no star is as large
constexpr double REFERENCE_PX = 1024.0;
// A spot is above all but a quarter of a ring this far outside it by half of its height at least.
// The border of a straight edge is not.
constexpr double RING_PX = 3.0, RING_SHARE = 0.5;
constexpr int RING = 16, RING_HIGHEST = 12;
// Of the sky at most this share of a square about a spot, the longest side of the image over so
// many, is above the threshold, or more in a crowded image.
constexpr double CALM_SHARE = 0.05;
constexpr int CALM_SIDES = 24;
constexpr double SAME_PX = 1.5;  // a fitted position this close to a spot's centre is of one star
constexpr double SIZE_SHARE = 0.2;  // of the size of a spot that its centre is off, beyond noise
constexpr int PX_PER_SPOT = 16;     // at least: a filtered pixel makes no smaller spot

/// What the pixels of a spot add up to.
struct Spot {
    double flux, flux_u, flux_v, peak, second, variance;
    Box box;

    Place centre() const { return {flux_u / flux, flux_v / flux}; }
    int side() const {
        const int across = box.right - box.left + 1, down = box.bottom - box.top + 1;
        return across > down ? across : down;
    }
};

/// A spot and how much of its surroundings is above the threshold.
struct Candidate {
    int spot;
    double flux, busy;
};

double larger(double a, double b) {
    return a > b ? a : b;
}

double distance(const st_centroid &star, const Place &place) {
    const double u = star.u_px - place.u, v = star.v_px - place.v;
    return std::sqrt(u * u + v * v);
}

Place place_of(const st_centroid &star) {
    return {star.u_px, star.v_px};
}

/// Whether one of the stars is within a distance of a place.
bool has_within(const List<st_centroid> &stars, const Place &place, double px) {
    for (const st_centroid &star : stars) {
        if (distance(star, place) <= px) {
            return true;
        }
    }
    return false;
}

/// Threshold of a mesh in DN above the level, of each tile, into tiles.
void set_threshold(const Mesh &mesh, double *tiles) {
    for (int k = 0; k < mesh.size(); ++k) {
        tiles[k] = larger(THRESHOLD_SIGMAS * mesh.noise[k], LEAST_DN);
    }
}

/// Fill smooth with the filtered image less its level, and add the pixels above the threshold to
/// spots.
void filter(const Image &image, const Mesh &mesh, const double *threshold,
            const Plane<float> &smooth, Connected &spots, Arena &arena) {
    const Arena::Scope scope(arena);
    auto *line = arena.take<float>(static_cast<size_t>(image.width));
    subtract_level(image, mesh, smooth, arena);
    blur(smooth, FILTER_SIGMA_PX, arena);
    OverImage limit(mesh, threshold, image.width, image.height, arena);
    for (int v = 0; v < image.height; ++v) {
        limit.fill(v, line);
        spots.add_row(smooth.row(v), line);
    }
}

/// Add up the pixels of the first count of spots; the moments about the centre come last.
void measure(const Plane<float> &smooth, const Connected &spots, const Mesh &mesh,
             const double *threshold, Spot *measured, int count, Arena &arena) {
    const Arena::Scope scope(arena);
    for (int i = 0; i < count; ++i) {
        measured[i] = {};
    }
    auto *line = arena.take<float>(static_cast<size_t>(smooth.width));
    OverImage limit(mesh, threshold, smooth.width, smooth.height, arena);
    for (int v = 0; v < smooth.height; ++v) {
        if (spots.row(v).begin() != spots.row(v).end()) {
            limit.fill(v, line);
        }
        for (const Run &run : spots.row(v)) {
            if (run.spot > count) {
                continue;
            }
            Spot &one = measured[run.spot - 1];
            for (int u = run.first; u <= run.last; ++u) {
                const auto flux = static_cast<double>(smooth.at(u, v));
                const float noise = line[u] / static_cast<float>(THRESHOLD_SIGMAS);
                one.flux += flux;
                one.flux_u += flux * u;
                one.flux_v += flux * v;
                one.peak = larger(one.peak, flux);
                one.variance += static_cast<double>(noise * noise);
            }
            one.box.add(run, v);
        }
    }
    for (int v = 0; v < smooth.height; ++v) {
        for (const Run &run : spots.row(v)) {
            if (run.spot > count) {
                continue;
            }
            Spot &one = measured[run.spot - 1];
            const Place centre = one.centre();
            for (int u = run.first; u <= run.last; ++u) {
                const double across = u - centre.u, down = v - centre.v;
                one.second +=
                    static_cast<double>(smooth.at(u, v)) * (across * across + down * down);
            }
        }
    }
}

/// Whether a spot stands out from its surroundings, not from a level alone.
bool is_isolated(const Spot &spot, const Plane<float> &smooth, const OverImage &level) {
    const Place centre = spot.centre();
    const double radius = spot.side() / 2.0 + RING_PX;
    double around[RING];
    for (int k = 0; k < RING; ++k) {
        const double turn = 2 * M_PI * k / RING;
        int u = static_cast<int>(std::nearbyint(centre.u + radius * std::cos(turn)));
        int v = static_cast<int>(std::nearbyint(centre.v + radius * std::sin(turn)));
        u = u < 0 ? 0 : u < smooth.width ? u : smooth.width - 1;
        v = v < 0 ? 0 : v < smooth.height ? v : smooth.height - 1;
        insert_sorted(around, k, static_cast<double>(smooth.at(u, v) + level.at(u, v)));
    }
    const auto here = static_cast<double>(level.at(static_cast<int>(std::nearbyint(centre.u)),
                                                   static_cast<int>(std::nearbyint(centre.v))));
    return here + spot.peak - around[RING_HIGHEST] > RING_SHARE * spot.peak;
}

/// Return the share of the pixels about a spot that are above the threshold, without its own.
double surroundings(const Spot &spot, const Connected &spots) {
    const int side =
        (spots.width() > spots.height() ? spots.width() : spots.height()) / CALM_SIDES;
    if (side == 0) {
        return 0.0;
    }
    const Place centre = spot.centre();
    const int left = static_cast<int>(std::nearbyint(centre.u)) - side / 2;
    const int top = static_cast<int>(std::nearbyint(centre.v)) - side / 2;
    return static_cast<double>(spots.count_in(left, top, side) - spot.box.pixels) / (side * side);
}

/// Keep the calm ones of candidates; return their number.
int keep_calm(Candidate *candidates, int count, Arena &arena) {
    const Arena::Scope scope(arena);
    auto *busy = arena.take<double>(static_cast<size_t>(count));
    for (int i = 0; i < count; ++i) {
        busy[i] = candidates[i].busy;
    }
    double most = CALM_SHARE;
    if (count > 0) {
        most = larger(most, ranked(busy, count, (count < MOST_SPOTS ? count : MOST_SPOTS) - 1));
    }
    int kept = 0;
    for (int i = 0; i < count; ++i) {
        if (candidates[i].busy <= most) {
            candidates[kept++] = candidates[i];
        }
    }
    return kept;
}

st_centroid star_of(const Spot &spot) {
    st_centroid star{};
    const Place centre = spot.centre();
    const double size = std::sqrt(spot.second / spot.flux / 2 + 1.0 / 12);
    star.u_px = centre.u;
    star.v_px = centre.v;
    star.flux_dn = spot.flux;
    star.snr = spot.flux / std::sqrt(spot.variance);
    star.sigma_px = std::hypot(size / larger(star.snr, 1.0), SIZE_SHARE * size);
    star.cov_uu_px2 = star.cov_vv_px2 = star.sigma_px * star.sigma_px;
    return star;
}

}  // namespace

void find_spots(const Image &image, double cell_share, bool calm, List<st_centroid> &spots,
                Arena &arena) {
    const Arena::Scope scope(arena);
    const size_t tiles = most_tiles(image.width, image.height);
    const auto size = static_cast<size_t>(image.size());
    const Mesh mesh =
        measure_background(image, gaussian_kernel(FILTER_SIGMA_PX), arena.take<double>(tiles),
                           arena.take<double>(tiles), arena);
    auto *threshold = arena.take<double>(tiles);
    set_threshold(mesh, threshold);
    const Plane<float> smooth{arena.take<float>(size), image.width, image.height};
    Connected connected(image.width, image.height, arena);
    filter(image, mesh, threshold, smooth, connected, arena);
    const int most = image.size() / PX_PER_SPOT + 1, found = connected.number();
    const int count = found < most ? found : most;
    auto *measured = arena.take<Spot>(static_cast<size_t>(count));
    auto *candidates = arena.take<Candidate>(static_cast<size_t>(count));
    measure(smooth, connected, mesh, threshold, measured, count, arena);
    const OverImage level(mesh, mesh.level, image.width, image.height, arena);
    const int longest = image.width > image.height ? image.width : image.height;
    const double most_side = MOST_SIDE * larger(1.0, longest / REFERENCE_PX);
    int left = 0;
    for (int i = 0; i < count; ++i) {
        if (measured[i].side() <= most_side && is_isolated(measured[i], smooth, level)) {
            candidates[left++] = {i, measured[i].flux,
                                  calm ? surroundings(measured[i], connected) : 0.0};
        }
    }
    if (calm) {
        left = keep_calm(candidates, left, arena);
    }
    const auto kept = static_cast<size_t>(left);
    sort(candidates, left, arena.take<Candidate>(kept),
         [](const Candidate &a, const Candidate &b) { return a.flux > b.flux; });
    // Letters and lit windows are bright and close together.
    auto *places = arena.take<Place>(kept);
    auto *chosen = arena.take<uint8_t>(kept);
    for (int i = 0; i < left; ++i) {
        places[i] = measured[candidates[i].spot].centre();
    }
    choose(places, left, image.width, image.height, MOST_SPOTS, cell_share, chosen);
    for (int i = 0; i < left; ++i) {
        if (chosen[i] != 0) {
            spots.add(star_of(measured[candidates[i].spot]));
        }
    }
}

int explained_spots(const List<st_centroid> &spots, const List<st_centroid> &stars,
                    double reach_px) {
    int explained = 0;
    for (int i = 0; i < spots.count && i < BRIGHT_SPOTS; ++i) {
        for (const st_centroid &star : stars) {
            if (distance(star, place_of(spots[i])) < reach_px + SAME_PX) {
                ++explained;
                break;
            }
        }
    }
    return explained;
}

void add_near_spots(List<st_centroid> &stars, const List<st_centroid> &spots, const Place *places,
                    const double *radius_px, int count, Arena &arena) {
    List<st_centroid> fitted = stars;
    for (const st_centroid &spot : spots) {
        bool near = false;
        for (int i = 0; i < count; ++i) {
            near |= distance(spot, places[i]) < radius_px[i];
        }
        if (near && !has_within(fitted, place_of(spot), SAME_PX)) {
            stars.add(spot);
        }
    }
    sort_by_flux(stars, arena);
}

void add_spots(List<st_centroid> &stars, const List<st_centroid> &spots, int most, Arena &arena) {
    const List<st_centroid> fitted = stars;
    double faintest = 0.0;
    if (fitted.count > 0) {
        const Arena::Scope scope(arena);
        auto *flux = arena.take<double>(static_cast<size_t>(fitted.count));
        for (int i = 0; i < fitted.count; ++i) {
            flux[i] = fitted[i].flux_dn;
        }
        faintest = quantile(flux, fitted.count, FAINTEST_SHARE);
    }
    const int short_of = BRIGHT_SPOTS - fitted.count;
    const int capacity = most / 2 > most - fitted.count ? most / 2 : most - fitted.count;
    int others = 0, added = 0;
    for (const st_centroid &spot : spots) {
        if (has_within(fitted, place_of(spot), SAME_PX)) {
            continue;
        }
        if ((spot.flux_dn > faintest || others < short_of) && added < capacity) {
            stars.add(spot);
            ++added;
        }
        ++others;
    }
    sort_by_flux(stars, arena);
}

void sort_by_flux(List<st_centroid> &stars, Arena &arena) {
    const Arena::Scope scope(arena);
    sort(stars.item, stars.count, arena.take<st_centroid>(static_cast<size_t>(stars.count)),
         [](const st_centroid &a, const st_centroid &b) { return a.flux_dn > b.flux_dn; });
}

int choose(const Place *places, int count, int width, int height, int most, double cell_share,
           uint8_t *chosen) {
    int of_cell[CELLS * CELLS] = {}, left = most < count ? most : count;
    const double quota = count > most ? std::ceil(cell_share * most / (CELLS * CELLS)) : count;
    for (int i = 0; i < count; ++i) {
        const int across = static_cast<int>(std::floor(places[i].u / width * CELLS));
        const int down = static_cast<int>(std::floor(places[i].v / height * CELLS));
        int cell = across + CELLS * down;
        cell = cell < 0 ? 0 : cell < CELLS * CELLS ? cell : CELLS * CELLS - 1;
        chosen[i] = of_cell[cell]++ < quota && left > 0 ? 1 : 0;
        left -= chosen[i];
    }
    for (int i = 0; i < count && left > 0; ++i) {
        if (chosen[i] == 0) {
            chosen[i] = 1;
            --left;
        }
    }
    return most < count ? most : count;
}

}  // namespace st
