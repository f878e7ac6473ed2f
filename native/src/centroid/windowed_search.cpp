// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/windowed_search.h"

#include <cmath>
#include <cstring>

#include "centroid/hits.h"
#include "maths/clones.h"

namespace st {
namespace {

constexpr double HIT_SHARE =
    0.1;  // of the peaks near predicted stars, from which on hits are removed
constexpr int MOST_SIDE = 2 * static_cast<int>(MOST_RADIUS_OF_SEARCH_PX) + 1;
constexpr int MOST_ROWS = MOST_SIDE + 2 * (MOST_WEIGHTS - 1);

/// Pixels from left, top to right, bottom, of which none may be left.
struct Box {
    int left, top, right, bottom;

    int columns() const { return right - left + 1; }
    int rows() const { return bottom - top + 1; }
};

/// A value of the filtered image; u is -1 for none.
struct Highest {
    double value;
    int u, v;
};

ST_CLONES void add_row(const uint16_t *__restrict row, double weight, int count,
                       double *__restrict sums) {
    for (int x = 0; x < count; ++x) {
        sums[x] += weight * row[x];
    }
}

ST_CLONES void add_line(const double *__restrict line, double weight, int count,
                        double *__restrict sums) {
    for (int x = 0; x < count; ++x) {
        sums[x] += weight * line[x];
    }
}

/// Return the highest value of the filtered image in a box at least a radius from the borders. Each
/// row is filtered once, in the order of filtered_at(); the taps are the outer loop, so that pixels
/// side by side are added at once.
Highest highest_inside(const Image &image, const Kernel &kernel, const Box &box, Arena &arena) {
    const Arena::Scope scope(arena);
    const int radius = kernel.radius, columns = box.columns(), rows = box.rows() + 2 * radius;
    auto *across = arena.take<double>(MOST_ROWS * MOST_SIDE);
    std::memset(across, 0, sizeof(double) * static_cast<size_t>(rows * columns));
    for (int y = 0; y < rows; ++y) {
        const uint16_t *row = image.row(box.top - radius + y) + box.left;
        for (int k = -radius; k <= radius; ++k) {
            add_row(row + k, static_cast<double>(kernel.weights[k < 0 ? -k : k]), columns,
                    across + y * columns);
        }
    }
    Highest best{-HUGE_VAL, -1, -1};
    for (int y = 0; y < box.rows(); ++y) {
        double line[MOST_SIDE] = {};
        for (int k = 0; k <= 2 * radius; ++k) {
            add_line(across + (y + k) * columns,
                     static_cast<double>(kernel.weights[k < radius ? radius - k : k - radius]),
                     columns, line);
        }
        for (int x = 0; x < columns; ++x) {
            if (line[x] > best.value) {
                best = {line[x], box.left + x, box.top + y};
            }
        }
    }
    return best;
}

/// Return the highest value of the filtered image in a box.
Highest highest_in(const Image &image, const Kernel &kernel, const Box &box, Arena &arena) {
    Highest best{-HUGE_VAL, -1, -1};
    if (box.left > box.right || box.top > box.bottom) {
        return best;
    }
    const int radius = kernel.radius;
    if (box.left >= radius && box.right < image.width - radius && box.top >= radius &&
        box.bottom < image.height - radius) {
        return highest_inside(image, kernel, box, arena);
    }
    for (int v = box.top; v <= box.bottom; ++v) {
        for (int u = box.left; u <= box.right; ++u) {
            const double value = filtered_at(image, kernel, u, v);
            if (value > best.value) {
                best = {value, u, v};
            }
        }
    }
    return best;
}

/// Return the pixels within a radius of a place that are not on the border of the image.
Box box_about(const Image &image, const Place &place, double radius_px) {
    const double radius =
        radius_px < MOST_RADIUS_OF_SEARCH_PX ? radius_px : MOST_RADIUS_OF_SEARCH_PX;
    if (!(std::fabs(place.u) < 2.0 * image.width + radius &&
          std::fabs(place.v) < 2.0 * image.height + radius)) {
        return {1, 1, 0, 0};
    }
    Box box{static_cast<int>(std::ceil(place.u - radius)),
            static_cast<int>(std::ceil(place.v - radius)), static_cast<int>(place.u + radius),
            static_cast<int>(place.v + radius)};
    box.left = box.left > 1 ? box.left : 1;
    box.top = box.top > 1 ? box.top : 1;
    box.right = box.right < image.width - 2 ? box.right : image.width - 2;
    box.bottom = box.bottom < image.height - 2 ? box.bottom : image.height - 2;
    return box;
}

bool is_listed(const List<Peak> &peaks, const Highest &best) {
    for (const Peak &peak : peaks) {
        if (peak.u == best.u && peak.v == best.v) {
            return true;
        }
    }
    return false;
}

}  // namespace

bool peaks_near(const Image &image, const Kernel &kernel, const Mesh &mesh,
                const Threshold &threshold, const Place *places, const double *radius_px,
                int count, double share, List<Peak> &peaks, uint8_t *found, Arena &arena) {
    for (int i = 0; i < count; ++i) {
        found[i] = 0;
        const Highest best =
            highest_in(image, kernel, box_about(image, places[i], radius_px[i]), arena);
        if (best.u < 0) {
            continue;
        }
        const auto [level, noise] = background_at(mesh, best.u, best.v);
        const double least = threshold.sigmas * noise;
        if (best.value - level < (least > threshold.dn ? least : threshold.dn)) {
            continue;
        }
        double around[3][3], highest = -HUGE_VAL;
        for (int y = 0; y < 3; ++y) {
            for (int x = 0; x < 3; ++x) {
                around[y][x] = filtered_at(image, kernel, best.u + x - 1, best.v + y - 1);
                highest = around[y][x] > highest ? around[y][x] : highest;
            }
        }
        if (highest <= best.value && !is_listed(peaks, best)) {
            found[i] =
                peaks.add({best.u, best.v, parabola_top(around[1][0], best.value, around[1][2]),
                           parabola_top(around[0][1], best.value, around[2][1]),
                           best.value - level, level, noise})
                    ? 1
                    : 0;
        }
    }
    int hits = 0;
    for (const Peak &peak : peaks) {
        hits += is_hit(image, peak, peak.noise / kernel.noise_gain, share) ? 1 : 0;
    }
    return hits > HIT_SHARE * peaks.count;
}

}  // namespace st
