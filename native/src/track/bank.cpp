// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "track/bank.h"

#include <algorithm>
#include <cmath>

namespace st {
namespace {

constexpr int MOST_AGE = 65535;

}  // namespace

Track started_track(uint32_t track_id, int32_t star, const st_centroid &centroid, double variance,
                    bool confirmed) {
    Track track{};
    track.state = {{centroid.u_px, 0.0, centroid.v_px, 0.0}};
    track.covariance[0][0] = track.covariance[2][2] = track.variance = variance;
    track.flux_dn = centroid.flux_dn;
    track.snr = centroid.snr;
    track.sigma_px = centroid.sigma_px;
    track.residual_px = NAN;
    track.probability = 1.0;
    track.track_id = track_id;
    track.star = star;
    track.confirmed = confirmed;
    return track;
}

void select(TrackList &bank, const bool *kept) {
    int count = 0;
    for (int n = 0; n < bank.count; ++n) {
        if (kept[n]) {
            if (count < n) {
                bank[count] = bank[n];
            }
            ++count;
        }
    }
    bank.count = count;
}

bool has_star(const TrackList &bank, int32_t star) {
    return std::any_of(bank.begin(), bank.end(),
                       [&](const Track &track) { return track.star == star; });
}

void follow(Track &track, const Association &association, int n, const Point &predicted,
            const Point *uv, const st_centroid *centroids, const double *variance) {
    miss(track);
    const Pairing *best = association.best(n);
    if (best == nullptr) {
        return;
    }
    track.probability = best->value;
    if (association.is_missed(n)) {
        return;
    }
    const st_centroid &centroid = centroids[best->centroid];
    track.missed = 0;
    track.variance = variance[best->centroid];
    track.flux_dn = centroid.flux_dn;
    track.snr = centroid.snr;
    track.sigma_px = centroid.sigma_px;
    track.residual_px =
        std::hypot(uv[best->centroid].x - predicted.x, uv[best->centroid].y - predicted.y);
}

void miss(Track &track) {
    ++track.age;
    ++track.missed;
    track.flux_dn = track.snr = track.sigma_px = track.residual_px = NAN;
    track.probability = 0.0;
}

bool is_kept(const Track &track, bool crowded, double most_missed) {
    return !crowded &&
           (track.confirmed ? track.missed <= most_missed : track.missed <= track.age / 2);
}

void confirm(Track &track, int confirm_frames) {
    track.confirmed = track.confirmed || (track.missed == 0 && track.age >= confirm_frames);
}

int publish(const TrackList &bank, const SkyFile &file, bool identified, st_star_track *tracks,
            int capacity) {
    const int count = std::min(bank.count, capacity);
    for (int n = 0; n < count; ++n) {
        const Track &track = bank[n];
        const bool is_known = identified && track.confirmed;
        const Covariance2 P = track.uv_covariance();
        st_star_track &to = tracks[n];
        to.u_px = track.state[0];
        to.v_px = track.state[2];
        to.u_rate_px_s = track.state[1];
        to.v_rate_px_s = track.state[3];
        to.cov_uu_px2 = P.uu;
        to.cov_uv_px2 = P.uv;
        to.cov_vv_px2 = P.vv;
        to.magnitude = is_known ? file.magnitude[track.star] : NAN;
        to.flux_dn = track.flux_dn;
        to.snr = track.snr;
        to.sigma_px = track.sigma_px;
        to.residual_px = track.residual_px;
        to.distance_px = NAN;
        to.association_probability = track.probability;
        to.hip = is_known ? file.hip[track.star] : 0;
        to.track_id = track.track_id;
        to.age = std::min(track.age, MOST_AGE);
        to.missed = track.missed;
    }
    return count;
}

}  // namespace st
