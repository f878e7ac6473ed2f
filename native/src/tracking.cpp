// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Calls for a tracker that tracks stars, or trusts attitudes of them.

#include <cmath>

#include "attitude/attitude_at.h"
#include "tracker.h"

using namespace st;

namespace {

template <class T>
bool are_finite(const T *values, size_t count) {
    for (size_t i = 0; i < count; ++i) {
        if (!std::isfinite(values[i])) {
            return false;
        }
    }
    return true;
}

bool is_exposure(const double *exposure_s) {
    return exposure_s == nullptr || (exposure_s[0] >= 0 && exposure_s[1] >= exposure_s[0]);
}

bool is_hint(const st_hint &hint) {
    double square = 0.0;
    for (const double element : hint.quaternion) {
        square += element * element;
    }
    return hint.stamp_ns >= 0 && std::fabs(square - 1) < 1e-3 &&
           are_finite(&hint.covariance_rad2[0][0], 9) && are_finite(hint.rate_rad_s, 3) &&
           are_finite(&hint.rate_covariance[0][0], 9);
}

constexpr double SPEED_OF_LIGHT_M_S = 299792458.0;

bool is_body(const st_body &body) {
    return are_finite(body.direction, 3) && body.error_rad >= 0 && body.radius_rad >= 0 &&
           std::isfinite(body.error_rad + body.radius_rad) && !std::isnan(body.magnitude);
}

bool is_observer(const st_observer &observer) {
    double square = 0.0;
    for (const double component : observer.velocity_m_s) {
        square += component * component;
    }
    if (!(square < SPEED_OF_LIGHT_M_S * SPEED_OF_LIGHT_M_S / 4) ||
        !(observer.velocity_sigma_m_s >= 0 && observer.velocity_sigma_m_s < SPEED_OF_LIGHT_M_S) ||
        !(observer.epoch_sigma_years >= 0 && observer.epoch_sigma_years < 1e4) ||
        !(observer.max_age_s >= 0) || observer.body_count < 0 ||
        observer.body_count > ST_MOST_BODIES || observer.aberration < ST_ABERRATION_NONE ||
        observer.aberration > ST_ABERRATION_FULL || !are_finite(observer.zenith, 3) ||
        !std::isfinite(observer.refraction_a_rad + observer.refraction_b_rad)) {
        return false;
    }
    for (int k = 0; k < observer.body_count; ++k) {
        if (!is_body(observer.body[k])) {
            return false;
        }
    }
    return true;
}

}  // namespace

namespace st {

st_status check_frame(const st_tracker &tracker, int32_t stage, int64_t stamp_ns,
                      const st_centroid *centroids, size_t count, const double *exposure_s) {
    if (centroids == nullptr && count > 0) {
        return ST_NULL_POINTER;
    }
    if (!has_stage(tracker, stage)) {
        return ST_NO_STAGE;
    }
    if (count > static_cast<size_t>(most_centroids(tracker.config))) {
        return ST_TOO_MANY;
    }
    return stamp_ns < 0 || !is_exposure(exposure_s) ? ST_BAD_INPUT : ST_OK;
}

}  // namespace st

