// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "identify/triangles.h"

#include <algorithm>
#include <cmath>

namespace st {
namespace {

// A triangle flatter than this many sigmas of its own height has no sure handedness.
constexpr double FLAT_SIGMAS = 4.0;
// Steps of a search are members of its lists and joins, of this expected time in ns. To look up the
// support of a triangle takes as long as so many. Work is counted after so many at least.
constexpr double STEP_NS = 1.5;
// So many stars are in the caches of a processor. Of more, a step takes longer by the cube root of
// how many times as many: of 60,000 1.8 times as long was measured, of a million 5 times.
constexpr double CACHED_STARS = 10000.0;
constexpr int64_t SUPPORT_STEPS = 250, COUNTED_STEPS = 20000;
// Candidates with a third of the support of the best one or less are chance.
constexpr double LEAST_SHARE = 3.0;
// Entries of side ac that are joined together.
constexpr int JOINED_TOGETHER = 512;

/// Entries of ac and ab of the same star a.
struct Joined {
    int32_t ac, ab;
};

double volume_of(const double *a, const double *b, const double *c) {
    return a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) +
           a[2] * (b[0] * c[1] - b[1] * c[0]);
}

double squared_chord(double angle_rad) {
    const double chord = 2 * std::sin(std::fmin(std::fmax(angle_rad, 0.0), M_PI) / 2);
    return chord * chord;
}

double step_ns(const Pairs &pairs) {
    return STEP_NS * std::fmax(std::cbrt(pairs.stars / CACHED_STARS), 1.0);
}

}  // namespace

ImageTriangle image_triangle(const ImageStars &stars, const int32_t base[3], double side_sigmas) {
    const Side ab = image_side(stars, side_sigmas, base[0], base[1]);
    const Side ac = image_side(stars, side_sigmas, base[0], base[2]);
    const Side bc = image_side(stars, side_sigmas, base[1], base[2]);
    const double norm = ab.weight * ab.theta + ac.weight * ac.theta + bc.weight * bc.theta;
    const double volume =
        volume_of(stars.direction[base[0]].element, stars.direction[base[1]].element,
                  stars.direction[base[2]].element);
    const double rho = std::fmax(std::fmax(ab.rho, ac.rho), bc.rho);
    const double longest = std::fmax(std::fmax(ab.theta, ac.theta), bc.theta);
    return {ab,   ac,     bc,
            norm, volume, std::fabs(volume) < rho / side_sigmas * FLAT_SIGMAS * longest};
}

void TriangleSearch::begin(const Verifier &verifier, const ImageStars &stars,
                           const int32_t base[3], int32_t *latest) {
    triangle_ = image_triangle(stars, base, verifier.side_sigmas);
    supporters_ = supporters(verifier.sky.in_cells, stars, base, verifier.tolerance_sigmas);
    latest_ = latest;
    next_band_ = 0;
    phase_ = NEXT_BAND;
    std::fill(support_, support_ + MOST_VERIFIED, 0.0);
}

void TriangleSearch::begin_band(const Verifier &verifier, const Pairs &pairs) {
    const double error = verifier.scale_error;
    band_ = scale_band(next_band_++, band_count(error), error);
    ab_ = entries_of(pairs, triangle_.ab, band_);
    ac_ = entries_of(pairs, triangle_.ac, band_);
    const Side &bc = triangle_.bc;
    const double middle = band_.centre * bc.theta, slack = bc.rho + band_.half * bc.theta;
    low2_ = squared_chord(middle - slack);
    high2_ = squared_chord(middle + slack);
    entry_ = ab_.first;
    steps_ = 0;
    phase_ = LISTING;
}

bool TriangleSearch::proceed(const Verifier &verifier, const Pairs &pairs, Work &work,
                             double &tested) {
    while (phase_ != DONE) {
        if (phase_ == NEXT_BAND) {
            if (next_band_ == band_count(verifier.scale_error)) {
                phase_ = DONE;
                break;
            }
            begin_band(verifier, pairs);
        }
        if (phase_ == LISTING) {
            // The last entry of each star within the range of ab. Numbers outside of it are left
            // over from other ranges: their stars have no entry in it. The others are reached by
            // previous, as long as they are not below the range.
            const int64_t end = std::min(ab_.end, entry_ + COUNTED_STEPS);
            steps_ += end - entry_;
            for (; entry_ < end; ++entry_) {
                latest_[pairs.member[entry_]] = static_cast<int32_t>(entry_);
            }
            if (entry_ == ab_.end) {
                phase_ = JOINING;
                entry_ = ac_.first;
            }
        } else {
            if (join(verifier, pairs, tested)) {
                phase_ = DONE;
                break;
            }
            if (entry_ == ac_.end) {
                phase_ = NEXT_BAND;
            }
        }
        if (steps_ >= COUNTED_STEPS || phase_ == NEXT_BAND) {
            work.done_ns += step_ns(pairs) * static_cast<double>(steps_);
            steps_ = 0;
            if (work.is_over()) {
                phase_ = DONE;
            } else if (work.is_paused()) {
                return false;
            }
        }
    }
    return true;
}

