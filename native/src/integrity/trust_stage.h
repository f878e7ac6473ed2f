// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The stage behind st_trust() and st_trust_stars(): which attitude is published.

#pragma once

#include "integrity/validation.h"
#include "sky/apparent.h"

namespace st {

class TrustStage {
public:
    AttitudeValidator validator;

    TrustStage() = default;
    TrustStage(const st_config &config, const Lens &lens, ApparentSky &sky, int stars,
               Arena &arena)
        : validator(lens, config.trust),
          lens_(lens),
          sky_(&sky),
          residuals_(arena.list<double>(static_cast<size_t>(stars))) {}

    /// Return the attitude of the star tracker if the tracks it comes with fit it; solved from the
    /// tracks where tracked is null.
    st_trusted from_tracks(int64_t stamp_ns, const st_star_track *tracks, int count,
                           const st_attitude *tracked, Arena &arena);

    /// Return the attitude solved from one identified frame.
    st_trusted from_stars(int64_t stamp_ns, const st_centroid *centroids,
                          const st_identified *identified, int count, Arena &arena);

    /// Return the angles, rad, between the stars of the last attitude and the catalogue.
    const List<double> &residuals() const { return residuals_; }

private:
    ObserverError observer_error() const;
    KnownStar known(int32_t star, const Point &uv, const Covariance2 &error) const;
    st_trusted filled(int64_t stamp_ns, const TrustedAttitude &found, const st_attitude *tracked);

    Lens lens_{};
    ApparentSky *sky_ = nullptr;
    List<double> residuals_;
};

/// Bytes of work memory of so many stars.
size_t trust_work_bytes(int count);

}  // namespace st
