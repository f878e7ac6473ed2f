// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Which images are searched as a whole, and in which only predicted centroids are measured.

#pragma once

#include "centroid/expected.h"
#include "centroid/exposure.h"
#include "centroid/extraction.h"
#include "centroid/stale_rows.h"
#include "maths/arena.h"
#include "startracker.h"

namespace st {

/// Extracts the centroids of the images of a camera, near the predictions of a star tracker where it
/// has any.
///
/// The exposure time is that of the options, else that of the image, else estimated from the
/// length of the streaks in the images that are searched: the mean of many, by the lengths. A streak
/// that the motion does not explain and that is the same in two images is the shape of the stars: an
/// astigmatic lens draws it, however the camera moves.
class ExtractionStage {
public:
    ExtractionStage() = default;

    /// Take what stays between images out of the arena; then work_bytes() have to be left.
    ExtractionStage(const st_config &config, int width, int height, Arena &arena);

    /// Use other values of the options that are live; what images have shown stays.
    void set_options(const st_extraction_options &options);

    /// Forget the images before: the next one is searched as a whole.
    void reset();

    /// Return the stars of an image of a time. predicted has no items where there is no prediction;
    /// without lost this does not mean that no star tracker tracks. exposure_s is what the camera
    /// says, 0 where it says nothing: what it said last holds. Valid until the next call.
    const Extraction &process(int64_t stamp_ns, const Image &image, double exposure_s,
                              const Predictions &predicted, bool lost, Arena &arena);

    /// Whether the last image was not searched as a whole.
    bool windowed() const { return windowed_; }

    /// Return the least and the largest exposure by the streaks and points seen so far.
    ExposureLimits exposure() const;

private:
    /// The streak of an image, how many stars it has, and the width of these.
    struct Shown {
        bool any, streaked, has_correlated_error;
        Streak streak;
        int stars;
        double streak_px, psf_sigma_px;

        static Shown of(const Extraction &extraction);
    };

    /// A streak that may not be known.
    struct MaybeStreak {
        bool known = false;
        Streak streak{};

        const Streak *pointer() const { return known ? &streak : nullptr; }
    };

    /// Streaks by motion and shape of the stars, and near the predictions.
    struct Streaks {
        Streak expected, shown;
    };

    const Extraction &refused(st_reason_code code, double first, double second);
    const Extraction &unpredicted(const Image &image, bool lost, Arena &arena);
    const Extraction &predicted_near(int64_t stamp_ns, const Image &image,
                                     const Expected &expected, double moved_px, Arena &arena);
    Streaks streaks(const Expected &expected) const;
    void search(const Image &image, const Streak *streak, const SearchHow &how, Arena &arena);
    bool measure_near(const Image &image, const Expected &expected, const Streak &streak,
                      Arena &arena);
    bool has_stars(const Extraction &near, const Expected &expected) const;
    bool is_due(int64_t stamp_ns) const;
    const Extraction &joined(const Image &image, bool use_near, const Expected &expected,
                             Arena &arena);
    void learn(const Extraction &extraction, const Expected &expected);
    void learn_shown(const Shown &shown, const Expected &expected);
    void learn_exposure(const Shown &shown, const Expected &expected);
    Searched &searched() { return searched_[current_]; }

    ExtractionLimits limits_{};
    Extractor extractor_;
    double line_time_s_ = 0.0, given_exposure_s_ = 0.0;
    int64_t search_period_ns_ = 0;
    int max_stars_ = 0, max_stars_lost_ = 0;

    bool windowed_ = false;
    // What the last searched image left, and that of the one before it.
    Searched searched_[2];
    int current_ = 0;
    Extraction found_{}, near_{};
    int64_t stamp_ns_ = 0, searched_ns_ = 0;
    bool was_searched_ = false;  // since there are predictions
    double seen_share_ = 1.0;
    Exposure exposure_;
    double point_speed_px_s_ = 0.0;
    MaybeStreak shape_, unexplained_;
    Shown start_{};
    int unpredicted_ = 0, astray_ = 0;
    bool narrow_ = false;
    StaleRows stale_rows_;
};

/// Bytes of what stays between images.
size_t stage_bytes(const st_config &config, int width, int height);

}  // namespace st
