// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Which stars are near a direction, where they are at an epoch, and which pairs have a separation.

#include <algorithm>
#include <cmath>

#include "maths/sorting.h"
#include "sky/near.h"
#include "sky/sky.h"

namespace st {
namespace {

/// Return the step of the k-vector that a separation falls into, the first one for NaN.
int32_t step_of(const Pairs &pairs, double separation_rad) {
    return clipped((separation_rad - pairs.first_rad) * pairs.steps_per_rad, pairs.pairs);
}

}  // namespace

Vector3 direction_at(const SkyFile &sky, int32_t star, double years, const Vector3 &moved_au) {
    const double *direction = sky.direction[star];
    const float *motion = sky.motion[star];
    Vector3 moved;
    double square = 0;
    for (int i = 0; i < 3; ++i) {
        moved[i] = direction[i] + years * static_cast<double>(motion[i]) -
                   static_cast<double>(sky.parallax_rad[star]) * moved_au[i];
        square += moved[i] * moved[i];
    }
    const double length = std::sqrt(square);
    for (int i = 0; i < 3; ++i) {
        moved[i] /= length;
    }
    return moved;
}

int32_t stars_in_cone(const SkyFile &sky, const Vector3 &axis, double radius_rad, int32_t *index,
                      int32_t capacity) {
    const double radius = std::fmin(radius_rad, M_PI), least = std::cos(radius);
    int32_t found = 0, kept = 0;
    visit_near(sky.cells, axis, 2 * std::sin(radius / 2), [&](int32_t star) {
        const double *d = sky.direction[star];
        if (star >= sky.stars || !(d[0] * axis[0] + d[1] * axis[1] + d[2] * axis[2] >= least)) {
            return;
        }
        ++found;
        if (kept < capacity) {
            index[kept++] = star;
            if (kept == capacity) {
                // The faintest star, that of the largest index, is then in front.
                std::make_heap(index, index + kept);
            }
        } else if (kept > 0 && star < index[0]) {
            std::pop_heap(index, index + kept);
            index[kept - 1] = star;
            std::push_heap(index, index + kept);
        }
    });
    sort_ascending(index, kept);
    return found;
}

int32_t nearest_star(const SkyFile &sky, const Vector3 &direction, double chord, double &square) {
    const Nearest found = nearest(sky.pattern_cells, sky.direction, direction, chord);
    square = found.square;
    return found.star;
}

PairRange pairs_between(const Pairs &pairs, double low_rad, double high_rad) {
    const double *separation = pairs.separation_rad;
    // The division rounds, hence the comparison to both sides.
    int32_t first = pairs.below[step_of(pairs, low_rad)];
    while (first > 0 && separation[first - 1] >= low_rad) {
        --first;
    }
    while (first < pairs.pairs && separation[first] < low_rad) {
        ++first;
    }
    int32_t end = pairs.below[step_of(pairs, high_rad)];
    while (end > 0 && separation[end - 1] > high_rad) {
        --end;
    }
    while (end < pairs.pairs && separation[end] <= high_rad) {
        ++end;
    }
    return {first, std::max(first, end)};
}

}  // namespace st
