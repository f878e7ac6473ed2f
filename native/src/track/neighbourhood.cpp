// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "track/neighbourhood.h"

#include <algorithm>
#include <cmath>

#include "maths/sorting.h"

namespace st {
namespace {

/// Radius of a gate, and largest misfit of a distance, in sigma of a centroid per axis: three times
/// the error of the difference of two centroids.
constexpr double GATE_SIGMA = 3 * M_SQRT2;

/// Identified neighbours that must agree to select one of the centroids of a gate.
constexpr int NEIGHBOURS_IN_GATE = 2;

/// Identified neighbours that must agree on a star outside its gate: two distances alone fit its
/// mirror image as well.
constexpr int NEIGHBOURS_ANYWHERE = 3;

double distance(const Vector3 &a, const Vector3 &b) {
    return norm(Vector3{{a[0] - b[0], a[1] - b[1], a[2] - b[2]}});
}

/// The stars and centroids of a frame, and which belong together so far.
struct Neighbourhood {
    const Point *predicted;
    const Vector3 *icrf;
    int stars;
    const Point *uv;
    const double *sigma_px;
    int centroids;
    const Vector3 *sensor;  // (centroids)
    bool *is_free;          // (centroids)
    int32_t *assigned;      // (stars)
    double pixel_rad;

    bool is_inside(int n, int j) const {
        const double du = predicted[n].x - uv[j].x, dv = predicted[n].y - uv[j].y;
        const double radius_px = GATE_SIGMA * sigma_px[j];
        return du * du + dv * dv <= radius_px * radius_px;
    }

    double tolerance_rad(int j) const { return GATE_SIGMA * sigma_px[j] * pixel_rad / M_SQRT2; }

    /// Return the misfit of this rank among those of the distances to identified stars, over what is
    /// tolerated; misfits has room for all stars.
    double misfit(int n, int j, int rank, double *misfits) const {
        int count = 0;
        for (int k = 0; k < stars; ++k) {
            if (assigned[k] < 0) {
                continue;
            }
            const double measured = distance(sensor[j], sensor[assigned[k]]);
            const double misfit = std::fabs(measured - distance(icrf[n], icrf[k])) /
                                  std::hypot(tolerance_rad(j), tolerance_rad(assigned[k]));
            misfits[count++] = std::isnan(misfit) ? INFINITY : misfit;
        }
        return ranked(misfits, count, rank);
    }

    /// Assign a star the centroid, of its gate or of anywhere, that fits the distances.
    void assign(int n, bool in_gate, double *misfits) {
        const int needed = in_gate ? NEIGHBOURS_IN_GATE : NEIGHBOURS_ANYWHERE;
        int neighbours = 0;
        for (int k = 0; k < stars; ++k) {
            neighbours += assigned[k] >= 0 ? 1 : 0;
        }
        if (neighbours < needed) {
            return;
        }
        // The median misfit, of needed neighbours at least: one of them may be a false star.
        const int rank = std::max(neighbours / 2, needed - 1);
        int best = -1, fitting = 0;
        double least = INFINITY;
        for (int j = 0; j < centroids; ++j) {
            if (!is_free[j] || (in_gate && !is_inside(n, j))) {
                continue;
            }
            const double found = misfit(n, j, rank, misfits);
            fitting += found <= 1 ? 1 : 0;
            if (best < 0 || found < least) {
                best = j;
                least = found;
            }
        }
        if (fitting == 1 || (fitting > 0 && in_gate)) {
            assigned[n] = best;
            is_free[best] = false;
        }
    }
};

}  // namespace

Point propagated(const Lens &lens, const Point &uv, const Matrix3 &turn) {
    // R^T d: the direction after the turn, on the new axes.
    return project(lens, sensor_direction(turn, unproject(lens, uv)));
}

size_t star_neighbourhood_bytes(int stars, int centroids) {
    const auto n = static_cast<size_t>(stars), m = static_cast<size_t>(centroids);
    return 4 * Arena::padded<int>(n) + Arena::padded<double>(n) + 2 * Arena::padded<int>(m) +
           Arena::padded<Vector3>(m) + Arena::padded<bool>(m);
}

void star_neighbourhood(const Lens &lens, double pixel_rad, const Point *predicted,
                        const Vector3 *icrf, int stars, const Point *uv, const double *sigma_px,
                        int centroids, int32_t *assigned, Arena &work) {
    const Arena::Scope scope(work);
    const auto n = static_cast<size_t>(stars), m = static_cast<size_t>(centroids);
    auto *sensor = work.take<Vector3>(m);
    auto *is_free = work.take<bool>(m);
    Neighbourhood sky{predicted, icrf,   stars,   uv,       sigma_px,
                      centroids, sensor, is_free, assigned, pixel_rad};
    // How many centroids are in the gate of each star, the last of them, and in how many gates each
    // centroid is.
    auto *choices = work.take<int>(n), *choice = work.take<int>(n), *gates = work.take<int>(m);
    std::fill_n(gates, m, 0);
    std::fill_n(is_free, m, true);
    for (int i = 0; i < stars; ++i) {
        choices[i] = 0;
        for (int j = 0; j < centroids; ++j) {
            if (sky.is_inside(i, j)) {
                ++choices[i];
                choice[i] = j;
                ++gates[j];
            }
        }
    }
    auto *order = work.take<int>(n), *spare = work.take<int>(n);
    int unassigned = 0;
    for (int i = 0; i < stars; ++i) {
        assigned[i] = -1;
        if (choices[i] == 1 && gates[choice[i]] == 1) {
            assigned[i] = choice[i];
            is_free[choice[i]] = false;
        } else {
            order[unassigned++] = i;
        }
    }
    if (unassigned == 0 || stars - unassigned < NEIGHBOURS_IN_GATE) {
        return;
    }
    for (int j = 0; j < centroids; ++j) {
        sensor[j] = unproject(lens, uv[j]);
    }
    auto *misfits = work.take<double>(n);
    // Fewest choices first: each assigned star helps the next. An empty gate leaves all centroids.
    const auto choices_of = [&](int i) { return choices[i] == 0 ? centroids + 1 : choices[i]; };
    sort(order, unassigned, spare, [&](int a, int b) { return choices_of(a) < choices_of(b); });
    for (int k = 0; k < unassigned; ++k) {
        sky.assign(order[k], choices[order[k]] > 0, misfits);
    }
}

}  // namespace st
