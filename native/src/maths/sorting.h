// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Order and median of a few values, and a sort that any comparison is safe with.

#pragma once

#include <algorithm>

namespace st {

/// Standard deviation over median absolute deviation, of a normal distribution.
constexpr double SIGMA_PER_MAD = 1.4826;

/// Sort whole numbers, without the recursion of std::sort, and in no code of a C++ library.
inline void sort_ascending(int *items, int count) {
    std::make_heap(items, items + count);
    std::sort_heap(items, items + count);
}

/// Insert a value into the first count values, which ascend; there is room for one more.
inline void insert_sorted(double *ordered, int count, double value) {
    int slot = count;
    while (slot > 0 && ordered[slot - 1] > value) {
        ordered[slot] = ordered[slot - 1];
        --slot;
    }
    ordered[slot] = value;
}

/// Sort items so that before(a, b) holds for none b ahead of a; those that are equal keep their
/// order. work has room for as many. By merging: also where before() is not an order, as with NaN,
/// nothing is read or written beyond the items.
template <class T, class Before>
void sort(T *items, int count, T *work, Before before) {
    T *from = items, *to = work;
    for (int width = 1; width < count; width = width < count / 2 + 1 ? 2 * width : count) {
        for (int first = 0; first < count; first += 2 * width) {
            const int middle = first + width < count ? first + width : count;
            const int end = middle + width < count ? middle + width : count;
            int a = first, b = middle;
            for (int k = first; k < end; ++k) {
                const bool second = b < end && (a == middle || before(from[b], from[a]));
                to[k] = second ? from[b++] : from[a++];
            }
            if (end == count) {
                break;
            }
        }
        T *exchanged = from;
        from = to;
        to = exchanged;
    }
    if (from != items) {
        for (int k = 0; k < count; ++k) {
            items[k] = from[k];
        }
    }
}

/// Return the value of this rank, from 0, of count values, which change their order: selection by
/// halves (Hoare, Commun. ACM 4, 1961). NaN values have no defined rank.
template <class T>
T ranked(T *values, int count, int rank) {
    int low = 0, high = count - 1;
    while (low < high) {
        const T pivot = values[low + (high - low) / 2];
        int i = low, j = high;
        while (i <= j) {
            while (i < high && values[i] < pivot) {
                ++i;
            }
            while (j > low && pivot < values[j]) {
                --j;
            }
            if (i <= j) {
                const T moved = values[i];
                values[i++] = values[j];
                values[j--] = moved;
            }
        }
        if (rank <= j) {
            high = j;
        } else if (rank >= i) {
            low = i;
        } else {
            break;
        }
    }
    return values[rank];
}

/// Return the median of count values, of an even number the mean of the middle ones; they change
/// their order. 0 for none.
template <class T>
double median(T *values, int count) {
    if (count == 0) {
        return 0.0;
    }
    const double upper = static_cast<double>(ranked(values, count, count / 2));
    if (count % 2 != 0) {
        return upper;
    }
    return (static_cast<double>(ranked(values, count, count / 2 - 1)) + upper) / 2;
}

/// Return a quantile of count > 0 values, linear between those next to it; they change their
/// order.
inline double quantile(double *values, int count, double share) {
    const double place = share * (count - 1);
    const int below = static_cast<int>(place);
    const double low = ranked(values, count, below);
    const double high = below + 1 < count ? ranked(values, count, below + 1) : low;
    const double step = high - low, part = place - below;
    return part < 0.5 ? low + step * part : high - step * (1 - part);
}

}  // namespace st