/// Join pairs ac with the pairs ab of the same star a, until steps are to be counted; whether a
/// candidate is decisive.
bool TriangleSearch::join(const Verifier &verifier, const Pairs &pairs, double &tested) {
    const int32_t *member = pairs.member, *previous = pairs.previous;
    const double (*direction)[3] = pairs.direction;
    const auto first = static_cast<int32_t>(ab_.first);
    const auto range = static_cast<uint32_t>(ab_.end - ab_.first);
    Joined joined[JOINED_TOGETHER];
    while (entry_ < ac_.end && steps_ < COUNTED_STEPS) {
        const int64_t end = std::min(ac_.end, entry_ + JOINED_TOGETHER);
        steps_ += end - entry_;
        // Without branches: whether a star is in both ranges is not predictable.
        int count = 0;
        for (; entry_ < end; ++entry_) {
            const int32_t ab = latest_[member[entry_]];
            joined[count] = {static_cast<int32_t>(entry_), ab};
            count += static_cast<uint32_t>(ab) - static_cast<uint32_t>(first) < range;
        }
        while (count > 0) {
            steps_ += count;
            int left = 0;
            for (int row = 0; row < count; ++row) {
                const auto [ac, ab] = joined[row];
                const int32_t before = previous[ab];
                joined[left] = {ac, before};
                left += before >= first;
                const double *B = direction[member[ab ^ 1]], *C = direction[member[ac ^ 1]];
                const double x = B[0] - C[0], y = B[1] - C[1], z = B[2] - C[2];
                const double chord2 = x * x + y * y + z * z;
                if (low2_ <= chord2 && chord2 <= high2_ && fits(pairs, ab, ac, chord2)) {
                    ++tested;
                    steps_ += SUPPORT_STEPS;
                    if (weigh(verifier, pairs.star[member[ac]], pairs.star[member[ab ^ 1]],
                              pairs.star[member[ac ^ 1]])) {
                        return true;
                    }
                }
            }
            count = left;
        }
    }
    return false;
}

/// Look up the support of a candidate; whether it is decisive.
bool TriangleSearch::weigh(const Verifier &verifier, int32_t a, int32_t b, int32_t c) {
    const double enough = std::max(support_[MOST_VERIFIED - 1], support_[0] / LEAST_SHARE);
    const double found = support(verifier.sky, supporters_, a, b, c, enough);
    keep(a, b, c, found);
    return found >= DECISIVE;
}

/// Whether two joined entries fit: the three sides with one common scale, and the handedness.
bool TriangleSearch::fits(const Pairs &pairs, int32_t entry_ab, int32_t entry_ac,
                          double chord2) const {
    const auto &[ab, ac, bc, norm, volume, flat] = triangle_;
    const double d_ab = pairs.separation_rad[entry_ab >> 1];
    const double d_ac = pairs.separation_rad[entry_ac >> 1];
    const double d_bc = 2 * std::asin(std::sqrt(chord2) / 2);
    const double s = (d_ab * ab.weight + d_ac * ac.weight + d_bc * bc.weight) / norm;
    const auto direction = [&pairs](int32_t entry) {
        return pairs.direction[pairs.member[entry]];
    };
    return band_.low <= s && s < band_.high && std::fabs(d_ab - s * ab.theta) <= ab.rho &&
           std::fabs(d_ac - s * ac.theta) <= ac.rho && std::fabs(d_bc - s * bc.theta) <= bc.rho &&
           (flat ||
            volume_of(direction(entry_ac), direction(entry_ab ^ 1), direction(entry_ac ^ 1)) *
                    volume >
                0);
}

/// Insert a triangle of so much support into the best ones, the most first.
void TriangleSearch::keep(int32_t a, int32_t b, int32_t c, double support) {
    int row = MOST_VERIFIED - 1;
    if (support <= support_[row]) {
        return;
    }
    for (; row > 0 && support_[row - 1] < support; --row) {
        support_[row] = support_[row - 1];
        std::copy(best_[row - 1], best_[row - 1] + 3, best_[row]);
    }
    support_[row] = support;
    best_[row][0] = a;
    best_[row][1] = b;
    best_[row][2] = c;
}

int TriangleSearch::count() const {
    int count = 0;
    while (count < MOST_VERIFIED && support_[count] > support_[0] / LEAST_SHARE) {
        ++count;
    }
    return count;
}

}  // namespace st
