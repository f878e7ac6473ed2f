// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The order in which triangles of image stars are looked up.
//
// Mortari et al. (2004, figure 5) permute the three indices so that no star stays in many triangles
// in a row: a false star then contaminates few of them. Here each star i has a weight w_i, 0.9^i for
// the i-th brightest of 40 or fewer, halved by each triangle that it was in. The next triangle has
// the greatest
//
//     w_i w_j w_k / C,    C = c_0 + c_1 (n_1 + n_2) + c_2 4 n_1 n_2 / (N B),
//
// where C is the time it takes: n_1 and n_2 are the expected pairs of its two shorter sides, and the
// last term is the size of their join (pair_search.h).

#pragma once

#include <cstdint>

#include "identify/image_stars.h"
#include "identify/patterns.h"

namespace st {

/// c_0: expected time in ns to look up a triangle, also to verify one candidate.
constexpr double TRIANGLE_COST_NS = 2500.0;

/// The triangles of the brightest stars of a frame, each once.
class TriangleOrder {
public:
    TriangleOrder() = default;

    /// Take memory for so many stars.
    TriangleOrder(int most_stars, Arena &arena);

    static size_t bytes(int most_stars);

    /// Begin with so many of the brightest stars.
    void begin(int count);

    /// Put the next triangle into base, the longest side between the second and the third; return
    /// the expected time in ns without that of its pairs, negative when none is left.
    double next(const Pairs &pairs, const ImageStars &stars, double side_sigmas,
                double scale_error, int32_t base[3]);

    int count() const { return count_; }

private:
    bool best(int most, double join_size, int32_t base[3]) const;
    void use(int32_t base[3]);
    bool is_used(int i, int j, int k) const;

    int count_ = 0;
    double *weight_ = nullptr;
    int32_t *ranked_ = nullptr;   // stars by weight
    double *expected_ = nullptr;  // (count, count) pairs n_ij of a side, -1 where not yet computed
    uint64_t *used_ = nullptr;    // bits, by the number of a triangle
};

}  // namespace st
