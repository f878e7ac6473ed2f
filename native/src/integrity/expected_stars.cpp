// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "integrity/expected_stars.h"

#include <cmath>

#include "integrity/checks.h"
#include "maths/sorting.h"

namespace st {
namespace {

using namespace checks;

constexpr double TOLERANCE_SHARE = 0.03;  // of the shift
constexpr double PRESENT_SHARE = 0.6;     // of present_px, of a tolerance
constexpr double LEAST_SPEED2 = 1e-12;    // px^2/s^2
constexpr int MOST_COMPARED = 60;         // missed stars: the time grows with their square

double square_between(const Point &a, const Point &b) {
    const double du = a.x - b.x, dv = a.y - b.y;
    return du * du + dv * dv;
}

/// Return the points in the order of their rows.
List<Point> by_rows(const List<Point> &points, Arena &arena) {
    const auto n = static_cast<size_t>(points.count);
    auto sorted = arena.list<Point>(n);
    sorted.add_all(points);
    sort(sorted.item, sorted.count, arena.take<Point>(n),
         [](const Point &a, const Point &b) { return a.y < b.y; });
    return sorted;
}

/// Whether one of the points, by rows, is so near.
bool has_near(const List<Point> &sorted, const Point &place, double distance) {
    int low = 0, high = sorted.count;
    while (low < high) {
        const int middle = low + (high - low) / 2;
        if (sorted[middle].y <= place.y - distance) {
            low = middle + 1;
        } else {
            high = middle;
        }
    }
    for (int k = low; k < sorted.count && sorted[k].y < place.y + distance; ++k) {
        if (square_between(sorted[k], place) < distance * distance) {
            return true;
        }
    }
    return false;
}

/// The most stars with a centroid at one shift or one time away, and the shift.
struct Group {
    int count = 0;
    double shift_px = 0.0;
};

Group largest_group(const List<ExpectedStar> &stars, const List<Point> &free, double present_px,
                    Arena &arena) {
    const List<Point> sorted = by_rows(free, arena);
    Group best;
    for (const ExpectedStar &star : stars) {
        const Point &f = star.velocity;
        const double speed2 = f.x * f.x + f.y * f.y;
        for (const Point &point : free) {
            const double du = point.x - star.uv.x, dv = point.y - star.uv.y;
            const double length = std::hypot(du, dv);
            if (length > limit(SECOND_IMAGE, "reach_px")) {
                continue;
            }
            const double tolerance = PRESENT_SHARE * present_px + TOLERANCE_SHARE * length;
            const double time_s =
                (du * f.x + dv * f.y) / (speed2 > LEAST_SPEED2 ? speed2 : LEAST_SPEED2);
            const bool along = std::hypot(du - time_s * f.x, dv - time_s * f.y) <= tolerance;
            int shifted = 0, later = 0;
            for (const ExpectedStar &other : stars) {
                const Point &at = other.uv, &v = other.velocity;
                shifted += has_near(sorted, {at.x + du, at.y + dv}, tolerance);
                later += along &&
                         has_near(sorted, {at.x + time_s * v.x, at.y + time_s * v.y}, tolerance);
            }
            const int count = shifted > later ? shifted : later;
            if (count > best.count) {
                best = {count, length};
            }
        }
    }
    return best;
}

}  // namespace

st_reason contradiction_of(const ExpectedStar *stars, int count, const Point *uv, int centroids,
                           double present_px, Arena &arena) {
    const Arena::Scope scope(arena);
    bool *taken = arena.take<bool>(static_cast<size_t>(centroids));
    auto unseen = arena.list<ExpectedStar>(static_cast<size_t>(count));
    auto free = arena.list<Point>(static_cast<size_t>(centroids));
    for (int j = 0; j < centroids; ++j) {
        taken[j] = false;
    }
    for (int i = 0; i < count; ++i) {
        bool seen = false;
        for (int j = 0; j < centroids; ++j) {
            if (square_between(stars[i].uv, uv[j]) < present_px * present_px) {
                seen = taken[j] = true;
            }
        }
        if (!seen) {
            unseen.add(stars[i]);
        }
    }
    for (int j = 0; j < centroids; ++j) {
        if (!taken[j]) {
            free.add(uv[j]);
        }
    }
    const int missed = unseen.count;
    if (missed < limit(SECOND_IMAGE, "stars") || free.count < limit(SECOND_IMAGE, "stars")) {
        return {};
    }
    const int every = (missed + MOST_COMPARED - 1) / MOST_COMPARED;
    List<ExpectedStar> compared = unseen;
    compared.count = 0;
    for (int i = 0; i < missed; i += every) {
        compared.add(unseen[i]);
    }
    const Group group = largest_group(compared, free, present_px, arena);
    const double moved = every * group.count;
    if (group.count >= limit(SECOND_IMAGE, "stars") &&
        moved >= limit(SECOND_IMAGE, "share") * count) {
        return reason_of(SECOND_IMAGE, {moved, static_cast<double>(count), group.shift_px});
    }
    if (missed > limit(MISSING_STARS, "missed_share") * count &&
        free.count > limit(MISSING_STARS, "placed_share") * missed) {
        return reason_of(MISSING_STARS,
                         {static_cast<double>(count - missed), static_cast<double>(count),
                          static_cast<double>(free.count)});
    }
    return {};
}

size_t contradiction_bytes(int count, int centroids) {
    return Arena::padded<ExpectedStar>(static_cast<size_t>(count)) +
           3 * Arena::padded<Point>(static_cast<size_t>(centroids)) +
           Arena::padded<bool>(static_cast<size_t>(centroids));
}

}  // namespace st
