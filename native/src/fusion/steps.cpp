// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "fusion/steps.h"

#include <cmath>

#include "fusion/head.h"
#include "maths/jacobi.h"

namespace st {

namespace {

constexpr int LEAST_FRAMES = 3;                    // of each head in a block
constexpr int LEAST_BEFORE = 12, LEAST_AFTER = 6;  // blocks
// Chi-square of a step about three axes: chance exceeds it in one of 1e10 blocks.
constexpr double THRESHOLD = 50.0;
constexpr double LEAST_SCATTER =
    1e-3;  // of frames, of the variance that they are expected to have
constexpr double LEAST_STRENGTH = 1e-6;   // of a singular value, of the largest one
constexpr double LEAST_RAD = 2 * ARCSEC;  // faster bending than the law of the window
constexpr int64_t BLOCK_NS = static_cast<int64_t>(BLOCK_S) * 1'000'000'000;
constexpr int SHAPES = 3 + MOST_LAW;  // columns of what is not a step: a parabola and the law

/// Orthonormal columns that span those of a matrix (rows, columns).
struct Basis {
    int columns;
    double of[MOST_BLOCKS][SHAPES];
};

/// Return the basis of the columns of A whose singular values are not negligible: A = Q R by Gram
/// and Schmidt, twice (Golub and Van Loan, 5.2.9), R = U S V^T, and the basis is Q U.
Basis basis_of(double (&A)[MOST_BLOCKS][SHAPES], int rows) {
    Matrix<SHAPES, SHAPES> R{};
    for (int k = 0; k < SHAPES; ++k) {
        for (int pass = 0; pass < 2; ++pass) {
            for (int j = 0; j < k; ++j) {
                double along = 0.0;
                for (int i = 0; i < rows; ++i) {
                    along += A[i][j] * A[i][k];
                }
                R[j][k] += along;
                for (int i = 0; i < rows; ++i) {
                    A[i][k] -= along * A[i][j];
                }
            }
        }
        double square = 0.0;
        for (int i = 0; i < rows; ++i) {
            square += A[i][k] * A[i][k];
        }
        R[k][k] = std::sqrt(square);
        for (int i = 0; i < rows; ++i) {
            A[i][k] = R[k][k] > 0 ? A[i][k] / R[k][k] : 0.0;
        }
    }
    const Singular<SHAPES> found = singular_values(R);
    Basis basis{};
    for (int k = 0; k < SHAPES; ++k) {
        // A law that does not vary in the window has no column of its own.
        if (!(found.value[k] > LEAST_STRENGTH * found.value[SHAPES - 1])) {
            continue;
        }
        for (int i = 0; i < rows; ++i) {
            double sum = 0.0;
            for (int j = 0; j < SHAPES; ++j) {
                sum += A[i][j] * found.US[j][k] / found.value[k];
            }
            basis.of[i][basis.columns] = sum;
        }
        ++basis.columns;
    }
    return basis;
}

/// Size of a step about an axis, and the square of its strength: 1 over its variance.
struct AxisStep {
    double size, square;
};

/// Fit a step from a row on together with the smooth columns: with the step s, the weights w and
/// the projection P on the basis, size is s_p^T w d / s_p^T s_p, s_p = (1 - P) w s.
AxisStep fit_step(const Basis &basis, const double *weight, const double *weighted, int rows,
                  int from) {
    double s[MOST_BLOCKS];
    for (int i = 0; i < rows; ++i) {
        s[i] = i >= from ? weight[i] : 0.0;
    }
    double along[SHAPES] = {};
    for (int k = 0; k < basis.columns; ++k) {
        for (int i = from; i < rows; ++i) {
            along[k] += basis.of[i][k] * s[i];
        }
    }
    AxisStep step{0.0, 0.0};
    for (int i = 0; i < rows; ++i) {
        for (int k = 0; k < basis.columns; ++k) {
            s[i] -= basis.of[i][k] * along[k];
        }
        step.square += s[i] * s[i];
        step.size += s[i] * weighted[i];
    }
    step.square = step.square > 1e-30 ? step.square : 1e-30;
    step.size /= step.square;
    return step;
}

}  // namespace

bool find_step(const Series &series, st_mount_step &step) {
    const int n = series.count, candidates = n - LEAST_BEFORE;
    if (candidates < LEAST_AFTER) {
        return false;
    }
    const int64_t first = series.of[0].number, last = series.of[n - 1].number;
    const double span = static_cast<double>(last > first ? last - first : 1);
    AxisStep steps[MOST_BLOCKS][3];
    for (int axis = 0; axis < 3; ++axis) {
        // The mean over the window: the scatter within a block is a poor measure of few frames.
        double ratio = 0.0;
        for (int i = 0; i < n; ++i) {
            ratio += series.of[i].scatter[axis] / series.of[i].variance[axis];
        }
        ratio = ratio / n > LEAST_SCATTER ? ratio / n : LEAST_SCATTER;
        double weight[MOST_BLOCKS], weighted[MOST_BLOCKS], smooth[MOST_BLOCKS][SHAPES];
        for (int i = 0; i < n; ++i) {
            const Difference &one = series.of[i];
            const double t = static_cast<double>(one.number - first) / span;
            weight[i] = 1 / std::sqrt(one.variance[axis] * ratio);
            weighted[i] = weight[i] * one.offset_rad[axis];
            smooth[i][0] = weight[i] * t * t;
            smooth[i][1] = weight[i] * t;
            smooth[i][2] = weight[i];
            for (int k = 0; k < MOST_LAW; ++k) {
                smooth[i][3 + k] = k < one.law.count ? weight[i] * one.law.phi[k] : 0.0;
            }
        }
        const Basis basis = basis_of(smooth, n);
        for (int c = 0; c < candidates; ++c) {
            steps[c][axis] = fit_step(basis, weight, weighted, n, LEAST_BEFORE + c);
        }
    }
    int best = 0;
    double largest = -1.0;
    for (int c = 0; c < candidates; ++c) {
        double chi2 = 0.0;
        for (const AxisStep &axis : steps[c]) {
            chi2 += axis.size * axis.size * axis.square;
        }
        if (chi2 > largest) {
            largest = chi2;
            best = c;
        }
    }
    step = {series.of[LEAST_BEFORE + best].number * BLOCK_NS, {}, {}, 0, 0};
    Vector3 size;
    for (int axis = 0; axis < 3; ++axis) {
        size[axis] = step.size_rad[axis] = steps[best][axis].size;
        step.sigma_rad[axis] = 1 / std::sqrt(steps[best][axis].square);
    }
    // One that is too new cannot be dated.
    return best <= candidates - LEAST_AFTER && largest >= THRESHOLD && norm(size) >= LEAST_RAD;
}

void StepDetector::start(int heads, Series *series) {
    heads_ = heads;
    series_ = series;
    restart();
}

void StepDetector::restart() {
    has_block_ = false;
    for (int head = 0; head < heads_; ++head) {
        series_[head].count = 0;
        block_[head] = {};
    }
}

void StepDetector::add(int head, int64_t stamp_ns, const Vector3 &offset_rad,
                       const Vector3 &variance_rad2, const Law &law, List<st_mount_step> &found) {
    const int64_t number =
        stamp_ns >= 0 ? stamp_ns / BLOCK_NS : -((-stamp_ns + BLOCK_NS - 1) / BLOCK_NS);
    if (!has_block_ || number > number_) {
        close(found);
        has_block_ = true;
        number_ = number;
        for (StepBlock &block : block_) {
            block = {};
        }
    }
    if (number != number_) {
        return;
    }
    StepBlock &block = block_[head];
    ++block.count;
    for (int axis = 0; axis < 3; ++axis) {
        block.weight[axis] += 1 / variance_rad2[axis];
        block.total[axis] += offset_rad[axis] / variance_rad2[axis];
        block.squares[axis] += offset_rad[axis] * offset_rad[axis] / variance_rad2[axis];
    }
    block.law.count = law.count;
    for (int k = 0; k < law.count; ++k) {
        block.law.phi[k] += law.phi[k];
    }
}

/// Add the differences of the block to their series and look for steps.
void StepDetector::close(List<st_mount_step> &found) {
    const StepBlock &reference = block_[0];
    if (!has_block_ || reference.count < LEAST_FRAMES) {
        return;
    }
    for (int head = 1; head < heads_; ++head) {
        const StepBlock &block = block_[head];
        if (block.count < LEAST_FRAMES) {
            continue;
        }
        Difference one{number_, {}, {}, {}, block.law};
        const StepBlock *const parts[] = {&block, &reference};
        for (int axis = 0; axis < 3; ++axis) {
            for (const StepBlock *of : parts) {
                const double mean = of->total[axis] / of->weight[axis];
                const double scatter =
                    (of->squares[axis] - of->weight[axis] * mean * mean) / (of->count - 1);
                one.offset_rad[axis] += of == &block ? mean : -mean;
                one.variance[axis] += 1 / of->weight[axis];
                one.scatter[axis] += scatter / of->weight[axis];
            }
        }
        for (double &phi : one.law.phi) {
            phi /= block.count;
        }
        Series &series = series_[head];
        const auto keep_from = [&](int first) {
            for (int i = first; i < series.count; ++i) {
                series.of[i - first] = series.of[i];
            }
            series.count -= first;
        };
        if (series.count == MOST_BLOCKS) {
            keep_from(1);
        }
        series.of[series.count++] = one;
        int old = 0;
        while (static_cast<double>(number_ - series.of[old].number) * BLOCK_S > WINDOW_S) {
            ++old;
        }
        keep_from(old);
        st_mount_step step;
        if (find_step(series, step)) {
            step.head = head;
            found.add(step);
            // What comes next is compared with what is after the step.
            int before = 0;
            while (before < series.count && series.of[before].number * BLOCK_NS < step.stamp_ns) {
                ++before;
            }
            keep_from(before);
        }
    }
}

}  // namespace st
