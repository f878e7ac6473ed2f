// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Four numbers at a time: what SSE of the oldest processor and NEON of any aarch64 have, so that one
// machine code serves all of them and no sum depends on the processor.

#pragma once

#include <cstring>

namespace st {

/// What one register has of them.
template <class T>
struct Register {
    typedef T Type __attribute__((vector_size(16)));  // `using` takes no attribute with g++
};
using Lanes = Register<float>::Type;
using Pair = Register<double>::Type;  // of more digits
constexpr int LANES = 4, PAIR = 2;

/// Return the numbers from an address on, of any alignment, and write them there.
template <class T>
typename Register<T>::Type load(const T *from) {
    typename Register<T>::Type numbers;
    std::memcpy(&numbers, from, sizeof(numbers));
    return numbers;
}

template <class T>
void store(T *to, typename Register<T>::Type numbers) {
    std::memcpy(to, &numbers, sizeof(numbers));
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
