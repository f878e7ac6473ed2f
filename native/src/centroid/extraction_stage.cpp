// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/extraction_stage.h"

#include <cmath>

namespace st {
namespace {

constexpr int LEAST_PREDICTED = 4;
constexpr double LEAST_SHARE = 0.75;  // of the predicted stars seen in the image searched last
constexpr int64_t MOST_AGE_NS = 1'000'000'000;  // of a prediction
constexpr double SAME_PX = 3.0;                 // two centroids closer than this are of one star
constexpr double REPEATED_PX = 0.5;    // motion from which on an equal image is the one before
constexpr int MOST_ASTRAY_IMAGES = 2;  // in a row that are refused
constexpr int IMAGES_TO_ACQUIRE = 2;   // a star tracker needs the identifications of two
constexpr int MOST_DOUBLINGS = 10;
constexpr double WIDE_PX = 1.6;   // PSF sigma beyond which spots may be debris
constexpr double POINT_PX = 4.0;  // a longer streak is not seen as a point
constexpr double FASTER = 2.0;    // times the speed at which stars were points: may be streaks

/// Whether most spots are not streaks of the motion that was assumed.
bool contradicts(const Extraction &extraction) {
    return extraction.rejections.by_kind[ST_REJECTED_NOT_STREAKED] > extraction.stars.count;
}

void clear(Extraction &extraction) {
    extraction.stars.clear();
    extraction.rejections.clear();
    extraction.reason = {};
    extraction.background_dn = extraction.noise_dn = extraction.psf_sigma_px = NAN;
    extraction.streaked = false;
}

}  // namespace

ExtractionStage::Shown ExtractionStage::Shown::of(const Extraction &extraction) {
    return {true,
            extraction.streaked,
            extraction.has_correlated_error(),
            extraction.streak,
            extraction.stars.count,
            extraction.streak_px(),
            extraction.psf_sigma_px};
}

ExtractionStage::ExtractionStage(const st_config &config, int width, int height, Arena &arena)
    : limits_(limits_of(config, width, height)) {
    set_options(config.extraction);
    line_time_s_ = config.extraction.line_time_us * 1e-6;
    given_exposure_s_ = config.extraction.exposure_s;
    for (Searched &one : searched_) {
        one.mesh.level = arena.take<double>(most_tiles(width, height));
        one.mesh.noise = arena.take<double>(most_tiles(width, height));
    }
    found_ = empty_extraction(limits_, arena);
    near_ = empty_extraction(limits_, arena);
    stale_rows_.take_memory(width, height, arena);
    reset();
}

void ExtractionStage::set_options(const st_extraction_options &options) {
    extractor_ = Extractor(options, limits_);
    search_period_ns_ = static_cast<int64_t>(std::nearbyint(options.search_period_s * 1e9));
    max_stars_ = options.max_stars;
    max_stars_lost_ =
        options.max_stars_lost > max_stars_ ? options.max_stars_lost : options.max_stars;
}

void ExtractionStage::reset() {
    windowed_ = false;
    searched_[0].any = searched_[1].any = false;
    stamp_ns_ = 0;
    was_searched_ = false;
    seen_share_ = 1.0;
    exposure_ = Exposure(given_exposure_s_);
    point_speed_px_s_ = 0.0;
    shape_ = unexplained_ = {};
    start_ = {};
    unpredicted_ = astray_ = 0;
    narrow_ = false;
    stale_rows_.reset();
}

ExposureLimits ExtractionStage::exposure() const {
    if (exposure_.seconds() > 0) {
        return exposure_.limits();
    }
    return {0.0, point_speed_px_s_ > 0 ? POINT_PX / point_speed_px_s_ : INFINITY};
}

const Extraction &ExtractionStage::process(int64_t stamp_ns, const Image &image, double exposure_s,
                                           const Predictions &predicted, bool lost, Arena &arena) {
    if (exposure_s > 0 && !(given_exposure_s_ > 0)) {
        exposure_ = Exposure(exposure_s);
    }
    const RowRange stale = stale_rows_.find(image);
    const bool repeated = stale.last - stale.first == image.height - 1;
    const double interval_s = static_cast<double>(stamp_ns - stamp_ns_) * 1e-9;
    stamp_ns_ = stamp_ns;
    windowed_ = false;
    if (stale.last != 0 && !repeated) {
        return refused(ST_REASON_TORN, stale.first, stale.last);
    }
    if (repeated && stale_rows_.vary()) {
        return refused(ST_REASON_REPEATED_NOISE, 0.0, 0.0);
    }
    const double readout_s = line_time_s_ * image.height;
    if (0 < interval_s && interval_s < readout_s) {
        return refused(ST_REASON_READOUT_TOO_LONG, readout_s, interval_s);
    }
    const int64_t age_ns = stamp_ns - predicted.stamp_ns;
    if (predicted.stars() < LEAST_PREDICTED || age_ns <= 0 || age_ns > MOST_AGE_NS) {
        was_searched_ = false;
        return unpredicted(image, lost, arena);
    }
    unpredicted_ = 0;
    const Arena::Scope scope(arena);
    const Expected expected =
        expected_at(stamp_ns, predicted, image.width, image.height, interval_s, arena);
    if (start_.any) {
        learn_shown(start_, expected);
        start_.any = false;
    }
    const double moved_px = expected.speed_px_s * static_cast<double>(age_ns) * 1e-9;
    if (repeated && moved_px > REPEATED_PX) {
        return refused(ST_REASON_REPEATED_MOVED, moved_px, 0.0);
    }
    return predicted_near(stamp_ns, image, expected, moved_px, arena);
}

/// Return the extraction of an image whose stars are not used.
const Extraction &ExtractionStage::refused(st_reason_code code, double first, double second) {
    clear(found_);
    found_.reason = {code, 0, {first, second}};
    return found_;
}

/// Find the stars of an image: more of them, the longer the star tracker is lost.
const Extraction &ExtractionStage::unpredicted(const Image &image, bool lost, Arena &arena) {
    unpredicted_ = lost ? unpredicted_ : 0;
    int doublings = unpredicted_ / IMAGES_TO_ACQUIRE;
    doublings = doublings < MOST_DOUBLINGS ? doublings : MOST_DOUBLINGS;
    if (unpredicted_ % IMAGES_TO_ACQUIRE == 0) {
        // What is wide may be debris out of focus: every other time the narrowest are used.
        narrow_ = !narrow_ && unpredicted_ > 0 && start_.any && start_.psf_sigma_px > WIDE_PX;
    }
    ++unpredicted_;
    const int most = max_stars_ << doublings;
    search(image, nullptr, {most < max_stars_lost_ ? most : max_stars_lost_, narrow_, narrow_},
           arena);
    start_ = Shown::of(found_);
    return found_;
}

/// Find the stars of an image with predictions, in all of it where that is due or needed.
const Extraction &ExtractionStage::predicted_near(int64_t stamp_ns, const Image &image,
                                                  const Expected &expected, double moved_px,
                                                  Arena &arena) {
    const auto [streak, shown] = streaks(expected);
    bool unknown = exposure_.seconds() == 0 && moved_px > SHORTEST_PX &&
                   expected.speed_px_s > FASTER * point_speed_px_s_;
    bool use_near = !unknown && measure_near(image, expected, shown, arena) && !contradicts(near_);
    if (use_near && !expected.anywhere && !is_due(stamp_ns) && has_stars(near_, expected)) {
        windowed_ = true;
        return near_;
    }
    searched_ns_ = stamp_ns;
    was_searched_ = true;
    const bool had_before = searched().any;
    int before = current_;
    bool known = !unknown;
    search(image, known ? &streak : nullptr, {}, arena);
    if (contradicts(found_)) {
        // The motion has changed since the prediction: the image shows which it is.
        search(image, nullptr, {}, arena);
        known = use_near = false;
        unknown = moved_px > SHORTEST_PX;
    }
    bool astray = false;
    if (!known || streak.longest_px() < SHORTEST_PX) {
        learn_shown(Shown::of(found_), expected);
        if (shape_.known) {
            use_near = false;
        } else {
            astray = unknown && found_.streaked && !expected.agrees(found_.streak);
        }
    }
    astray_ = astray ? astray_ + 1 : 0;
    // Without stars a prediction never changes: in the end it is what is wrong.
    if (0 < astray_ && astray_ <= MOST_ASTRAY_IMAGES) {
        return refused(ST_REASON_STREAK_ASTRAY, found_.streak_px(), 0.0);
    }
    if (use_near && had_before && searched().any && current_ != before) {
        const Contamination contamination = searched().contamination;
        const bool changed = contamination != searched_[before].contamination;
        if (expected.stars_seen(found_.stars) < LEAST_SHARE * expected.stars_seen(near_.stars)) {
            // What fills the list is of another width: debris, which is not a measure of stars.
            current_ = before;
            searched().contamination = contamination;
        }
        if (changed) {
            use_near = measure_near(image, expected, shown, arena);
        }
    }
    return joined(image, use_near, expected, arena);
}

ExtractionStage::Streaks ExtractionStage::streaks(const Expected &expected) const {
    const Streak streak = expected.motion.scaled(exposure_.seconds());
    if (shape_.known) {
        const Streak both = shape_.streak.joined(streak);
        return {both, both};
    }
    // The width of the stars in that image is the one across its streak.
    return {streak, unexplained_.known ? unexplained_.streak.joined(streak) : streak};
}

/// Find the stars of the whole image.
void ExtractionStage::search(const Image &image, const Streak *streak, const SearchHow &how,
                             Arena &arena) {
    clear(found_);
    Searched &before = searched(), &after = searched_[1 - current_];
    if (extractor_.search(image, streak, before, how, found_, after, arena)) {
        current_ = 1 - current_;
    } else if (!before.fits(image)) {
        before.any = false;
    }
}

/// Measure stars and targets near where they are expected; false where no image was searched.
bool ExtractionStage::measure_near(const Image &image, const Expected &expected,
                                   const Streak &streak, Arena &arena) {
    if (!searched().fits(image)) {
        return false;
    }
    clear(near_);
    extractor_.search_near(image, expected.places, expected.radius_px, expected.count, &streak,
                           searched(), near_, arena);
    return true;
}

/// Whether as many of the predicted stars are seen as in the image searched last.
bool ExtractionStage::has_stars(const Extraction &near, const Expected &expected) const {
    const int seen = expected.stars_seen(near.stars);
    return seen >= LEAST_PREDICTED && seen >= LEAST_SHARE * seen_share_ * expected.stars;
}

/// Whether it is time to search a whole image.
bool ExtractionStage::is_due(int64_t stamp_ns) const {
    const int64_t age_ns = stamp_ns - searched_ns_;
    return search_period_ns_ == 0 || !was_searched_ || age_ns < 0 || age_ns >= search_period_ns_;
}

/// Return the stars of the searched image; what was measured near the predictions stays.
const Extraction &ExtractionStage::joined(const Image &image, bool use_near,
                                          const Expected &expected, Arena &arena) {
    if (use_near) {
        const int seen = expected.stars_seen(near_.stars);
        use_near =
            seen >= LEAST_PREDICTED && seen >= LEAST_SHARE * expected.stars_seen(found_.stars);
    }
    if (!use_near) {
        if (found_.stars.count < LEAST_PREDICTED && exposure_.seconds() > 0) {
            search(image, nullptr, {}, arena);
        }
        learn(found_, expected);
        return found_;
    }
    learn(near_, expected);
    const int measured = near_.stars.count;
    for (const st_centroid &other : found_.stars) {
        bool same = false;
        for (int i = 0; i < measured; ++i) {
            const double u = other.u_px - near_.stars[i].u_px;
            const double v = other.v_px - near_.stars[i].v_px;
            same |= std::sqrt(u * u + v * v) <= SAME_PX;
        }
        if (!same) {
            near_.stars.add(other);
        }
    }
    found_.stars.clear();
    found_.stars.add_all(near_.stars);
    found_.reason = {};
    found_.streaked = near_.streaked;
    found_.streak = near_.streak;
    return found_;
}

/// Learn from the stars of an image.
void ExtractionStage::learn(const Extraction &extraction, const Expected &expected) {
    if (extraction.stars.count < LEAST_PREDICTED) {
        return;
    }
    seen_share_ = static_cast<double>(expected.stars_seen(extraction.stars)) / expected.stars;
    if (!extraction.streaked || (shape_.known && exposure_.seconds() == 0)) {
        point_speed_px_s_ =
            expected.speed_px_s > point_speed_px_s_ ? expected.speed_px_s : point_speed_px_s_;
    } else {
        learn_exposure(Shown::of(extraction), expected);
    }
}

/// Learn exposure time and shape of the stars from the streak that an image shows.
void ExtractionStage::learn_shown(const Shown &shown, const Expected &expected) {
    if (shown.streaked && shown.has_correlated_error) {
        return;
    }
    const MaybeStreak before = unexplained_;
    shape_ = unexplained_ = {};
    if (!shown.streaked || expected.exposure_s(shown.streak) > 0) {
        learn_exposure(shown, expected);
        return;
    }
    unexplained_ = {true, shown.streak};
    if (before.known && shown.streak.is_close(before.streak)) {
        // A time estimated from the shape of the stars is not given.
        shape_ = unexplained_;
        if (!exposure_.is_given()) {
            exposure_ = Exposure();
        }
    }
}

/// Learn the exposure time from a streak that the image shows; few stars may err. An image of
/// motion that is not uniform shows no time.
void ExtractionStage::learn_exposure(const Shown &shown, const Expected &expected) {
    if (shown.has_correlated_error || !shown.streaked) {
        return;
    }
    const double exposure_s = expected.exposure_s(shown.streak);
    if (exposure_s > 0) {
        exposure_.add(exposure_s, shown.stars * shown.streak_px * shown.streak_px);
    }
}

size_t stage_bytes(const st_config &config, int width, int height) {
    const ExtractionLimits limits = limits_of(config, width, height);
    return 4 * Arena::padded<double>(most_tiles(width, height)) +
           2 * (Arena::padded<st_centroid>(static_cast<size_t>(limits.stars)) +
                Arena::padded<st_rejected>(static_cast<size_t>(limits.rejected))) +
           StaleRows::bytes(width, height);
}

}  // namespace st
