// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/gaussian_fit.h"

#include <cmath>

namespace st {
namespace {

constexpr double MOST_STEP_PX = 0.7, MOST_SIGMA_STEP_PX = 0.3;
constexpr double LEAST_SIGMA_PX = 0.2, MOST_SIGMA_PX = 8.0;
constexpr double LEAST_FLUX_DN = 1e-3;

/// Return value, no less than least and no more than most; NaN stays.
double limited(double value, double least, double most) {
    value = value < least ? least : value;
    return value > most ? most : value;
}

/// What the weights and residuals of the pixels of a window are made of; the variance is that of
/// noise.h in float.
class Pixels {
public:
    Pixels(const Star &star, const NoiseModel &noise, const FitWork &work)
        : flux_(static_cast<float>(star[FLUX])),
          level_(static_cast<float>(star[LEVEL])),
          background_(static_cast<float>(work.window.variance)),
          gain_(static_cast<float>(noise.gain_dn)),
          square_(static_cast<float>(noise.model_error * noise.model_error)) {}

    float flux_of_row(const Profile<float> &rows, int y) const { return flux_ * rows.share[y]; }

    /// Return the weights of pixels that are used, 1 or 0, with this flux.
    Lanes weight(Lanes used, Lanes flux) const {
        flux = greater(flux, Lanes{});
        return used / (background_ + flux * (gain_ + square_ * flux));
    }

    /// Return data without the level.
    Lanes above_level(Lanes data) const { return data - level_; }

private:
    float flux_, level_, background_, gain_, square_;
};

template <int P, bool LONE>
double equations_of(const Star &star, const NoiseModel &noise, FitWork &work, Matrix<P, P> &N,
                    Vector<P> &g) {
    const Window &window = work.window;
    const Pixels pixels(star, noise, work);
    Equations<P> equations;
    for (int x = 0; x < window.filled; x += LANES) {
        const Lanes a = load(work.columns.share + x);
        ColumnSums sums;
        for (int y = 0; y < window.count; ++y) {
            const int k = y * window.filled + x;
            const Lanes model = pixels.flux_of_row(work.rows, y) * a;
            Lanes flux = model, data = load(window.data + k);
            if constexpr (!LONE) {
                const Lanes others = load(work.neighbours + k);
                flux += others;
                data -= others;
            }
            sums.add<P>(pixels.weight(load(window.used + k), flux),
                        pixels.above_level(data) - model, work.rows.share[y],
                        work.rows.d_centre[y], work.rows.d_sigma[y]);
        }
        equations.add(sums, work.columns, x);
    }
    return equations.solve_for(star[FLUX], N, g);
}

}  // namespace

template <int P>
double normal_equations(const Star &star, const NoiseModel &noise, bool lone, FitWork &work,
                        Matrix<P, P> &N, Vector<P> &g) {
    const Window &window = work.window;
    profile(star[U], star[SIGMA], window.left, window.filled, work.columns);
    profile(star[V], star[SIGMA], window.top, window.count, work.rows);
    return lone ? equations_of<P, true>(star, noise, work, N, g)
                : equations_of<P, false>(star, noise, work, N, g);
}

template double normal_equations(const Star &, const NoiseModel &, bool, FitWork &, Matrix<4, 4> &,
                                 Vector<4> &);
template double normal_equations(const Star &, const NoiseModel &, bool, FitWork &, Matrix<5, 5> &,
                                 Vector<5> &);

template <int P>
double move(Star &star, const Matrix<P, P> &covariance, const Vector<P> &g) {
    double length = 0.0;
    for (int p = 0; p < P; ++p) {
        double step = 0.0;
        for (int q = 0; q < P; ++q) {
            step += covariance[p][q] * g[q];
        }
        if (p == U || p == V) {
            step = limited(step, -MOST_STEP_PX, MOST_STEP_PX);
        } else if (p == SIGMA) {
            step = limited(step, -MOST_SIGMA_STEP_PX, MOST_SIGMA_STEP_PX);
        }
        star[p] += step;
        if (p == U || p == V || p == SIGMA) {
            length = length < std::fabs(step) ? std::fabs(step) : length;
        }
    }
    star[FLUX] = star[FLUX] < LEAST_FLUX_DN ? LEAST_FLUX_DN : star[FLUX];
    star[SIGMA] = limited(star[SIGMA], LEAST_SIGMA_PX, MOST_SIGMA_PX);
    return length;
}

template double move(Star &, const Matrix<4, 4> &, const Vector<4> &);
template double move(Star &, const Matrix<5, 5> &, const Vector<5> &);

void clear_neighbours(FitWork &work) {
    for (int k = 0; k < work.window.area(); k += LANES) {
        store(work.neighbours + k, Lanes{});
    }
}

void add_neighbour(const Star &star, FitWork &work) {
    const Window &window = work.window;
    profile(star[U], star[SIGMA], window.left, window.filled, work.other_columns);
    profile(star[V], star[SIGMA], window.top, window.count, work.other_rows);
    for (int y = 0; y < window.count; ++y) {
        const float flux = static_cast<float>(star[FLUX]) * work.other_rows.share[y];
        float *line = work.neighbours + window.row(y);
        for (int x = 0; x < window.filled; x += LANES) {
            store(line + x, load(line + x) + flux * load(work.other_columns.share + x));
        }
    }
}

void set_model(const Star &star, const NoiseModel &noise, bool lone, FitWork &work) {
    const Window &window = work.window;
    const Pixels pixels(star, noise, work);
    for (int y = 0; y < window.count; ++y) {
        const float df = pixels.flux_of_row(work.rows, y);
        for (int x = 0; x < window.filled; x += LANES) {
            const int k = y * window.filled + x;
            const Lanes model = df * load(work.columns.share + x);
            const Lanes others = lone ? Lanes{} : load(work.neighbours + k);
            store(work.model + k, model);
            store(work.own + k, pixels.above_level(load(window.data + k) - others));
            store(work.weight + k, pixels.weight(load(window.used + k), model + others));
        }
    }
}

}  // namespace st
