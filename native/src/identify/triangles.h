// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Catalogue triangles that an image triangle may be, with the support of further image stars.
//
// Image triangle abc has the angles theta_k and noise gates rho_k of its sides k = ab, ac, bc
// (pair_search.h). Catalogue stars A, B, C have the separations d_k. The scale that fits best is
//
//     s = sum_k theta_k d_k / rho_k^2 / sum_k theta_k^2 / rho_k^2
//
// and the triangle fits when s is in the band that is searched and
//
//     |d_k - s theta_k| <= rho_k,    A . (B x C) a . (b x c) > 0.
//
// The second condition is the handedness. It is left out where noise may turn the triangle over.
// Sides ab and ac come out of the k-vector and are joined through A; side bc is computed. By chance
//
//     4 n_ab n_ac / N  theta_bc rho_bc / (2 pi F)
//
// triangles fit where e = 0 and all angles are small: the size of the join, times the probability
// that the third side of a triangle of area F agrees if the angle at A is random.
//
// The fourth star of the pyramid of Mortari et al. (2004) is up to 16 stars here: support.h predicts
// where A, B, C put the other image stars.

#pragma once

#include <cstdint>

#include "identify/pair_search.h"
#include "identify/support.h"
#include "identify/verification.h"

namespace st {

/// Candidates of one triangle that are verified, those with the most support.
constexpr int MOST_VERIFIED = 5;

/// Sides of a triangle, sum of theta^2 / rho^2, a . (b x c), and whether it is flat.
struct ImageTriangle {
    Side ab, ac, bc;
    double norm, volume;
    bool flat;
};

ImageTriangle image_triangle(const ImageStars &stars, const int32_t base[3], double side_sigmas);

/// Expected time of a search in ns: what it may take until it pauses, and at all.
struct Work {
    double done_ns, pause_ns, most_ns;

    bool is_over() const { return done_ns > most_ns; }
    bool is_paused() const { return done_ns > pause_ns; }
};

/// The candidates of an image triangle, looked up in steps so that a search may pause between them.
class TriangleSearch {
public:
    /// Begin with an image triangle; latest has room for a number for each star of the pairs, which
    /// stays from one triangle to the next.
    void begin(const Verifier &verifier, const ImageStars &stars, const int32_t base[3],
               int32_t *latest);

    /// Continue until all is looked up, a candidate is DECISIVE or the work is over: true; or the
    /// work is paused: false. tested counts the triangles that fit.
    bool proceed(const Verifier &verifier, const Pairs &pairs, Work &work, double &tested);

    /// How many candidates are to be verified, and their stars.
    int count() const;
    const int32_t *candidate(int row) const { return best_[row]; }
    const int32_t *base() const { return supporters_.base; }

private:
    enum Phase { NEXT_BAND, LISTING, JOINING, DONE };

    void begin_band(const Verifier &verifier, const Pairs &pairs);
    bool join(const Verifier &verifier, const Pairs &pairs, double &tested);
    bool weigh(const Verifier &verifier, int32_t a, int32_t b, int32_t c);
    bool fits(const Pairs &pairs, int32_t entry_ab, int32_t entry_ac, double chord2) const;
    void keep(int32_t a, int32_t b, int32_t c, double support);

    ImageTriangle triangle_;
    Supporters supporters_;
    ScaleBand band_;
    Phase phase_ = DONE;
    int next_band_ = 0;
    Entries ab_, ac_;
    int64_t entry_ = 0;            // the next one of the phase
    double low2_ = 0, high2_ = 0;  // squared chords of side bc
    int64_t steps_ = 0;            // since the work was counted
    int32_t *latest_ = nullptr;
    int32_t best_[MOST_VERIFIED][3];
    double support_[MOST_VERIFIED];
};

}  // namespace st
