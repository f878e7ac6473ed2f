// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Support of further image stars for a candidate triangle, summed before it is verified.
//
// Image stars a, b, c taken for catalogue stars A, B, C predict where star i must be. With
//
//     i = w_a a + w_b b + w_c c,    w_a = i . (b x c) / a . (b x c) and so on,
//
// the catalogue direction is that of w_a A + w_b B + w_c C. This needs no attitude, and a wrong
// focal length cancels. The error of the prediction and of the star itself is
//
//     sigma^2 = sigma_i^2 + w_a^2 sigma_a^2 + w_b^2 sigma_b^2 + w_c^2 sigma_c^2.
//
// One of the N catalogue stars is within its tolerance r by chance with p = N r^2 / 4. A star that
// is there supports the candidate by -ln p: the logarithm of how much more likely it makes it. So
// does the order of brightness of A, B, C, of which so few or fewer inversions have the share p of
// all six orders.

#pragma once

#include <cstdint>

#include "identify/image_stars.h"
#include "identify/patterns.h"
#include "sky/near.h"

namespace st {

/// So much support no candidate has by chance.
constexpr double DECISIVE = 25.0;

/// Image stars that are looked up for each candidate, at most.
constexpr int MOST_SUPPORTERS = 16;

/// The image stars that three of them, the base, predict best, those of most support first.
struct Supporters {
    int count;
    int32_t base[3];
    Vector3 weight[MOST_SUPPORTERS];
    double reach[MOST_SUPPORTERS];  // in which each is looked up, rad
    double gain[MOST_SUPPORTERS];   // its support
    double sum;                     // of all gains
};

/// Return those of a base, by a catalogue of so many stars of the whole sky.
Supporters supporters(int32_t catalogue_stars, const ImageStars &stars, const int32_t base[3],
                      double tolerance_sigmas);

/// Whether one of these directions, of any precision, is where a supporter is predicted when the base
/// is three of them.
template <class Real>
inline bool is_supported(const Cells &cells, const Real (*direction)[3], const Supporters &stars,
                         int supporter, const int32_t three[3]) {
    const Vector3 &w = stars.weight[supporter];
    Vector3 at{};
    for (int k = 0; k < 3; ++k) {
        for (int i = 0; i < 3; ++i) {
            at[k] += w[i] * static_cast<double>(direction[three[i]][k]);
        }
    }
    return has_near(cells, direction, scaled(at, 1 / norm(at)), stars.reach[supporter]);
}

/// Return the support for a candidate: the base is these three catalogue stars, which are numbered
/// by brightness. A sum that can no longer exceed enough is not completed.
double support(const Patterns &sky, const Supporters &stars, int32_t first, int32_t second,
               int32_t third, double enough);

}  // namespace st
