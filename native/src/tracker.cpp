// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The order of the stages of a frame, nothing else.

#include "tracker.h"

#include <cmath>

#include "attitude/results.h"
#include "reason.h"

using namespace st;

namespace {

/// Whether a tracker has what whole frames need, and a frame is one that it takes.
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

/// Begin a frame: false for one that is not newer than the one before, which is not used.
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

/// Identify a frame where that is due, or go on with one before.
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

/// Return why there is no attitude, or that it is trusted.
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

/// Track, trust and identify the stars of a frame.
void follow(st_tracker &tracker, int64_t stamp_ns, const st_centroid *centroids, size_t count,
            const double *exposure_s, int32_t windowed, st_result &result) {
    // The state before the frame counts, as where the stages work side by side.
    const st_state state = tracker.tracking->filter.follows() ? ST_TRACKING : ST_LOST;
    const bool due = has_stage(tracker, ST_IDENTIFIES) &&
                     (tracker.frames.is_searching() ||
                      st_identification_is_due(&tracker, stamp_ns, state, windowed) != 0);
    st_track(&tracker, stamp_ns, centroids, count, exposure_s, &result.tracking);
    size_t tracks = 0;
    const st_star_track *first = st_tracks(&tracker, &tracks);
    st_trusted trusted;
    st_trust(&tracker, stamp_ns, first, tracks, &result.tracking.attitude, &trusted);
    result.attitude = trusted.attitude;
    if (due) {
        identify(tracker, stamp_ns, centroids, count, result);
    }
    result.reason = reason_of_result(result, trusted.reason);
    look(stamp_ns, *tracker.sky);
    result.aberration = tracker.sky->observer.aberration;
}

}  // namespace

extern "C" {

st_status st_process_image(st_tracker *tracker, int64_t stamp_ns, const st_image *image,
                           st_result *result) {
    st_status status = check_image(tracker, stamp_ns, image);
    if (status == ST_OK) {
        status = check_whole(*tracker, stamp_ns, nullptr, 0, nullptr, result);
    }
    if (status != ST_OK || !begin(*tracker, stamp_ns, *result)) {
        return status;
    }
    size_t count = 0;
    st_extraction &found = result->extraction;
    const st_prediction *predictions = st_predictions(tracker, &count);
    status = st_extract(tracker, stamp_ns, image, predictions, count,
                        tracker->tracking->filter.stamp_ns(), 1, &found);
    if (status == ST_OK) {
        const double exposure_s[2] = {found.exposure_least_s, found.exposure_most_s};
        const List<st_centroid> &stars = tracker->centroids;
        follow(*tracker, stamp_ns, stars.item, static_cast<size_t>(stars.count), exposure_s,
               found.windowed, *result);
    }
    return status;
}

st_status st_process_centroids(st_tracker *tracker, int64_t stamp_ns, const st_centroid *centroids,
                               size_t count, const double *exposure_s, int32_t windowed,
                               st_result *result) {
    if (tracker == nullptr) {
        return ST_NULL_POINTER;
    }
    const st_status status = check_whole(*tracker, stamp_ns, centroids, count, exposure_s, result);
    if (status == ST_OK && begin(*tracker, stamp_ns, *result)) {
        result->extraction.centroids = static_cast<int32_t>(count);
        result->extraction.windowed = windowed;
        follow(*tracker, stamp_ns, centroids, count, exposure_s, windowed, *result);
    }
    return status;
}

}  // extern "C"
