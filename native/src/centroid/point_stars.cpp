// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/point_stars.h"

#include <cmath>

#include "centroid/misfit.h"
#include "centroid/noise_fit.h"
#include "centroid/shape.h"
#include "maths/sorting.h"

namespace st {
namespace {

constexpr int ROUGH_ITERATIONS = 2;
// Of the 5 x 5 around the peak: its flanks show where it is, but each pixel more than a few may
// have bloomed.
constexpr int MOST_SATURATED_PX = 24, FEW_SATURATED_PX = 4;
constexpr double BLOOMING_PX = 0.02;
constexpr double MOST_DRIFT_PX = 1.5;  // of a fit: one that ends further away is of something else
constexpr double SEPARATION_PX = 1.0;  // two closer fits are of one star
constexpr int STAR = -1;               // in addition to the kinds of st_rejection

double significance(const Fit<4> &fit) {
    return fit.star[FLUX] / std::sqrt(fit.covariance[FLUX][FLUX]);
}

/// Whether a fit ended far from its peak or is NaN.
bool drifted(const Star &star, const Peak &peak) {
    return !(std::hypot(star[U] - peak.u, star[V] - peak.v) < MOST_DRIFT_PX);
}

/// What the rough fit of a spot shows.
struct Spot {
    SpotMoments moments;
    bool narrow, wide, lone_pixel, elongated;
};

struct Measured {
    double u, v, error_px;
};

/// The spots of an image, count of them, and which are stars.
class Points {
public:
    Points(const Frame &frame, const Peak *peaks, int count, double sigma_px, Arena &arena)
        : frame_(frame),
          peaks_(peaks),
          count_(count),
          left_(0),
          radius_(window_radius(sigma_px)),
          arena_(arena),
          kind_(taken<int>()),
          chosen_(taken<int>()),
          where_(taken<Place>()),
          corner_(taken<Pixel>()),
          spot_(taken<Spot>()),
          fit_(taken<Fit<4>>()),
          measured_(taken<Measured>()),
          work_(*arena.take<FitWork>(1)),
          grey_(*arena.take<GreyWork>(1)) {
        const int border_px = static_cast<int>(std::ceil(EDGE_SIGMAS * sigma_px));
        for (int k = 0; k < count; ++k) {
            const Peak &peak = peaks[k];
            where_[k] = {static_cast<double>(peak.u), static_cast<double>(peak.v)};
            const int width = frame.image.width, height = frame.image.height;
            if (peak.u < border_px || peak.v < border_px || width - 1 - peak.u < border_px ||
                height - 1 - peak.v < border_px) {
                kind_[k] = ST_REJECTED_EDGE;
            } else if (saturated_core(frame, peak) > MOST_SATURATED_PX) {
                kind_[k] = ST_REJECTED_SATURATED;
            } else {
                kind_[k] = STAR;
                chosen_[left_] = k;
                fit_[left_++].star = initial_star(frame.kernel, peak, sigma_px);
            }
        }
    }

    /// Reject what has no star's shape and measure the noise; return whether all are smeared.
    bool fit_roughly(NoiseModel &noise) {
        const Arena::Scope scope(arena_);
        const Neighbours neighbours = sorted();
        const int side = 2 * radius_ + 1;
        NoiseFit noise_fit(left_, side * ((side + LANES - 1) / LANES * LANES), arena_);
        const auto use = [&](int i) {
            const Star &star = fit_[i].star;
            noise_fit.add(i, fit_[i], work_);
            const Width width = test_width(star, fit_[i].chi2, work_);
            const SpotMoments moments = spot_moments(star, work_);
            spot_[i] = {moments, width.narrow, width.wide, lone_pixel(work_.window),
                        is_elongated(moments)};
        };
        fit(neighbours, noise, ROUGH_ITERATIONS, use);
        const bool smeared = reject_shapes(neighbours);
        noise = noise_fit.refined(noise, [this](int i) {
            return kind_[chosen_[i]] == STAR && saturated_core(frame_, peaks_[chosen_[i]]) == 0;
        });
        keep_stars();
        return smeared;
    }

