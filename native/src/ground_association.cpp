// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The filter of single stars of startracker_ground.h.

#include <algorithm>
#include <cmath>

#include "startracker_ground.h"
#include "track/jpdaf.h"

using namespace st;

namespace {

constexpr size_t MOST = 65536;  // of tracks and of centroids

/// Return the bytes of an association, of the places of tracks and centroids, and of the work.
size_t bytes_for(int tracks, int centroids) {
    const auto n = static_cast<size_t>(tracks), m = static_cast<size_t>(centroids);
    return association_bytes(tracks, centroids) + Arena::padded<Point>(n) +
           Arena::padded<Covariance2>(n) + Arena::padded<Covariance2>(m) +
           std::max(association_work_bytes(tracks, centroids),
                    associate_stars_bytes(tracks, centroids));
}

bool is_possible(const st_detection &given) {
    return given.gate > 0 && given.gate_probability >= 0 && given.detection_probability >= 0 &&
           given.gate_probability * given.detection_probability < 1 && given.image_px2 > 0 &&
           given.clutter_px2 >= 0 && given.association >= 0 &&
           given.association < ST_ASSOCIATION_COUNT;
}

}  // namespace

extern "C" {

st_status st_cycle_size(size_t tracks, size_t centroids, size_t *bytes) {
    if (bytes == nullptr) {
        return ST_NULL_POINTER;
    }
    if (tracks > MOST || centroids > MOST) {
        return ST_TOO_MANY;
    }
    *bytes = bytes_for(static_cast<int>(tracks), static_cast<int>(centroids));
    return ST_OK;
}

st_status st_cycle(void *memory, size_t bytes, const st_detection *detection,
                   const double transition[16], const double noise[16], double *state,
                   double *covariance, size_t tracks, const double *uv, const double *variance,
                   size_t centroids, double *probability) {
    size_t needed = 0;
    if (const st_status status = st_cycle_size(tracks, centroids, &needed); status != ST_OK) {
        return status;
    }
    if (memory == nullptr || detection == nullptr || transition == nullptr || noise == nullptr ||
        (tracks > 0 && (state == nullptr || covariance == nullptr)) ||
        (centroids > 0 && (uv == nullptr || variance == nullptr))) {
        return ST_NULL_POINTER;
    }
    if (reinterpret_cast<uintptr_t>(memory) % ALIGNMENT != 0) {
        return ST_MISALIGNED;
    }
    if (bytes < needed) {
        return ST_TOO_LITTLE_MEMORY;
    }
    if (!is_possible(*detection)) {
        return ST_BAD_INPUT;
    }
    Arena arena(memory, bytes);
    const auto count = static_cast<int>(tracks), most = static_cast<int>(centroids);
    auto *x = reinterpret_cast<StarState *>(state);
    auto *P = reinterpret_cast<StarCovariance *>(covariance);
    const auto *F = reinterpret_cast<const Matrix<4, 4> *>(transition);
    const auto *Q = reinterpret_cast<const Matrix<4, 4> *>(noise);
    const auto *place = reinterpret_cast<const Point *>(uv);
    auto *predicted = arena.take<Point>(tracks);
    auto *error = arena.take<Covariance2>(tracks);
    for (int n = 0; n < count; ++n) {
        predict(*F, *Q, x[n], P[n]);
        predicted[n] = {x[n][0], x[n][2]};
        error[n] = {P[n][0][0], P[n][0][2], P[n][2][2]};
    }
    auto *of_centroid = arena.take<Covariance2>(centroids);
    std::transform(variance, variance + centroids, of_centroid, round_error);
    Association found = association_for(count, most, arena);
    const Places stars{count, predicted, error}, frame{most, place, of_centroid};
    const DetectionModel model{detection->gate, detection->gate_probability,
                               detection->detection_probability, detection->image_px2};
    if (detection->clutter_px2 > 0) {
        gate_centroids(stars, frame, model.gate, found, arena);
        weigh_events(model, detection->clutter_px2, found);
        marginalise(found, MAX_STEPS, arena);
    } else {
        associate_stars(stars, frame, model, static_cast<st_association>(detection->association),
                        nullptr, found, arena);
    }
    for (int n = 0; n < count; ++n) {
        update(found, n, place, variance, x[n], P[n]);
        if (probability == nullptr) {
            continue;
        }
        double *row = probability + static_cast<size_t>(n) * (centroids + 1);
        std::fill_n(row, centroids + 1, 0.0);
        row[0] = found.missed[n];
        for (const Pairing *one = found.begin(n); one < found.end(n); ++one) {
            row[1 + one->centroid] = one->value;
        }
    }
    return ST_OK;
}

}  // extern "C"
