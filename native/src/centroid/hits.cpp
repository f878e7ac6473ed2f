// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/hits.h"

#include <cmath>
#include <cstring>

#include "centroid/psf.h"
#include "centroid/windows.h"
#include "maths/sorting.h"

namespace st {
namespace {

constexpr double NARROWEST = 0.7;  // star, in PSF sigmas of the median one
constexpr double LEAST_SIGMA_PX = 0.2;
constexpr int PHASES = 11;  // of a star within its pixel, along each axis
constexpr double MARGIN_SIGMAS = 2.0;
constexpr int STORM_PEAKS = 30;  // single pixels among the peaks, from which on hits are removed
constexpr int BRIGHT_PEAKS = 100;
constexpr double DARK_SHARE =
    0.1;  // of the brightest pixel: flux in the eight around it, in a storm
constexpr double HIT_SIGMAS = 8.0;
constexpr int TRACK_PX = 5;  // removed pixel by pixel from both ends

int larger(int a, int b) {
    return a > b ? a : b;
}

int smaller(int a, int b) {
    return a < b ? a : b;
}

Pixel brightest_of_nine(const Image &image, int u, int v) {
    Pixel best{u, v};
    for (int y = larger(v - 1, 0); y < smaller(v + 2, image.height); ++y) {
        for (int x = larger(u - 1, 0); x < smaller(u + 2, image.width); ++x) {
            if (image.at(x, y) > image.at(best.u, best.v)) {
                best = {x, y};
            }
        }
    }
    return best;
}

/// Return the flux in the pixels around the brightest one at a peak over that of this one.
double share_around(const Image &image, const Peak &peak) {
    const Pixel best = brightest_of_nine(image, peak.u, peak.v);
    double around = 0.0, count = 0.0;
    for (int y = larger(best.v - 1, 0); y < smaller(best.v + 2, image.height); ++y) {
        for (int x = larger(best.u - 1, 0); x < smaller(best.u + 2, image.width); ++x) {
            if (x != best.u || y != best.v) {
                around += image.at(x, y);
                count += 1.0;
            }
        }
    }
    const double flux = image.at(best.u, best.v) - peak.level;
    return (around - count * peak.level) / (flux > 1.0 ? flux : 1.0);
}

/// Return the value that replaces a pixel if it is a hit, else -1.
int without_hit(const uint16_t *pixel, ptrdiff_t stride, double level, double noise_dn,
                double share) {
    const int here = *pixel;
    double around[8];
    insert_sorted(around, 0, pixel[-1]);
    insert_sorted(around, 1, pixel[1]);
    insert_sorted(around, 2, pixel[-stride]);
    insert_sorted(around, 3, pixel[stride]);
    if (around[1] - level >= share * (here - level) - MARGIN_SIGMAS * noise_dn) {
        return -1;
    }
    insert_sorted(around, 4, pixel[-stride - 1]);
    insert_sorted(around, 5, pixel[-stride + 1]);
    insert_sorted(around, 6, pixel[stride - 1]);
    insert_sorted(around, 7, pixel[stride + 1]);
    return here >= around[7] ? static_cast<int>((around[3] + around[4]) / 2) : -1;
}

}  // namespace

double least_share(double sigma_px) {
    const double narrow_px = std::nearbyint(NARROWEST * sigma_px * 100) / 100;
    // Of both pixels next to the brightest one over that, for each phase.
    double beside[PHASES][2];
    for (int phase = 0; phase < PHASES; ++phase) {
        Profile<float> of;
        profile(phase == PHASES - 1 ? 0.5 : -0.5 + phase * 0.1,
                narrow_px > LEAST_SIGMA_PX ? narrow_px : LEAST_SIGMA_PX, -1, 3, of);
        beside[phase][0] = static_cast<double>(of.share[0]) / static_cast<double>(of.share[1]);
        beside[phase][1] = static_cast<double>(of.share[2]) / static_cast<double>(of.share[1]);
    }
    double least = INFINITY;
    for (const auto &across : beside) {
        for (const auto &down : beside) {
            double around[4];
            insert_sorted(around, 0, across[0]);
            insert_sorted(around, 1, across[1]);
            insert_sorted(around, 2, down[0]);
            insert_sorted(around, 3, down[1]);
            least = around[1] < least ? around[1] : least;
        }
    }
    return least;
}

bool is_hit(const Image &image, const Peak &peak, double noise_dn, double share) {
    const auto [u, v] = brightest_of_nine(image, peak.u, peak.v);
    if (!(0 < u && u < image.width - 1 && 0 < v && v < image.height - 1)) {
        return false;
    }
    double around[4];
    insert_sorted(around, 0, image.at(u - 1, v));
    insert_sorted(around, 1, image.at(u + 1, v));
    insert_sorted(around, 2, image.at(u, v - 1));
    insert_sorted(around, 3, image.at(u, v + 1));
    const double least = share * (image.at(u, v) - peak.level) - MARGIN_SIGMAS * noise_dn;
    return around[1] - peak.level < least;
}

bool is_single(const Image &image, const Peak &peak) {
    return std::fabs(share_around(image, peak)) <= LONE_PIXEL;
}

bool is_storm(const Image &image, const List<Peak> &peaks) {
    double shares[BRIGHT_PEAKS];
    const int count = smaller(peaks.count, BRIGHT_PEAKS);
    int single = 0;
    for (int i = 0; i < count; ++i) {
        shares[i] = share_around(image, peaks[i]);
        single += std::fabs(shares[i]) <= LONE_PIXEL ? 1 : 0;
    }
    return single >= STORM_PEAKS && median(shares, count) < DARK_SHARE;
}

void remove_hits(const Image &image, uint16_t *clean, const Mesh &mesh, double noise_dn,
                 double sigma_px, Rejections &rejections, Arena &arena) {
    const Arena::Scope scope(arena);
    const double share = least_share(sigma_px), lowest = HIT_SIGMAS * noise_dn;
    auto *hit = arena.take<uint8_t>(static_cast<size_t>(image.size()));
    std::memset(hit, 0, static_cast<size_t>(image.size()));
    for (int step = 0; step < TRACK_PX; ++step) {
        for (int v = 1; v < image.height - 1; ++v) {
            uint16_t *row = clean + v * image.stride;
            for (int u = 1; u < image.width - 1; ++u) {
                const int here = row[u];
                // Most pixels end here.
                if (here < row[u - 1] || here < row[u + 1] || here < row[u - image.stride]) {
                    continue;
                }
                const double level = background_at(mesh, u, v).level;
                if (here - level < lowest) {
                    continue;
                }
                const int value = without_hit(row + u, image.stride, level, noise_dn, share);
                if (value >= 0) {
                    row[u] = static_cast<uint16_t>(value);
                    hit[v * image.width + u] = 1;
                }
            }
        }
    }
    for (int v = 0; v < image.height; ++v) {
        for (int u = 0; u < image.width; ++u) {
            if (hit[v * image.width + u] != 0) {
                rejections.add(ST_REJECTED_HOT_PIXEL, u, v);
            }
        }
    }
}

}  // namespace st
