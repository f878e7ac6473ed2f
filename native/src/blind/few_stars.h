// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Identification of a few stars among many false spots, by all triangles of them.
//
// Where one spot of ten is a star, one triangle of a thousand is of stars alone. So all are looked
// up, and the stars about a triangle of the sky vote: A, B, C and the image stars a, b, c put a
// catalogue star s = w_A A + w_B B + w_C C at w_A a + w_B b + w_C c, with
// w_A = s . (B x C) / A . (B x C) and so on, which needs no attitude and no scale. Where one of them
// meets a spot, the candidate is verified by all spots.
//
// What is accepted depends on no number of triangles: a product of probabilities, each over what a
// search has tested, leaves few stars little. How many wrong fields of the whole sky agree as well
// can be said beforehand. Of n spots spread over an image of A = w h, m are matched with the sum X of
// their squared residuals after attitude and focal length are fitted, and the faintest of them is
// the j-th brightest spot and the k-th brightest catalogue star of the field. With the focal length
// known to a share e there are by chance
//
//     E = N k! / (k - m)!  4 pi / A  4 pi e  m (m - 1) (w^2 + h^2) / (12 A)
//         (pi X / A)^(m - 2) / (m - 2)!
//
// such fields: the N = C(j, m) ways to choose the spots and those to choose the stars, the
// independent fields of the sky, the volume of turn and scale, that of the similarity transforms of m
// points, and that of a ball of their 2 m - 4 residuals. E does not depend on how rich a field is, nor
// on how it was found. Any j up to n, any k up to the S stars of the field, any order of brightness
// and any m may make it small. As the brightest spots need not be the stars, N is
//
//     2 min(C(n, m), C(j, m) sum_{i=m}^n m / i)
//
// and so
//
//     P_few = min(1, E P_3  sum_{i=m}^S m / i  (1 + ln m!)  2^(m - 3)),    m > 3,
//
// each factor being what its choice adds to the expected number below a limit; P_3 is that of
// identify/false_alarm.h.

#pragma once

#include "identify/verification.h"
#include "startracker_ground.h"

namespace st {

/// The matches of an image: of n spots, the brightest first, m are matched, the faintest is the j-th,
/// and the faintest star the k-th of so many of the field; square is X, order P_3, width and height
/// in undistorted coordinates.
struct FewMatches {
    int n, m, j, k, stars;
    double square, order, width, height;
};

/// Return P_few with the focal length known to a share; 1 for fewer than four matches.
double few_star_probability(const FewMatches &matches, double scale_error);

/// Search the triangles of the brightest image stars until one is accepted, or for so much work, in
/// ns as it is expected to take; return the work. best is the first accepted or the most probable
/// candidate.
double find_few_stars(const Verifier &verifier, const st_triangle_table &table,
                      const ImageStars &stars, double false_alarm_max, double most_ns,
                      Verification &best, Arena &work);

}  // namespace st
