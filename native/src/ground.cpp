// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Calls of startracker_ground.h: steps of the extraction by themselves.

#include <cmath>
#include <cstring>

#include "centroid/highest_peaks.h"
#include "centroid/spots.h"
#include "startracker_ground.h"
#include "tracker.h"

using namespace st;

namespace {

constexpr int WIDTH_ITERATIONS = 4;

constexpr double FARTHEST_PX = 65536.0;  // of the place of a star, the largest side of an image

/// What a searched image leaves, in the memory of the caller: Searched, then level and noise of its
/// mesh. Where these are is not stored, so that a copy is as good.
class SearchedBlock {
public:
    static size_t bytes(int width, int height) {
        return Arena::padded<Searched>(1) + 2 * Arena::padded<double>(most_tiles(width, height));
    }

    static bool is_possible(const void *block) {
        return reinterpret_cast<uintptr_t>(block) % ALIGNMENT == 0;
    }

    static Searched load(void *block, int width, int height) {
        Searched searched;
        std::memcpy(&searched, block, sizeof(Searched));
        set_places(searched, block, width, height);
        return searched;
    }

    static Searched empty(void *block, int width, int height) {
        Searched searched;
        set_places(searched, block, width, height);
        return searched;
    }

    static void store(Searched searched, void *block) {
        searched.mesh.level = searched.mesh.noise = nullptr;
        std::memcpy(block, &searched, sizeof(Searched));
    }

private:
    static void set_places(Searched &searched, void *block, int width, int height) {
        Arena arena(block, bytes(width, height));
        arena.take<Searched>(1);
        searched.mesh.level = arena.take<double>(most_tiles(width, height));
        searched.mesh.noise = arena.take<double>(most_tiles(width, height));
    }
};

/// As check_pixels(), of an image whose pixels are those of the camera, not sums of them.
st_status check(const st_tracker *tracker, const st_image *image) {
    const st_status status = check_pixels(tracker, image);
    return status == ST_OK && image->cell != 1 ? ST_BAD_IMAGE : status;
}

bool is_finite(const st_streak &streak) {
    return std::isfinite(streak.u_px) && std::isfinite(streak.v_px) &&
           std::isfinite(streak.roll_rad) && std::isfinite(streak.at_u_px) &&
           std::isfinite(streak.at_v_px);
}

/// Return the streak of a caller, which may be null: then there is none.
Streak streak_of(const st_streak *given) {
    return given == nullptr
               ? Streak{}
               : Streak{given->u_px, given->v_px, given->roll_rad, given->at_u_px, given->at_v_px};
}

Extraction empty_result(st_tracker &tracker) {
    return empty_extraction(limits_of(tracker.config, tracker.width, tracker.height),
                            tracker.work);
}

/// Fill the lists of a tracker and the result with what a call found by itself.
void publish_alone(st_tracker &tracker, const Extraction &found, st_extraction &extraction) {
    publish(tracker, found, 1.0, {0.0, INFINITY}, false, extraction);
}

}  // namespace

