// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Calls for a tracker that searches images for stars, or the sky for those of a list.

#include <cmath>
#include <cstring>

#include "centroid/spots.h"
#include "tracker.h"

using namespace st;

namespace {

/// Whether predictions are finite, stars first.
bool are_possible(const st_prediction *predictions, size_t count) {
    bool target = false;
    for (size_t i = 0; i < count; ++i) {
        const st_prediction &one = predictions[i];
        if (!std::isfinite(one.u_px) || !std::isfinite(one.v_px) ||
            !std::isfinite(one.u_rate_px_s) || !std::isfinite(one.v_rate_px_s) ||
            !std::isfinite(one.sigma_px) || one.sigma_px < 0 || (target && one.hip != 0)) {
            return false;
        }
        target |= one.hip == 0;
    }
    return true;
}

/// Return a star in the pixels of a camera, where those of the image are cell x cell each.
st_centroid in_camera(st_centroid star, double cell) {
    const double square = cell * cell, shift = (cell - 1) / 2;
    star.u_px = cell * star.u_px + shift;
    star.v_px = cell * star.v_px + shift;
    star.sigma_px *= cell;
    star.cov_uu_px2 *= square;
    star.cov_uv_px2 *= square;
    star.cov_vv_px2 *= square;
    star.common_uu_px2 *= square;
    star.common_uv_px2 *= square;
    star.common_vv_px2 *= square;
    star.delay_s *= cell;
    return star;
}

/// Whether an image is one of the camera of a tracker.
bool is_of_camera(const st_tracker &tracker, const st_image &image) {
    if (image.cell < 1 || image.width_px < 1 || image.height_px < 1 ||
        image.width_px != tracker.width / image.cell ||
        image.height_px != tracker.height / image.cell ||
        (image.type != ST_GREY8 && image.type != ST_GREY16)) {
        return false;
    }
    const int64_t bytes = image.type == ST_GREY16 ? 2 : 1;
    return image.stride_bytes >= bytes * image.width_px && image.stride_bytes % bytes == 0 &&
           reinterpret_cast<uintptr_t>(image.pixels) % static_cast<uintptr_t>(bytes) == 0;
}

}  // namespace

namespace st {

st_status check_pixels(const st_tracker *tracker, const st_image *image) {
    if (tracker == nullptr || image == nullptr || image->pixels == nullptr) {
        return ST_NULL_POINTER;
    }
    if (!has_stage(*tracker, ST_EXTRACTS)) {
        return ST_NO_STAGE;
    }
    return is_of_camera(*tracker, *image) ? ST_OK : ST_BAD_IMAGE;
}

st_status check_image(const st_tracker *tracker, int64_t stamp_ns, const st_image *image) {
    const st_status status = check_pixels(tracker, image);
    if (status != ST_OK) {
        return status;
    }
    return stamp_ns < 0 || !std::isfinite(image->exposure_s) || image->exposure_s < 0
               ? ST_BAD_INPUT
               : ST_OK;
}

Image image_of(const st_image &image, Arena &arena) {
    const int width = image.width_px, height = image.height_px;
    if (image.type == ST_GREY16) {
        return {static_cast<const uint16_t *>(image.pixels), width, height,
                static_cast<ptrdiff_t>(image.stride_bytes / 2), 16};
    }
    auto *copy = arena.take<uint16_t>(static_cast<size_t>(width) * static_cast<size_t>(height));
    for (int v = 0; v < height; ++v) {
        widen_row(static_cast<const uint8_t *>(image.pixels) + v * image.stride_bytes, width,
                  copy + static_cast<ptrdiff_t>(v) * width);
    }
    return {copy, width, height, width, 8};
}

void publish(st_tracker &tracker, const Extraction &found, double cell,
             const ExposureLimits &exposure, bool windowed, st_extraction &extraction) {
    tracker.centroids.clear();
    tracker.rejected.clear();
    List<st_centroid> stars = found.stars;
    if (stars.count > tracker.centroids.capacity) {
        sort_by_flux(stars, tracker.work);
    }
    for (const st_centroid &star : stars) {
        tracker.centroids.add(in_camera(star, cell));
    }
    for (st_rejected one : found.rejections.spots) {
        one.u_px = cell * one.u_px + (cell - 1) / 2;
        one.v_px = cell * one.v_px + (cell - 1) / 2;
        tracker.rejected.add(one);
    }
    const Streak unknown{NAN, NAN, NAN, NAN, NAN};
    const Streak &streak = found.streaked ? found.streak : unknown;
    extraction = {};
    extraction.background_dn = found.background_dn;
    extraction.noise_dn = found.noise_dn;
    extraction.psf_sigma_px = found.psf_sigma_px;
    extraction.exposure_least_s = exposure.least_s;
    extraction.exposure_most_s = exposure.most_s;
    extraction.streak_u_px = streak.u_px;
    extraction.streak_v_px = streak.v_px;
    extraction.streak_roll_rad = streak.roll;
    extraction.streak_at_u_px = streak.u0;
    extraction.streak_at_v_px = streak.v0;
    extraction.centroids = tracker.centroids.count;
    extraction.centroids_left_out = tracker.centroids.left_out;
    extraction.rejected = found.rejections.count();
    extraction.rejected_listed = tracker.rejected.count;
    std::memcpy(extraction.rejected_by_kind, found.rejections.by_kind,
                sizeof(extraction.rejected_by_kind));
    extraction.windowed = windowed ? 1 : 0;
    extraction.reason = found.reason;
}

}  // namespace st

