// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// What whole frames need in addition to the stages: whether one is used, and what is known after
// it.

#include <cmath>

#include "attitude/results.h"
#include "reason.h"
#include "tracker.h"

namespace st {
namespace {

void clear(int64_t stamp_ns, st_result &result) {
    result = {};
    result.stamp_ns = stamp_ns;
    set_unknown(result.attitude);
    set_unknown(result.identification.attitude);
    st_extraction &found = result.extraction;
    found.background_dn = found.noise_dn = found.psf_sigma_px = NAN;
    found.streak_u_px = found.streak_v_px = found.streak_roll_rad = NAN;
    found.streak_at_u_px = found.streak_at_v_px = NAN;
    found.exposure_most_s = INFINITY;
}

}  // namespace

st_status check_whole(const st_tracker &tracker, int64_t stamp_ns, const st_centroid *centroids,
                      size_t count, const double *exposure_s, const st_result *result) {
    if (result == nullptr) {
        return ST_NULL_POINTER;
    }
    const bool identifies = has_stage(tracker, ST_IDENTIFIES);
    if (!has_stage(tracker, ST_TRUSTS) || (identifies && !tracker.identification.has_pairs())) {
        return ST_NO_STAGE;
    }
    return check_frame(tracker, ST_TRACKS, stamp_ns, centroids, count, exposure_s);
}

bool begin(st_tracker &tracker, int64_t stamp_ns, st_result &result) {
    clear(stamp_ns, result);
    const TrackFilter &filter = tracker.tracking->filter;
    const Order order = filter.order(stamp_ns);
    if (order == Order::LATE) {
        const auto late_ns = static_cast<double>(filter.stamp_ns() - stamp_ns);
        result.reason =
            reason_of(stamp_ns > 0 ? ST_REASON_NOT_NEWER : ST_REASON_NOT_STAMPED, {late_ns});
        st_track(&tracker, stamp_ns, nullptr, 0, nullptr, &result.tracking);
        return false;
    }
    if (order == Order::BACK) {
        st_reset(&tracker);
    }
    result.used = 1;
    return true;
}

void identify(st_tracker &tracker, int64_t stamp_ns, const st_centroid *centroids, size_t count,
              st_result &result) {
    st_identification &found = result.identification;
    const double given_s = tracker.config.identification.slice_s;
    const double slice_s = given_s > 0 ? given_s : INFINITY;
    if (tracker.frames.is_searching()) {
        st_identify_on(&tracker, slice_s, nullptr, &found);
    } else {
        st_identify(&tracker, stamp_ns, centroids, count, slice_s, nullptr, &found);
    }
    if (found.status == ST_SEARCHING) {
        return;
    }
    const List<st_centroid> &seen = tracker.frames.centroids();
    const Arena::Scope scope(tracker.work);
    tracker.tracking->filter.identified(tracker.frames.stamp_ns(), seen.item,
                                        tracker.identified.item, tracker.identified.count,
                                        tracker.work);
    tracker.tracking->publish_state(result.tracking);
}

st_reason reason_of_result(const st_result &result, const st_reason &trust) {
    const st_tracking &known = result.tracking;
    if (known.attitude.valid != 0) {
        return trust;
    }
    for (const st_reason &why : {result.extraction.reason, known.contradiction}) {
        if (why.code != ST_NO_REASON) {
            return why;
        }
    }
    return known.reason;
}

}  // namespace st
