// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "fusion/history.h"

#include <cstring>

namespace st {

namespace {

size_t modes_size(int coefficients) {
    const auto n = static_cast<size_t>(CONSTANT + coefficients);
    return MODES * (n + n * n);
}

}  // namespace

void FusionEntry::store(const HeadFrame &of, int of_head, const BodyMotionState &motion) {
    frame = of;
    head = of_head;
    store(motion);
}

void FusionEntry::store(const BodyMotionState &motion) {
    const int n = motion.size();
    const size_t row = static_cast<size_t>(n) * sizeof(double);
    double *to = modes;
    summary = motion;
    for (const auto &mode : motion.mode) {
        std::memcpy(to, mode.mean.element, row);
        to += n;
        for (int i = 0; i < n; ++i, to += n) {
            std::memcpy(to, mode.covariance[i], row);
        }
    }
}

void FusionEntry::load(BodyMotionState &motion) const {
    static_cast<MotionSummary<MOST_CONSTANTS> &>(motion) = summary;
    const int n = motion.size();
    const size_t row = static_cast<size_t>(n) * sizeof(double);
    const double *from = modes;
    for (auto &mode : motion.mode) {
        std::memcpy(mode.mean.element, from, row);
        from += n;
        for (int i = 0; i < n; ++i, from += n) {
            std::memcpy(mode.covariance[i], from, row);
        }
    }
}

void FusionEntry::widen(const Columns &columns, double variance) {
    const int n = CONSTANT + summary.constants.count;
    for (int mode = 0; mode < MODES; ++mode) {
        double *P = modes + mode * (n + n * n) + n;
        for (int axis = 0; axis < 3; ++axis) {
            P[(CONSTANT + columns.first + axis) * (n + 1)] += variance;
        }
    }
}

size_t History::bytes(int capacity, int coefficients) {
    const auto entries = static_cast<size_t>(capacity) + 1;
    return Arena::padded<FusionEntry>(entries) + Arena::padded<int>(entries) +
           entries * Arena::padded<double>(modes_size(coefficients));
}

void History::start(int capacity, int coefficients, Arena &arena) {
    const auto entries = static_cast<size_t>(capacity) + 1;
    entries_ = arena.take<FusionEntry>(entries);
    order_ = arena.take<int>(entries);
    capacity_ = capacity;
    count_ = 0;
    for (int k = 0; k <= capacity; ++k) {
        order_[k] = k;
        entries_[k].modes = arena.take<double>(modes_size(coefficients));
    }
}

int History::place_of(int64_t stamp_ns) const {
    int index = count_;
    while (index > 0 && (*this)[index - 1].stamp_ns() > stamp_ns) {
        --index;
    }
    return index;
}

FusionEntry &History::insert(int index) {
    const int free = order_[count_];
    for (int k = count_; k > index; --k) {
        order_[k] = order_[k - 1];
    }
    order_[index] = free;
    ++count_;
    return (*this)[index];
}

void History::forget_until(int64_t stamp_ns) {
    while (count_ > 1 && ((*this)[1].stamp_ns() <= stamp_ns || count_ > capacity_)) {
        const int oldest = order_[0];
        for (int k = 1; k < count_; ++k) {
            order_[k - 1] = order_[k];
        }
        order_[--count_] = oldest;
    }
}

}  // namespace st
