// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Star image to centroids, with a reason for every spot left out.
//
// 1. Background and peaks of the image (frame.h), after a matched filter. Discs, lines and storms
//    of hits are removed here, before the highest peaks of each cell of the image are chosen.
// 2. PSF sigma (psf_sigma.h), that of an image before where this one does not show it; if the
//    filter does not match, step 1 once more.
// 3. Points (point_stars.h): rough fit, which rejects false stars and measures the noise, then
//    the final fit.
// 4. Streaks (streak_search.h) instead, if the stars moved during the exposure: by a known streak,
//    or by the one on which the spots agree.
// 5. Points after wider filters, if many spots are not stars: a narrow one cuts defocused rings.
// 6. Spots of any shape (spots.h) in addition to the points, if these are still not most of the
//    bright spots: no point, streak or disc describes an aberrated or clipped star, but its flux is
//    there.
//
// Once an image was searched, search_near() measures stars at known positions only.

#pragma once

#include "centroid/artefacts.h"
#include "centroid/frame.h"
#include "centroid/image.h"
#include "centroid/point_stars.h"
#include "centroid/rejection.h"
#include "centroid/streak.h"
#include "maths/arena.h"
#include "startracker.h"

namespace st {

constexpr int LEAST_SIDE_PX = 8;  // of an image

/// Stars of an image, its background and its rejected spots. background_dn and noise_dn (1 sigma of
/// a pixel) are medians over the image, psf_sigma_px that fitted with; NaN where not measured.
/// streaked is whether streak is the motion fitted with, false for points.
struct Extraction {
    List<st_centroid> stars;
    Rejections rejections;
    st_reason reason;  // ST_NO_REASON where there are stars
    double background_dn, noise_dn, psf_sigma_px;
    bool streaked;
    Streak streak;

    /// Whether the stars share an error: of motion that is not uniform in the exposure.
    bool has_correlated_error() const;

    /// Return the length of the streaks in the middle of the image, zero for points.
    double streak_px() const { return streaked ? streak.length_px() : 0.0; }
};

/// Capacities of an image: peaks, and stars and rejected spots of an Extraction.
struct ExtractionLimits {
    int peaks, stars, rejected;
};

/// Return what a tracker of these options has room for: capacities where given, else derived.
ExtractionLimits limits_of(const st_config &config, int width, int height);

/// Return an extraction without stars, with lists of the arena.
Extraction empty_extraction(const ExtractionLimits &limits, Arena &arena);

/// PSF sigma in px that an image showed with certainty, 0 for none, some images ago.
struct KnownSigma {
    double sigma_px;
    int images;

    /// Return what is known of it in the next image.
    KnownSigma older() const;
};

/// What a searched image leaves for those after it: size, filter and background of the image,
/// sigma_px the PSF sigma of its stars, known the last one that was certain, what was removed from
/// it, and whether it has stars that no point describes. The arrays of the mesh stay with it.
struct Searched {
    bool any = false;
    int width = 0, height = 0, bits = 0;
    Kernel kernel{};
    Mesh mesh{};
    double full_scale_dn = 0.0, sigma_px = 0.0;
    KnownSigma known{};
    Contamination contamination{};
    bool any_shape = false;

    /// Whether an image has the size and the type of the one that was searched.
    bool fits(const Image &image) const {
        return any && width == image.width && height == image.height && bits == image.bits;
    }

    /// Keep background and filter of a frame, copied into the own arrays.
    void keep(const Frame &frame);
};

/// How an image is searched: most_stars, 0 for that of the options; points_only whether only points
/// are searched, and narrow those of the narrowest spots.
struct SearchHow {
    int most_stars = 0;
    bool points_only = false, narrow = false;
};

/// Finds the stars of images by options that do not change.
class Extractor {
public:
    Extractor() = default;
    /// threshold_factor falsifies the threshold of the means of pixels.
    Extractor(const st_extraction_options &options, const ExtractionLimits &limits,
              double threshold_factor = 1.0);

    /// Find the stars of an image. streak is the motion of the exposure where it is known, else
    /// null; before what the last image of this camera left that was searched. Return whether
    /// `after` was filled for the next image, else `before` stays. found is empty, its lists and
    /// all work memory are of other arenas.
    bool search(const Image &image, const Streak *streak, const Searched &before,
                const SearchHow &how, Extraction &found, Searched &after, Arena &arena) const;

    /// Find the stars within radius_px of expected places, count of them. searched is that of an
    /// image of this size and type; it gives background and PSF sigma, and its contamination is
    /// removed here too. It is renewed for the next image.
    void search_near(const Image &image, const Place *places, const double *radius_px, int count,
                     const Streak *streak, Searched &searched, Extraction &found,
                     Arena &arena) const;

    /// Fit a PSF sigma to each star of the highest peaks, as fit_free_sigma(), at most `most` of
    /// them; searched is what a search of this image has left. Return how many there are.
    int measure_widths(const Image &image, const Searched &searched, int iterations,
                       FreeStar *stars, int most, Arena &arena) const;

private:
    struct Work;

    Frame prepared(const Image &image, double filter_px, bool has_hits, Arena &arena) const;
    void clean(Work &work, const Searched &before, Rejections &taken_out) const;
    void match_filter(Work &work, bool narrow) const;
    void set_psf_sigma(Work &work, bool narrow) const;
    bool points(const Frame &frame, double sigma_px, int most, Extraction &found,
                Arena &arena) const;
    bool other_shapes(Work &work, bool smeared, Extraction &found) const;
    void as_wide(Work &work, Extraction &found) const;
    void streaks(const Frame &frame, const Streak &streak, double sigma_px, int most,
                 Extraction &found, Arena &arena) const;
    void finish(const Frame &frame, double sigma_px, int most, Extraction &found,
                Arena &arena) const;

    st_extraction_options options_{};
    ExtractionLimits limits_{};
    Threshold threshold_{};
    PointOptions point_options_{};
    double line_time_s_ = 0.0;
};

/// Bytes of memory that a search of an image needs.
size_t work_bytes(int width, int height, const ExtractionLimits &limits);

}  // namespace st
