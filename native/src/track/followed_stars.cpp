// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "track/followed_stars.h"

#include <cmath>

namespace st {

void detected_stars(const Lens &lens, const Quaternion &attitude, const Vector3 &rate_rad_s,
                    const TrackList &bank, const Vector3 *icrf, const double *distance,
                    const int32_t *best, const Places &centroids, List<DetectedStar> &detected) {
    const Matrix3 R = matrix_from_quaternion(attitude);
    for (int n = 0; n < bank.count; ++n) {
        const Track &track = bank[n];
        if (!(track.confirmed && std::isfinite(distance[n]))) {
            continue;
        }
        const Point uv = centroids.uv[best[n]];
        const Flow J = flow_of(lens, sensor_direction(R, icrf[n]));
        detected.add({n,
                      uv,
                      {uv.x - track.state[0], uv.y - track.state[2]},
                      centroids.error[best[n]],
                      J,
                      velocity_of(J, rate_rad_s)});
    }
}

}  // namespace st