    void fit_finally(const NoiseModel &noise, const PointOptions &options) {
        const Arena::Scope scope(arena_);
        const Neighbours neighbours = sorted();
        const auto use = [&](int i) {
            if (options.method == ST_GAUSSIAN) {
                measured_[i] = position(i);
            } else {
                const WeightedMean mean = weighted_mean(options.method, fit_[i].star, noise,
                                                        options.segmentation, work_, grey_);
                measured_[i] = {mean.u, mean.v, mean.sigma_px};
            }
        };
        fit(neighbours, noise, ITERATIONS, use);
        for (int i = 0; i < left_; ++i) {
            const Star &star = fit_[i].star;
            int &kind = kind_[chosen_[i]];
            where_[chosen_[i]] = {star[U], star[V]};
            if (drifted(star, peaks_[chosen_[i]]) || is_duplicate(i, neighbours)) {
                kind = ST_REJECTED_NOT_FITTED;
            } else if (significance(fit_[i]) < FAINT * options.threshold_sigmas ||
                       !std::isfinite(measured_[i].u) || !(measured_[i].error_px > 0)) {
                kind = ST_REJECTED_FAINT;
            }
        }
    }

    /// Append the brightest stars, at most so many, and the others to rejections.
    void list(int most, List<st_centroid> &stars, Rejections &rejections) {
        const Arena::Scope scope(arena_);
        int *order = taken<int>(), *work = taken<int>(), count = 0;
        for (int i = 0; i < left_; ++i) {
            if (kind_[chosen_[i]] == STAR) {
                order[count++] = i;
            }
        }
        sort(order, count, work,
             [this](int a, int b) { return fit_[a].star[FLUX] > fit_[b].star[FLUX]; });
        for (int k = 0; k < count && k < most; ++k) {
            const Fit<4> &one = fit_[order[k]];
            const auto [u, v, error_px] = measured_[order[k]];
            const double variance = error_px * error_px;
            stars.add({u, v, one.star[FLUX], significance(one) / inflation(one.chi2, one.dof),
                       error_px, variance, 0.0, variance, 0.0, 0.0, 0.0, 0.0});
        }
        for (int kind = 0; kind < ST_REJECTED_COUNT; ++kind) {
            for (int k = 0; k < count_; ++k) {
                if (kind_[k] == kind) {
                    rejections.add(static_cast<st_rejection>(kind), where_[k].u, where_[k].v);
                }
            }
        }
    }

private:
    template <class T>
    T *taken() {
        return arena_.take<T>(static_cast<size_t>(count_));
    }

    /// Fit the stars that are left, and call use(i) for each.
    template <class Use>
    void fit(const Neighbours &neighbours, const NoiseModel &noise, int iterations, Use use) {
        const auto cut = [this](int i, Window &window) {
            cut_window(frame_, peaks_[chosen_[i]], radius_, window);
        };
        fit_stars(fit_, left_, neighbours, noise, iterations, cut, use, work_);
    }

    Neighbours sorted() {
        for (int i = 0; i < left_; ++i) {
            const Peak &peak = peaks_[chosen_[i]];
            corner_[i] = {peak.u - radius_, peak.v - radius_};
        }
        return {corner_, left_, 2 * radius_ + 1, arena_};
    }

    /// Set the kinds and the positions of spots that have no star's shape; return whether all are
    /// smeared.
    bool reject_shapes(const Neighbours &neighbours) {
        Smear smear;
        for (int i = 0; i < left_; ++i) {
            if (!spot_[i].narrow) {
                smear.add(spot_[i].moments);
            }
        }
        grow_elongated(neighbours);
        for (int i = 0; i < left_; ++i) {
            const Star &star = fit_[i].star;
            int &kind = kind_[chosen_[i]];
            where_[chosen_[i]] = {star[U], star[V]};
            if (spot_[i].narrow) {
                kind = spot_[i].lone_pixel ? ST_REJECTED_HOT_PIXEL : ST_REJECTED_COSMIC_RAY;
            } else if (spot_[i].elongated) {
                kind = ST_REJECTED_ELONGATED;
            } else if (spot_[i].wide) {
                kind = ST_REJECTED_TOO_WIDE;
            } else if (drifted(star, peaks_[chosen_[i]])) {
                kind = ST_REJECTED_NOT_FITTED;
            }
        }
        return smear.is_one();
    }

    /// Spots connected to an elongated one by neighbours are part of it: the fit of neighbours in
    /// turns cuts a long streak into round pieces.
    void grow_elongated(const Neighbours &neighbours) {
        for (bool grown = true; grown;) {
            grown = false;
            for (int i = 0; i < left_; ++i) {
                if (spot_[i].elongated) {
                    continue;
                }
                neighbours.each(i, [&](int j) {
                    if (spot_[j].elongated && !spot_[i].elongated) {
                        spot_[i].elongated = grown = true;
                    }
                });
            }
        }
    }

