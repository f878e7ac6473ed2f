// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Four numbers at a time: what SSE of the oldest processor and NEON of any aarch64 have, so that one
// machine code serves all of them and no sum depends on the processor.

#pragma once

#include <cstring>

namespace st {

constexpr int LANES = 4;
using Lanes = float __attribute__((vector_size(LANES * sizeof(float))));

/// Return the numbers from an address on, of any alignment, and write them there.
inline Lanes load(const float *from) {
    Lanes lanes;
    std::memcpy(&lanes, from, sizeof(lanes));
    return lanes;
}

inline void store(float *to, Lanes lanes) {
    std::memcpy(to, &lanes, sizeof(lanes));
}

/// Two numbers of more digits.
constexpr int PAIR = 2;
using Pair = double __attribute__((vector_size(PAIR * sizeof(double))));

inline Pair load(const double *from) {
    Pair pair;
    std::memcpy(&pair, from, sizeof(pair));
    return pair;
}

inline void store(double *to, Pair pair) {
    std::memcpy(to, &pair, sizeof(pair));
}

inline Lanes all_of(float value) {
    return Lanes{value, value, value, value};
}

/// Return the greater ones; b where a is NaN.
inline Lanes greater(Lanes a, Lanes b) {
    return a > b ? a : b;
}

inline float sum(Lanes lanes) {
    return (lanes[0] + lanes[1]) + (lanes[2] + lanes[3]);
}

}  // namespace st