extern "C" {

st_status st_extract(st_tracker *tracker, int64_t stamp_ns, const st_image *image,
                     const st_prediction *predictions, size_t count, int64_t predicted_ns,
                     int32_t lost, st_extraction *extraction) {
    if (extraction == nullptr || (predictions == nullptr && count > 0)) {
        return ST_NULL_POINTER;
    }
    const st_status status = check_image(tracker, stamp_ns, image);
    if (status != ST_OK) {
        return status;
    }
    if (count > static_cast<size_t>(most_predictions(tracker->config))) {
        return ST_TOO_MANY;
    }
    if (predicted_ns < 0 || !are_possible(predictions, count)) {
        return ST_BAD_INPUT;
    }
    const Arena::Scope scope(tracker->work);
    const Extraction &found = tracker->extraction.process(
        stamp_ns, image_of(*image, tracker->work), image->exposure_s,
        {predictions, static_cast<int>(count), predicted_ns, image->cell}, lost != 0,
        tracker->work);
    publish(*tracker, found, image->cell, tracker->extraction.exposure(),
            tracker->extraction.windowed(), *extraction);
    return ST_OK;
}

const st_centroid *st_centroids(const st_tracker *tracker, size_t *count) {
    return tracker == nullptr ? nullptr : listed(tracker->centroids, count);
}

const st_rejected *st_rejections(const st_tracker *tracker, size_t *count) {
    return tracker == nullptr ? nullptr : listed(tracker->rejected, count);
}

st_status st_identify(st_tracker *tracker, int64_t stamp_ns, const st_centroid *centroids,
                      size_t count, double slice_s, const volatile uint32_t *stop,
                      st_identification *identification) {
    if (tracker == nullptr || identification == nullptr || (centroids == nullptr && count > 0)) {
        return ST_NULL_POINTER;
    }
    if (!has_stage(*tracker, ST_IDENTIFIES) || !tracker->identification.has_pairs()) {
        return ST_NO_STAGE;
    }
    if (count > static_cast<size_t>(tracker->identification.most_centroids())) {
        return ST_TOO_MANY;
    }
    if (stamp_ns < 0 || !(slice_s > 0)) {
        return ST_BAD_INPUT;
    }
    const Arena::Scope scope(tracker->work);
    tracker->was_identified = true;
    tracker->identified_ns = stamp_ns;
    tracker->frames.begin(stamp_ns, centroids, static_cast<int>(count), tracker->identification,
                          tracker->work);
    return st_identify_on(tracker, slice_s, stop, identification);
}

st_status st_identify_on(st_tracker *tracker, double slice_s, const volatile uint32_t *stop,
                         st_identification *identification) {
    if (tracker == nullptr || identification == nullptr) {
        return ST_NULL_POINTER;
    }
    if (!has_stage(*tracker, ST_IDENTIFIES)) {
        return ST_NO_STAGE;
    }
    if (!(slice_s > 0) || !tracker->frames.is_searching()) {
        return ST_BAD_INPUT;
    }
    const Arena::Scope scope(tracker->work);
    tracker->frames.proceed(slice_s, stop, tracker->identification, tracker->sky, *identification,
                            tracker->identified, tracker->work);
    return ST_OK;
}

const st_identified *st_identified_stars(const st_tracker *tracker, size_t *count) {
    return tracker == nullptr ? nullptr : listed(tracker->identified, count);
}

const st_centroid *st_searched_centroids(const st_tracker *tracker, size_t *count) {
    return tracker == nullptr ? nullptr : listed(tracker->frames.centroids(), count);
}

}  // extern "C"