extern "C" {

st_status st_add_rate(st_tracker *tracker, int64_t stamp_ns, const double rate_rad_s[3]) {
    if (tracker == nullptr || rate_rad_s == nullptr) {
        return ST_NULL_POINTER;
    }
    if (tracker->tracking == nullptr) {
        return ST_NO_STAGE;
    }
    if (stamp_ns < 0 || !are_finite(rate_rad_s, 3)) {
        return ST_BAD_INPUT;
    }
    Gyro &gyro = tracker->tracking->filter.gyro;
    if (gyro.silent_s(stamp_ns) < 0) {
        return ST_NOT_NEWER;
    }
    gyro.add(stamp_ns, {{rate_rad_s[0], rate_rad_s[1], rate_rad_s[2]}});
    return ST_OK;
}

st_status st_add_observer(st_tracker *tracker, int64_t stamp_ns, const st_observer *observer) {
    if (tracker == nullptr || observer == nullptr) {
        return ST_NULL_POINTER;
    }
    if (tracker->sky == nullptr) {
        return ST_NO_STAGE;
    }
    if (stamp_ns < 0 || !is_observer(*observer)) {
        return ST_BAD_INPUT;
    }
    add_observer(stamp_ns, *observer, *tracker->sky);
    return ST_OK;
}

st_status st_add_hint(st_tracker *tracker, const st_hint *hint) {
    if (tracker == nullptr || hint == nullptr) {
        return ST_NULL_POINTER;
    }
    if (tracker->tracking == nullptr) {
        return ST_NO_STAGE;
    }
    if (!is_hint(*hint)) {
        return ST_BAD_INPUT;
    }
    add_hint(*hint, tracker->tracking->filter.hints);
    return ST_OK;
}

st_status st_attitude_at(const st_attitude *attitude, int64_t stamp_ns, st_attitude *at) {
    if (attitude == nullptr || at == nullptr) {
        return ST_NULL_POINTER;
    }
    if (stamp_ns < 0 || attitude->valid == 0) {
        return ST_BAD_INPUT;
    }
    *at = attitude_at(*attitude, stamp_ns);
    return ST_OK;
}

int32_t st_identification_is_due(const st_tracker *tracker, int64_t stamp_ns, st_state state,
                                 int32_t windowed) {
    if (tracker == nullptr || state != ST_TRACKING) {
        return 1;
    }
    // What the tracking predicted is not a check of it.
    const double period_s = tracker->config.identification.check_period_s;
    if (period_s == 0 || windowed != 0) {
        return 0;
    }
    const double since_s =
        std::fabs(static_cast<double>(stamp_ns - tracker->identified_ns)) * 1e-9;
    return !tracker->was_identified || since_s >= period_s ? 1 : 0;
}

st_status st_track(st_tracker *tracker, int64_t stamp_ns, const st_centroid *centroids,
                   size_t count, const double *exposure_s, st_tracking *tracking) {
    if (tracker == nullptr || tracking == nullptr) {
        return ST_NULL_POINTER;
    }
    const st_status status =
        check_frame(*tracker, ST_TRACKS, stamp_ns, centroids, count, exposure_s);
    if (status != ST_OK) {
        return status;
    }
    const double any_s[2] = {0.0, INFINITY};
    const Arena::Scope scope(tracker->work);
    const bool is_newer = tracker->tracking->filter.update(
        stamp_ns, centroids, static_cast<int>(count), exposure_s == nullptr ? any_s : exposure_s,
        tracker->work);
    tracker->tracking->publish(*tracking, tracker->work);
    return is_newer ? ST_OK : ST_NOT_NEWER;
}

st_status st_prepare(st_tracker *tracker) {
    if (tracker == nullptr) {
        return ST_NULL_POINTER;
    }
    if (tracker->tracking == nullptr) {
        return ST_NO_STAGE;
    }
    const Arena::Scope scope(tracker->work);
    tracker->tracking->filter.acquire_new_stars(tracker->work);
    return ST_OK;
}

st_status st_add_identification(st_tracker *tracker, int64_t stamp_ns,
                                const st_centroid *centroids, const st_identified *identified,
                                size_t count, st_tracking *tracking) {
    if (tracker == nullptr || tracking == nullptr || (identified == nullptr && count > 0)) {
        return ST_NULL_POINTER;
    }
    const st_status status = check_frame(*tracker, ST_TRACKS, stamp_ns, centroids, count, nullptr);
    if (status != ST_OK) {
        return status;
    }
    tracker->was_identified = true;
    tracker->identified_ns = stamp_ns;
    const Arena::Scope scope(tracker->work);
    tracker->tracking->filter.identified(stamp_ns, centroids, identified, static_cast<int>(count),
                                         tracker->work);
    tracker->tracking->publish(*tracking, tracker->work);
    return ST_OK;
}

st_status st_known(st_tracker *tracker, st_tracking *tracking) {
    if (tracker == nullptr || tracking == nullptr) {
        return ST_NULL_POINTER;
    }
    if (tracker->tracking == nullptr) {
        return ST_NO_STAGE;
    }
    const Arena::Scope scope(tracker->work);
    tracker->tracking->publish(*tracking, tracker->work);
    return ST_OK;
}

const st_star_track *st_tracks(const st_tracker *tracker, size_t *count) {
    return tracker == nullptr || tracker->tracking == nullptr
               ? nullptr
               : listed(tracker->tracking->tracks(), count);
}

const st_prediction *st_predictions(st_tracker *tracker, size_t *count) {
    const List<st_prediction> *found = tracker == nullptr || tracker->tracking == nullptr
                                           ? nullptr
                                           : tracker->tracking->predictions();
    return found == nullptr ? nullptr : listed(*found, count);
}

st_status st_trust(st_tracker *tracker, int64_t stamp_ns, const st_star_track *tracks,
                   size_t count, const st_attitude *tracked, st_trusted *trusted) {
    if (tracker == nullptr || trusted == nullptr || (tracks == nullptr && count > 0)) {
        return ST_NULL_POINTER;
    }
    if (tracker->trust == nullptr) {
        return ST_NO_STAGE;
    }
    if (count > static_cast<size_t>(most_trusted(tracker->config))) {
        return ST_TOO_MANY;
    }
    if (stamp_ns < 0) {
        return ST_BAD_INPUT;
    }
    const Arena::Scope scope(tracker->work);
    *trusted = tracker->trust->from_tracks(stamp_ns, tracks, static_cast<int>(count), tracked,
                                           tracker->work);
    return ST_OK;
}

const double *st_residuals(const st_tracker *tracker, size_t *count) {
    return tracker == nullptr || tracker->trust == nullptr
               ? nullptr
               : listed(tracker->trust->residuals(), count);
}

st_status st_trust_stars(st_tracker *tracker, int64_t stamp_ns, const st_centroid *centroids,
                         const st_identified *identified, size_t count, st_trusted *trusted) {
    if (tracker == nullptr || trusted == nullptr || (identified == nullptr && count > 0)) {
        return ST_NULL_POINTER;
    }
    const st_status status = check_frame(*tracker, ST_TRUSTS, stamp_ns, centroids, count, nullptr);
    if (status != ST_OK) {
        return status;
    }
    const Arena::Scope scope(tracker->work);
    *trusted = tracker->trust->from_stars(stamp_ns, centroids, identified, static_cast<int>(count),
                                          tracker->work);
    return ST_OK;
}

}  // extern "C"
