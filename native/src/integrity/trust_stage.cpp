// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "integrity/trust_stage.h"

#include <algorithm>

#include "attitude/pointing.h"
#include "attitude/results.h"
#include "integrity/checks.h"

namespace st {
namespace {

bool is_usable(const st_star_track &track) {
    return track.hip > 0 && track.missed == 0;
}

}  // namespace

size_t trust_work_bytes(int count) {
    const auto n = static_cast<size_t>(count);
    return std::max(Arena::padded<KnownStar>(n), Arena::padded<TrackedStar>(n)) +
           validation_bytes(count);
}

ObserverError TrustStage::observer_error() const {
    return {sky_->observer.velocity_sigma_m_s, sky_->observer.epoch_sigma_years};
}

KnownStar TrustStage::known(int32_t star, const Point &uv, const Covariance2 &error) const {
    const float *motion = sky_->file->motion[star];
    return {uv,
            error,
            apparent_direction(*sky_, star),
            {{static_cast<double>(motion[0]), static_cast<double>(motion[1]),
              static_cast<double>(motion[2])}}};
}

/// Return an attitude that was checked, or the reason why it is not trusted; the motion is that of
/// the star tracker, null for unknown.
st_trusted TrustStage::filled(int64_t stamp_ns, const TrustedAttitude &found,
                              const st_attitude *tracked) {
    residuals_.clear();
    st_trusted trusted;
    trusted.reason = found.reason;
    set_unknown(trusted.attitude);
    st_attitude &attitude = trusted.attitude;
    if (found.reason.code != ST_REASON_TRUSTED) {
        return trusted;
    }
    residuals_.count = found.stars;
    if (tracked != nullptr) {
        attitude = *tracked;
    }
    attitude.valid = 1;
    attitude.stamp_ns = stamp_ns;
    attitude.stars = found.stars;
    attitude.chi2 = found.chi2;
    attitude.residual_px = found.residual_px;
    set(found.quaternion, attitude.quaternion);
    set(found.covariance, attitude.covariance_rad2);
    set(found.protection_rad, attitude.protection_rad);
    return trusted;
}

st_trusted TrustStage::from_tracks(int64_t stamp_ns, const st_star_track *tracks, int count,
                                   const st_attitude *tracked, Arena &arena) {
    TrustedAttitude found{};
    found.reason = reason_of(ST_REASON_NOT_TRACKED, {});
    if (tracked != nullptr && tracked->valid == 0) {
        return filled(stamp_ns, found, tracked);
    }
    look(stamp_ns, *sky_);
    const auto most = static_cast<size_t>(count);
    auto *known = arena.take<KnownStar>(tracked == nullptr ? most : 0);
    auto *followed = arena.take<TrackedStar>(tracked == nullptr ? 0 : most);
    int stars = 0;
    for (int n = 0; n < count; ++n) {
        const st_star_track &one = tracks[n];
        const int32_t star = is_usable(one) ? star_of_hip(*sky_, one.hip) : -1;
        if (star < 0) {
            continue;
        }
        const Point uv{one.u_px, one.v_px};
        if (tracked == nullptr) {
            known[stars++] =
                this->known(star, uv, {one.cov_uu_px2, one.cov_uv_px2, one.cov_vv_px2});
        } else {
            followed[stars++] = {uv, apparent_direction(*sky_, star), one.sigma_px,
                                 one.residual_px};
        }
    }
    found = tracked == nullptr
                ? validator.solve(known, stars, observer_error(), residuals_.item, arena)
                : validator.check(quaternion_of(tracked->quaternion),
                                  matrix_of(tracked->covariance_rad2), tracked->chi2, followed,
                                  stars, residuals_.item, arena);
    return filled(stamp_ns, found, tracked);
}

st_trusted TrustStage::from_stars(int64_t stamp_ns, const st_centroid *centroids,
                                  const st_identified *identified, int count, Arena &arena) {
    look(stamp_ns, *sky_);
    auto *known = arena.take<KnownStar>(static_cast<size_t>(count));
    int stars = 0;
    for (int n = 0; n < count; ++n) {
        const st_centroid &one = centroids[n];
        const int32_t star = identified[n].hip > 0 ? star_of_hip(*sky_, identified[n].hip) : -1;
        if (star >= 0) {
            known[stars++] = this->known(star, {one.u_px, one.v_px},
                                         {one.cov_uu_px2, one.cov_uv_px2, one.cov_vv_px2});
        }
    }
    TrustedAttitude found =
        validator.solve(known, stars, observer_error(), residuals_.item, arena);
    Covariance2 correlated;
    if (found.reason.code == ST_REASON_TRUSTED && correlated_error(centroids, count, correlated)) {
        if (is_finite(correlated)) {
            found.covariance = found.covariance + pointing_covariance(lens_, correlated, nullptr);
        } else {
            found.reason = reason_of(ST_REASON_STARS_NOT_FINITE, {});
        }
    }
    return filled(stamp_ns, found, nullptr);
}

}  // namespace st
