// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Values of plain numbers, as arrays of them that tests give and take.

#ifndef STARTRACKER_TEST_NUMBERS_H
#define STARTRACKER_TEST_NUMBERS_H

#include <cstring>

/// Return a value of plain numbers out of an array, and into one.
template <class T>
T from(const double *numbers) {
    T value;
    std::memcpy(&value, numbers, sizeof(T));
    return value;
}

template <class T>
void into(double *numbers, const T &value) {
    std::memcpy(numbers, &value, sizeof(T));
}

#endif