extern "C" {

st_status st_searched_size(const st_tracker *tracker, size_t *bytes) {
    if (tracker == nullptr || bytes == nullptr) {
        return ST_NULL_POINTER;
    }
    if (!has_stage(*tracker, ST_EXTRACTS)) {
        return ST_NO_STAGE;
    }
    *bytes = SearchedBlock::bytes(tracker->width, tracker->height);
    return ST_OK;
}

st_status st_search(st_tracker *tracker, const st_image *image, const st_search_options *options,
                    const st_streak *streak, const void *before, void *after, int32_t *kept,
                    st_extraction *extraction) {
    const st_status status = check(tracker, image);
    if (status != ST_OK) {
        return status;
    }
    if (options == nullptr || after == nullptr || kept == nullptr || extraction == nullptr) {
        return ST_NULL_POINTER;
    }
    if (!SearchedBlock::is_possible(before) || !SearchedBlock::is_possible(after)) {
        return ST_MISALIGNED;
    }
    if (options->most_stars < 0 || !(options->threshold_factor > 0) ||
        (streak != nullptr && !is_finite(*streak))) {
        return ST_BAD_INPUT;
    }
    const int width = tracker->width, height = tracker->height;
    const Arena::Scope scope(tracker->work);
    Arena &work = tracker->work;
    // A copy: before and after may be the same memory.
    const size_t bytes = SearchedBlock::bytes(width, height);
    auto *copy = work.take<std::byte>(bytes);
    Searched known;
    if (before != nullptr) {
        std::memcpy(copy, before, bytes);
        known = SearchedBlock::load(copy, width, height);
    }
    Searched left = SearchedBlock::empty(after, width, height);
    Extraction found = empty_result(*tracker);
    const Streak motion = streak_of(streak);
    const SearchHow how{options->most_stars, options->points_only != 0, options->narrow != 0};
    const Extractor extractor(tracker->config.extraction,
                              limits_of(tracker->config, width, height),
                              options->threshold_factor);
    *kept = extractor.search(image_of(*image, work), streak == nullptr ? nullptr : &motion, known,
                             how, found, left, work)
                ? 1
                : 0;
    if (*kept != 0) {
        SearchedBlock::store(left, after);
    }
    publish_alone(*tracker, found, *extraction);
    return ST_OK;
}

st_status st_search_near(st_tracker *tracker, const st_image *image, const double *places,
                         const double *radius_px, size_t count, const st_streak *streak,
                         const void *before, void *after, st_extraction *extraction) {
    const st_status status = check(tracker, image);
    if (status != ST_OK) {
        return status;
    }
    if (before == nullptr || after == nullptr || extraction == nullptr ||
        (count > 0 && (places == nullptr || radius_px == nullptr))) {
        return ST_NULL_POINTER;
    }
    if (!SearchedBlock::is_possible(before) || !SearchedBlock::is_possible(after)) {
        return ST_MISALIGNED;
    }
    if (count > static_cast<size_t>(most_predictions(tracker->config))) {
        return ST_TOO_MANY;
    }
    for (size_t i = 0; i < count; ++i) {
        if (!std::isfinite(places[2 * i]) || !std::isfinite(places[2 * i + 1]) ||
            !(radius_px[i] >= 0) || radius_px[i] > FARTHEST_PX) {
            return ST_BAD_INPUT;
        }
    }
    if (streak != nullptr && !is_finite(*streak)) {
        return ST_BAD_INPUT;
    }
    const int width = tracker->width, height = tracker->height;
    const Arena::Scope scope(tracker->work);
    Arena &work = tracker->work;
    const Image seen = image_of(*image, work);
    std::memmove(after, before, SearchedBlock::bytes(width, height));
    Searched searched = SearchedBlock::load(after, width, height);
    if (!searched.fits(seen)) {
        return ST_BAD_IMAGE;
    }
    auto *place = work.take<Place>(count);
    for (size_t i = 0; i < count; ++i) {
        place[i] = {places[2 * i], places[2 * i + 1]};
    }
    Extraction found = empty_result(*tracker);
    const Streak motion = streak_of(streak);
    const Extractor extractor(tracker->config.extraction,
                              limits_of(tracker->config, width, height));
    extractor.search_near(seen, place, radius_px, static_cast<int>(count),
                          streak == nullptr ? nullptr : &motion, searched, found, work);
    SearchedBlock::store(searched, after);
    publish_alone(*tracker, found, *extraction);
    return ST_OK;
}

st_status st_find_spots(st_tracker *tracker, const st_image *image, double cell_share,
                        int32_t calm) {
    const st_status status = check(tracker, image);
    if (status != ST_OK) {
        return status;
    }
    if (!(cell_share > 0)) {
        return ST_BAD_INPUT;
    }
    const Arena::Scope scope(tracker->work);
    Extraction found = empty_result(*tracker);
    if (image->width_px >= LEAST_SIDE_PX && image->height_px >= LEAST_SIDE_PX) {
        find_spots(image_of(*image, tracker->work), cell_share, calm != 0, found.stars,
                   tracker->work);
    }
    st_extraction ignored;
    publish_alone(*tracker, found, ignored);
    return ST_OK;
}

st_status st_find_highest_peaks(st_tracker *tracker, const st_image *image) {
    const st_status status = check(tracker, image);
    if (status != ST_OK) {
        return status;
    }
    const Arena::Scope scope(tracker->work);
    Extraction found = empty_result(*tracker);
    if (image->width_px >= LEAST_SIDE_PX && image->height_px >= LEAST_SIDE_PX) {
        find_highest_peaks(image_of(*image, tracker->work), found.stars, tracker->work);
    }
    st_extraction ignored;
    publish_alone(*tracker, found, ignored);
    return ST_OK;
}

st_status st_measure_widths(st_tracker *tracker, const st_image *image, const void *searched,
                            double *widths, size_t capacity, size_t *count) {
    const st_status status = check(tracker, image);
    if (status != ST_OK) {
        return status;
    }
    if (searched == nullptr || widths == nullptr || count == nullptr) {
        return ST_NULL_POINTER;
    }
    if (!SearchedBlock::is_possible(searched)) {
        return ST_MISALIGNED;
    }
    const int width = tracker->width, height = tracker->height;
    const ExtractionLimits limits = limits_of(tracker->config, width, height);
    if (capacity > static_cast<size_t>(limits.peaks)) {
        return ST_TOO_MANY;
    }
    const Arena::Scope scope(tracker->work);
    Arena &work = tracker->work;
    const Image seen = image_of(*image, work);
    const size_t bytes = SearchedBlock::bytes(width, height);
    auto *copy = work.take<std::byte>(bytes);
    std::memcpy(copy, searched, bytes);
    const Searched before = SearchedBlock::load(copy, width, height);
    if (!before.fits(seen)) {
        return ST_BAD_IMAGE;
    }
    const Extractor extractor(tracker->config.extraction, limits);
    auto *stars = work.take<FreeStar>(capacity);
    const int fitted = extractor.measure_widths(seen, before, WIDTH_ITERATIONS, stars,
                                                static_cast<int>(capacity), work);
    for (int i = 0; i < fitted; ++i) {
        const Star &star = stars[i].fit.star;
        widths[3 * i] = star[U];
        widths[3 * i + 1] = star[V];
        widths[3 * i + 2] = star[SIGMA];
    }
    *count = static_cast<size_t>(fitted);
    return ST_OK;
}

st_status st_full_scale(st_tracker *tracker, const st_image *image, double background_dn,
                        double *full_scale_dn) {
    const st_status status = check(tracker, image);
    if (status != ST_OK) {
        return status;
    }
    if (full_scale_dn == nullptr) {
        return ST_NULL_POINTER;
    }
    const Arena::Scope scope(tracker->work);
    const Image seen = image_of(*image, tracker->work);
    auto *row_max = tracker->work.take<uint16_t>(static_cast<size_t>(seen.height));
    for (int v = 0; v < seen.height; ++v) {
        const uint16_t *row = seen.row(v);
        uint16_t most = 0;
        for (int u = 0; u < seen.width; ++u) {
            most = row[u] > most ? row[u] : most;
        }
        row_max[v] = most;
    }
    *full_scale_dn = full_scale(seen, row_max, background_dn);
    return ST_OK;
}

}  // extern "C"