    void keep_stars() {
        int stars = 0;
        for (int i = 0; i < left_; ++i) {
            if (kind_[chosen_[i]] == STAR) {
                chosen_[stars] = chosen_[i];
                fit_[stars++] = fit_[i];
            }
        }
        left_ = stars;
    }

    /// Whether this is the fainter of two fits that are close.
    bool is_duplicate(int i, const Neighbours &neighbours) const {
        const Star &star = fit_[i].star;
        bool duplicate = false;
        neighbours.each(i, [&](int j) {
            const Star &other = fit_[j].star;
            duplicate |= star[FLUX] < other[FLUX] &&
                         std::hypot(star[U] - other[U], star[V] - other[V]) < SEPARATION_PX;
        });
        return duplicate;
    }

    Measured position(int i) const {
        const Fit<4> &one = fit_[i];
        const double variance = (one.covariance[U][U] + one.covariance[V][V]) / 2;
        const int bloomed = saturated_core(frame_, peaks_[chosen_[i]]) - FEW_SATURATED_PX;
        return {one.star[U], one.star[V],
                std::hypot(inflation(one.chi2, one.dof) * std::sqrt(variance),
                           BLOOMING_PX * (bloomed > 0 ? bloomed : 0))};
    }

    const Frame &frame_;
    const Peak *peaks_;
    int count_, left_, radius_;  // left_ are chosen: those of the peaks that may be stars
    Arena &arena_;
    int *kind_, *chosen_;
    Place *where_;
    Pixel *corner_;
    Spot *spot_;
    Fit<4> *fit_;
    Measured *measured_;
    FitWork &work_;
    GreyWork &grey_;
};

}  // namespace

bool measure_points(const Frame &frame, const Peak *peaks, int count, double sigma_px,
                    const PointOptions &options, int most, List<st_centroid> &stars,
                    Rejections &rejections, Arena &arena) {
    const Arena::Scope scope(arena);
    NoiseModel noise =
        initial_noise_model(frame.background_dn(), frame.noise_dn() * frame.noise_dn());
    Points points(frame, peaks, count, sigma_px, arena);
    const bool smeared = points.fit_roughly(noise);
    points.fit_finally(noise, options);
    points.list(most, stars, rejections);
    return smeared;
}

size_t points_bytes(int count) {
    const auto n = static_cast<size_t>(count);
    return Arena::padded<FitWork>(1) + Arena::padded<GreyWork>(1) + 5 * Arena::padded<int>(n) +
           Arena::padded<Place>(n) + Arena::padded<Pixel>(n) + Arena::padded<Spot>(n) +
           Arena::padded<Fit<5>>(n) + Arena::padded<Measured>(n) +
           2 * Arena::padded<float>(MOST_NOISE_PIXELS) + Arena::padded<double>(n);
}

int fit_free_sigma(const Frame &frame, const Peak *peaks, int count, const NoiseModel &noise,
                   double sigma_px, int iterations, FreeStar *stars, Arena &arena) {
    const Arena::Scope scope(arena);
    const auto n = static_cast<size_t>(count);
    const int radius = window_radius(sigma_px);
    FitWork &work = *arena.take<FitWork>(1);
    int *chosen = arena.take<int>(n), left = 0;
    Pixel *corner = arena.take<Pixel>(n);
    Fit<5> *fit = arena.take<Fit<5>>(n);
    for (int k = 0; k < count; ++k) {
        cut_window(frame, peaks[k], radius, work.window);
        if (saturated_core(frame, peaks[k]) == 0 && !lone_pixel(work.window)) {
            corner[left] = {peaks[k].u - radius, peaks[k].v - radius};
            fit[left].star = initial_star(frame.kernel, peaks[k], sigma_px);
            chosen[left++] = k;
        }
    }
    const Neighbours neighbours(corner, left, 2 * radius + 1, arena);
    fit_stars(
        fit, left, neighbours, noise, iterations,
        [&](int i, Window &window) { cut_window(frame, peaks[chosen[i]], radius, window); },
        [&](int i) {
            stars[i] = {fit[i], !drifted(fit[i].star, peaks[chosen[i]]) &&
                                    !is_elongated(spot_moments(fit[i].star, work))};
        },
        work);
    return left;
}

}  // namespace st
