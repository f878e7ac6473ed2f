// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Identification from list to list: the stars that are used, the search, its result.

#pragma once

#include "identify/search.h"
#include "startracker.h"

namespace st {

/// What a search is made for, in addition to the options.
struct IdentificationSetup {
    Patterns sky;
    BrightLevel bright;
    double scale_error;  // of the focal length, a share
    bool bases_by_brightness, lens_known;
    int most_stars, most_centroids;
};

/// Return that of a tracker with a sky file.
IdentificationSetup setup_of(const st_config &config, const SkyFile &sky, int most_centroids);

class IdentificationStage {
public:
    IdentificationStage() = default;
    IdentificationStage(const st_identification_options &options, const st_camera &camera,
                        const IdentificationSetup &setup, Arena &kept);

    /// Bytes that stay between calls, and of work memory in them.
    static size_t bytes(const IdentificationSetup &setup);
    static size_t work_bytes(const IdentificationSetup &setup);

    /// Begin a search for the stars of a list, of which places are off by shear_px in addition to
    /// their errors.
    void begin(int64_t stamp_ns, const st_centroid *centroids, int count, double shear_px,
               Arena &work);

    /// Continue it for so much work; *stop not zero ends it, null is allowed. The list has one
    /// element for each centroid once an attitude is found.
    void proceed(double slice_s, const volatile uint32_t *stop, st_identification &result,
                 List<st_identified> &identified, Arena &work);

    /// Return the result of a search that waits to be continued.
    st_identification waiting() const;

    /// Forget it.
    void reset() { searching_ = false; }

    bool is_searching() const { return searching_; }
    bool has_pairs() const { return verifier_.sky.pairs.star != nullptr; }
    int most_centroids() const { return most_centroids_; }
    int most_stars() const { return most_stars_; }
    /// Without what is counted of the sky, which a verification needs.
    const Verifier &uncounted() const { return verifier_; }
    /// Without pairs most fields are never verified: the stars of the sky are counted for the first
    /// that is.
    const Verifier &verifier();
    const Lens &lens() const { return lens_; }
    double work_s() const { return search_.work_s(); }

    /// The image stars of the newest search, and which stars of the sky they are.
    const ImageStars &stars() const { return search_.stars(); }
    const StarMatch &found() const { return search_.best().found; }

private:
    void publish(st_identification &result, List<st_identified> &identified, Arena &work) const;

    st_identification_options options_{};
    Lens lens_{};
    Verifier verifier_{};
    BrightLevel bright_{};
    StarSearch search_;
    int most_stars_ = 0, most_centroids_ = 0;
    int64_t stamp_ns_ = 0;
    int centroids_ = 0;
    bool searching_ = false;
};

/// Set what a fit to so many stars tells of an attitude.
void set_fit(const AttitudeFit &fit, const double *angle_rad, int count, double pixel_rad,
             st_attitude &attitude);

}  // namespace st
