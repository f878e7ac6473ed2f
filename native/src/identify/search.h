// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Lost-in-space identification by triangles and the stars that confirm them: Pyramid.
//
// Mortari, Samaan, Bruccoleri, Junkins, The Pyramid Star Identification Technique, Navigation 51
// (2004). The steps of the paper and where they are:
//
// 1. Choose three image stars, changed so that a false star is soon left: triangle_order.h.
// 2. Look up the catalogue pairs of two sides by k-vector, join them in the star that they share:
//    pair_search.h. The paper compares three lists; here the third side is computed.
// 3. Keep the triangles whose third side and handedness agree: triangles.h.
// 4. Confirm with a fourth star. The paper asks for one. Here many rank the triangles (support.h),
//    and verification.h accepts one by its false-alarm probability over all stars of the field,
//    where the paper bounds the expected number of chance pyramids beforehand.
//
// A search may pause and be continued. Its work is counted in the time that it is expected to take
// on a processor of 3 GHz, so that its result does not depend on the machine, nor on the pauses.

#pragma once

#include "identify/triangle_order.h"
#include "identify/triangles.h"

namespace st {

enum class Outcome { SEARCHING, IDENTIFIED, TOO_FEW, AMBIGUOUS, EXHAUSTED, MOST_WORK };

constexpr int LEAST_STARS = 4;

/// Whether more triangles of count image stars, of this median error, are not worth their work after
/// so many that were looked up at this cost in ns each, and so many tested candidates.
bool is_searched(const Verifier &verifier, double median_sigma, int count, double looked_up,
                 double cost_ns, double tested, double false_alarm_max);

/// A search among the stars of one frame, and its memory.
class StarSearch {
public:
    StarSearch() = default;
    StarSearch(int most_stars, const Patterns &sky, Arena &arena);

    static size_t bytes(int most_stars, const Patterns &sky);

    /// Begin with the image stars, which stars() has.
    void begin(double most_work_s);

    /// Continue for so much work, until *stop is not zero, or to the end. Candidates are accepted
    /// below false_alarm_max. work is memory for verification_bytes().
    Outcome proceed(const Verifier &verifier, const BrightLevel &bright, double false_alarm_max,
                    double slice_s, const volatile uint32_t *stop, Arena &work);

    ImageStars &stars() { return stars_; }
    const ImageStars &stars() const { return stars_; }
    const Verification &best() const { return best_; }
    /// Stars of the other attitude that fits an ambiguous field.
    int other_matched() const { return other_matched_; }
    double tested() const { return tested_; }
    double work_s() const { return 1e-9 * work_.done_ns; }
    void reset() { level_ = LEVELS; }

private:
    static constexpr int LEVELS = 2;

    bool next_triangle(const Verifier &verifier, const BrightLevel &bright,
                       double false_alarm_max);
    Outcome verify_all(const Verifier &verifier, double false_alarm_max, Arena &work);
    /// T of the false-alarm probability. A candidate is fitted to stars that are as far from it as
    /// the whole tolerance, so that one within the narrow gates of the three sides has the chances
    /// of all those that whole gates would have let pass, of which it is one of 1 / SIDE_SIGMAS^3.
    double counted() const { return tested_ / (SIDE_SIGMAS * SIDE_SIGMAS * SIDE_SIGMAS); }
    const Pairs &pairs(const Verifier &verifier) const {
        return level_ == 0 ? verifier.sky.bright_pairs : verifier.sky.pairs;
    }

    ImageStars stars_{};
    TriangleOrder order_;
    TriangleSearch triangle_;
    Verification best_{}, verified_{};
    int32_t *latest_[LEVELS]{};
    int level_ = LEVELS, looked_up_ = 0, other_matched_ = 0;
    bool level_begun_ = false, looking_up_ = false;
    double cost_ns_ = 0.0, tested_ = 0.0;
    Work work_{};
};

}  // namespace st
