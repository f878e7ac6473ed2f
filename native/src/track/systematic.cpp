// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "track/systematic.h"

#include "attitude/pointing.h"
#include "attitude/results.h"
#include "integrity/systematic_errors.h"

namespace st {

size_t lasting_errors_bytes(int tracks) {
    const auto count = static_cast<size_t>(tracks);
    return 2 * Arena::padded<Vector3>(count) + Arena::padded<double>(count);
}

void add_lasting_errors(const Lens &lens, const TrackList &bank, const SkyFile &sky,
                        const LastingErrors &errors, const st_observer *observer,
                        const Quaternion &attitude, st_budget &budget, Arena &arena) {
    const Vector3 &turn = errors.stamp_turn_rad;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            budget.stamps[i][j] = turn[i] * turn[j];
        }
    }
    const double velocity_sigma = observer == nullptr ? 0.0 : observer->velocity_sigma_m_s;
    const double epoch_sigma = observer == nullptr ? 0.0 : observer->epoch_sigma_years;
    if (velocity_sigma == 0 && epoch_sigma == 0 && errors.lens_error_px == 0 &&
        errors.lens_scale == 0) {
        return;
    }
    const Arena::Scope scope(arena);
    const auto most = static_cast<size_t>(bank.count);
    auto *sensor = arena.take<Vector3>(most), *motion = arena.take<Vector3>(most);
    auto *sigma_rad = arena.take<double>(most);
    const double pixel_rad = pixel_angle(lens);
    int count = 0;
    for (const Track &track : bank) {
        if (track.is_detected()) {
            sensor[count] = unproject(lens, track.uv());
            sigma_rad[count] = pixel_rad * std::sqrt(track.variance);
            for (int axis = 0; axis < 3; ++axis) {
                motion[count][axis] = static_cast<double>(sky.motion[track.star][axis]);
            }
            ++count;
        }
    }
    const FittedStars stars{count, sensor, sigma_rad, motion};
    if (velocity_sigma > 0) {
        set(velocity_covariance(velocity_sigma, stars), budget.observer);
    }
    if (errors.lens_error_px > 0 || errors.lens_scale != 0) {
        set(lens_covariance(pixel_rad * errors.lens_error_px, errors.lens_scale, stars),
            budget.lens);
    }
    if (epoch_sigma != 0) {
        set(epoch_covariance(attitude, epoch_sigma, stars), budget.epoch);
    }
}

}  // namespace st
