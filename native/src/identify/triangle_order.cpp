// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "identify/triangle_order.h"

#include <algorithm>
#include <cmath>

#include "identify/pair_search.h"

namespace st {
namespace {

constexpr double PAIR_COST_NS = 3.0, JOIN_COST_NS = 3.0, SCAN_COST_NS = 3.0;
// Trust in each star over that in the next brighter one, of so many stars or fewer. Of more stars
// most are false, and brightness means less: the faintest is then trusted as the last of these.
constexpr double FAINTER_TRUST = 0.9;
constexpr int BRIGHT = 40;
// Triangles of the most trusted stars come first, then those of twice as many and so on.
constexpr int TRUSTED = 9;
constexpr int WORD = 64;

constexpr int64_t triangles_of(int64_t stars) {
    return stars * (stars - 1) * (stars - 2) / 6;
}

constexpr size_t words_of(int64_t stars) {
    return static_cast<size_t>((triangles_of(stars) + WORD - 1) / WORD);
}

/// Return the number of a triangle in the order of its greatest, middle and least star.
int64_t triangle_number(int i, int j, int k) {
    const int least = std::min(std::min(i, j), k), greatest = std::max(std::max(i, j), k);
    const int64_t middle = i + j + k - least - greatest;
    return triangles_of(greatest) + middle * (middle - 1) / 2 + least;
}

}  // namespace

TriangleOrder::TriangleOrder(int most_stars, Arena &arena) {
    const auto most = static_cast<size_t>(most_stars);
    weight_ = arena.take<double>(most);
    ranked_ = arena.take<int32_t>(most);
    expected_ = arena.take<double>(most * most);
    used_ = arena.take<uint64_t>(words_of(most_stars));
}

size_t TriangleOrder::bytes(int most_stars) {
    const auto most = static_cast<size_t>(most_stars);
    return Arena::padded<double>(most) + Arena::padded<int32_t>(most) +
           Arena::padded<double>(most * most) + Arena::padded<uint64_t>(words_of(most_stars));
}

void TriangleOrder::begin(int count) {
    count_ = count;
    const double fewer = static_cast<double>(BRIGHT) / std::max(count, 1);
    const double ratio = std::pow(FAINTER_TRUST, std::fmin(fewer, 1.0));
    for (int i = 0; i < count; ++i) {
        weight_[i] = std::pow(ratio, i);
        ranked_[i] = i;
    }
    std::fill(expected_, expected_ + static_cast<ptrdiff_t>(count) * count, -1.0);
    std::fill(used_, used_ + words_of(count), uint64_t{0});
}

double TriangleOrder::next(const Pairs &pairs, const ImageStars &stars, double side_sigmas,
                           double scale_error, int32_t base[3]) {
    // By insertion: few have changed their weight.
    for (int i = 1; i < count_; ++i) {
        const int32_t moved = ranked_[i];
        int j = i;
        for (; j > 0 && weight_[ranked_[j - 1]] < weight_[moved]; --j) {
            ranked_[j] = ranked_[j - 1];
        }
        ranked_[j] = moved;
    }
    const double join_size =
        static_cast<double>(std::max(pairs.stars, 1)) * band_count(scale_error);
    double scanned = TRIANGLE_COST_NS;
    for (int most = TRUSTED;; most *= 2) {
        most = std::min(most, count_);
        if (most > TRUSTED) {
            scanned += SCAN_COST_NS * std::pow(most, 3) / 6;
        }
        for (int x = 0; x < most; ++x) {
            for (int y = 0; y < x; ++y) {
                const ptrdiff_t i = ranked_[x], j = ranked_[y];
                if (expected_[i * count_ + j] < 0) {
                    const Side side = image_side(stars, side_sigmas, ranked_[x], ranked_[y]);
                    expected_[i * count_ + j] = expected_[j * count_ + i] =
                        expected_pairs(pairs, side, scale_error);
                }
            }
        }
        if (best(most, join_size, base)) {
            use(base);
            return scanned;
        }
        if (most == count_) {
            return -1.0;
        }
    }
}

bool TriangleOrder::best(int most, double join_size, int32_t base[3]) const {
    double greatest = 0.0;
    for (int x = 0; x < most; ++x) {
        const int32_t i = ranked_[x];
        const double *of_i = expected_ + static_cast<ptrdiff_t>(i) * count_;
        for (int y = 0; y < x; ++y) {
            const int32_t j = ranked_[y];
            const double *of_j = expected_ + static_cast<ptrdiff_t>(j) * count_;
            const double n_ij = of_i[j];
            if (n_ij == 0) {
                continue;
            }
            for (int z = 0; z < y; ++z) {
                const int32_t k = ranked_[z];
                const double n_ik = of_i[k], n_jk = of_j[k];
                if (n_ik == 0 || n_jk == 0) {
                    continue;
                }
                const double longest = std::max(std::max(n_ij, n_ik), n_jk);
                const double shorter = n_ij + n_ik + n_jk - longest;
                const double join = 4.0 * n_ij * n_ik * n_jk / longest / join_size;
                const double cost =
                    TRIANGLE_COST_NS + PAIR_COST_NS * shorter + JOIN_COST_NS * join;
                const double value = weight_[i] * weight_[j] * weight_[k] / cost;
                if (value > greatest && !is_used(i, j, k)) {
                    greatest = value;
                    base[0] = i;
                    base[1] = j;
                    base[2] = k;
                }
            }
        }
    }
    return greatest > 0;
}

bool TriangleOrder::is_used(int i, int j, int k) const {
    const int64_t number = triangle_number(i, j, k);
    return (used_[number / WORD] >> (number % WORD) & 1) != 0;
}

void TriangleOrder::use(int32_t base[3]) {
    const int32_t i = base[0], j = base[1], k = base[2];
    const int64_t number = triangle_number(i, j, k);
    used_[number / WORD] |= uint64_t{1} << (number % WORD);
    for (int m = 0; m < 3; ++m) {
        weight_[base[m]] /= 2;
    }
    const auto n = [this](ptrdiff_t a, ptrdiff_t b) { return expected_[a * count_ + b]; };
    if (n(i, k) >= std::fmax(n(i, j), n(j, k))) {
        base[0] = j;
        base[1] = i;
    } else if (n(i, j) >= std::fmax(n(i, k), n(j, k))) {
        base[0] = k;
        base[2] = i;
    }
}

}  // namespace st
