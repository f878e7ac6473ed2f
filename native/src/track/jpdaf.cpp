// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "track/jpdaf.h"

#include <algorithm>
#include <cmath>

namespace st {

void predict(const Matrix<4, 4> &F, const Matrix<4, 4> &Q, StarState &x, StarCovariance &P) {
    x = F * x;
    const Matrix<4, 4> half = F * P;
    for (int i = 0; i < 4; ++i) {
        for (int j = 0; j <= i; ++j) {
            double total = Q[i][j];
            for (int k = 0; k < 4; ++k) {
                total += half[i][k] * F[j][k];
            }
            // An asymmetry by rounding would grow from frame to frame.
            P[i][j] = P[j][i] = total;
        }
    }
}

namespace {

/// Drop the pairings of stars without a confirmed centroid, and those of other centroids.
void keep_confirmed(const int32_t *confirmed, Association &association, Arena &work) {
    const Arena::Scope scope(work);
    auto *is_confirmed = work.take<bool>(static_cast<size_t>(association.centroids));
    std::fill_n(is_confirmed, association.centroids, false);
    for (int n = 0; n < association.tracks; ++n) {
        if (confirmed[n] >= 0) {
            is_confirmed[confirmed[n]] = true;
        }
    }
    int count = 0, first = 0;
    for (int n = 0; n < association.tracks; ++n) {
        const int end = association.start[n + 1];
        for (int k = first; k < end; ++k) {
            if (confirmed[n] >= 0 && is_confirmed[association.pairing[k].centroid]) {
                association.pairing[count++] = association.pairing[k];
            }
        }
        first = end;
        association.start[n + 1] = count;
    }
    association.pairing.count = count;
}

/// Return the area in px^2 of all gates, of centroids of the mean error.
double gate_area(const Places &predicted, const Places &centroids, double gate) {
    double mean = 0.0, area = 0.0;
    for (int j = 0; j < centroids.count; ++j) {
        mean += centroids.error[j].uu;
    }
    mean = centroids.count > 0 ? mean / centroids.count : 0.0;
    for (int n = 0; n < predicted.count; ++n) {
        area += M_PI * gate * std::sqrt(determinant(predicted.error[n] + round_error(mean)));
    }
    return area;
}

int centroids_in_gates(const Association &association, Arena &work) {
    const Arena::Scope scope(work);
    auto *is_inside = work.take<bool>(static_cast<size_t>(association.centroids));
    std::fill_n(is_inside, association.centroids, false);
    int count = 0;
    for (const Pairing &one : association.pairing) {
        count += is_inside[one.centroid] ? 0 : 1;
        is_inside[one.centroid] = true;
    }
    return count;
}

/// Nodes of the Gauss-Laguerre rule, and the logarithms of its weights up to a common term.
///
/// Of the weight x^alpha e^-x: eigenvalues of the matrix with diagonal 2 k + 1 + alpha and
/// sqrt(k (k + alpha)) next to it, found by bisection with Sturm's sequence (Golub and Welsch,
/// Math. Comp. 23, 1969); the weight is one over the sum of the squared orthonormal polynomials.
class LaguerreRule {
public:
    LaguerreRule(int nodes, double alpha) : nodes_(nodes), alpha_(alpha) {}

    double node(int index) const {
        double low = 0.0, high = 4.0 * nodes_ + 2 * alpha_ + 6;
        double middle = (low + high) / 2;
        // As far as double precision goes.
        while (low < middle && middle < high) {
            (eigenvalues_below(middle) > index ? high : low) = middle;
            middle = (low + high) / 2;
        }
        return middle;
    }

    double log_weight(double x) const {
        double before = 0.0, p = 1.0, sum = 1.0, log_scale = 0.0;
        for (int k = 0; k + 1 < nodes_; ++k) {
            const double after = ((x - diagonal(k)) * p - beside(k) * before) / beside(k + 1);
            before = p;
            p = after;
            sum += p * p;
            if (sum > 1e200) {
                before *= 1e-100;
                p *= 1e-100;
                sum *= 1e-200;
                log_scale += 200 * std::log(10.0);
            }
        }
        return -std::log(sum) - log_scale;
    }

private:
    double diagonal(int k) const { return 2 * k + 1 + alpha_; }
    double beside(int k) const { return std::sqrt(k * (k + alpha_)); }

    int eigenvalues_below(double x) const {
        int count = 0;
        double pivot = 1.0;
        for (int k = 0; k < nodes_; ++k) {
            pivot = diagonal(k) - x - (k > 0 ? k * (k + alpha_) / pivot : 0.0);
            pivot = pivot == 0 ? 1e-300 : pivot;
            count += pivot < 0 ? 1 : 0;
        }
        return count;
    }

    int nodes_;
    double alpha_;
};

/// Make densities the probabilities with the factor phi! / V^phi, V = gates_px2; phi counts the
/// false ones of the centroids in a gate.
///
/// phi! / V^phi is the integral of (x / V)^phi e^-x over x >= 0, so a sum over events is that of
/// false centroids of the density x / V, integrated over x. No more centroids belong to stars than
/// there are stars: the sum is x^alpha times a polynomial, for which the rule is exact.
void diffuse(const DetectionModel &detection, double gates_px2, Association &association,
             Arena &work) {
    const Arena::Scope scope(work);
    const int gated = centroids_in_gates(association, work);
    if (gated == 0) {
        weigh_events(detection, 1.0, association);
        marginalise(association, MAX_STEPS, work);
        return;
    }
    const int tracks = association.tracks, most = std::min(tracks, gated);
    const LaguerreRule rule(most / 2 + 1, gated - most);
    const auto n = static_cast<size_t>(tracks);
    const auto pairs = static_cast<size_t>(association.pairing.count);
    auto *density = work.take<Pairing>(pairs);
    auto *missed = work.take<double>(n), *found = work.take<double>(pairs);
    std::copy_n(association.pairing.item, pairs, density);
    std::fill_n(missed, n, 0.0);
    std::fill_n(found, pairs, 0.0);
    double largest = -HUGE_VAL, total = 0.0;
    int left_out = 0;
    for (int node = 0; node < most / 2 + 1; ++node) {
        const double x = rule.node(node);
        std::copy_n(density, pairs, association.pairing.item);
        weigh_events(detection, x / gates_px2, association);
        const double log_weight =
            rule.log_weight(x) + most * std::log(x) + marginalise(association, MAX_STEPS, work);
        left_out = std::max(left_out, association.states_left_out);
        // Shares of the largest so far.
        const double rescale = log_weight > largest ? std::exp(largest - log_weight) : 1.0;
        largest = std::fmax(largest, log_weight);
        const double share = std::exp(log_weight - largest);
        total = rescale * total + share;
        for (size_t i = 0; i < n; ++i) {
            missed[i] = rescale * missed[i] + share * association.missed[i];
        }
        for (size_t k = 0; k < pairs; ++k) {
            found[k] = rescale * found[k] + share * association.pairing.item[k].value;
        }
    }
    for (size_t i = 0; i < n; ++i) {
        association.missed[i] = missed[i] / total;
    }
    for (size_t k = 0; k < pairs; ++k) {
        association.pairing.item[k].value = found[k] / total;
    }
    association.states_left_out = left_out;
}

}  // namespace

void associate_stars(const Places &predicted, const Places &centroids,
                     const DetectionModel &detection, st_association factor,
                     const int32_t *confirmed, Association &association, Arena &work) {
    gate_centroids(predicted, centroids, detection.gate, association, work);
    if (confirmed != nullptr) {
        keep_confirmed(confirmed, association, work);
    }
    if (factor == ST_DIFFUSE) {
        diffuse(detection, gate_area(predicted, centroids, detection.gate), association, work);
        return;
    }
    // One more than counted: the density must be positive.
    double clutter_px2 = 1.0;
    for (int j = 0; j < centroids.count; ++j) {
        clutter_px2 += association.unassociated[j] ? 1 : 0;
    }
    clutter_px2 /= detection.image_px2;
    if (factor == ST_NORMALISED) {
        // Each row and each column of the matrix of sums over all events, missed stars and false
        // centroids included, has the same total: one division normalises rows and columns. Without
        // a factor for a false centroid the sums are those of a density of one per px^2.
        clutter_px2 = 1.0;
    }
    weigh_events(detection, clutter_px2, association);
    marginalise(association, MAX_STEPS, work);
}

size_t associate_stars_bytes(int tracks, int centroids) {
    const auto n = static_cast<size_t>(tracks), m = static_cast<size_t>(centroids);
    const size_t pairs = n * std::min(m, static_cast<size_t>(MOST_PAIRINGS));
    return association_work_bytes(tracks, centroids) + Arena::padded<bool>(m) +
           Arena::padded<Pairing>(pairs) + Arena::padded<double>(pairs) + Arena::padded<double>(n);
}

namespace {

/// Fill in the gain K and the lower triangle of the covariance P_j of one centroid.
///
/// H takes u and v out of the state: S = H P H^T + R, K = P H^T S^-1, and in Joseph's form
/// P_j = (I - K H) P (I - K H)^T + K R K^T.
void update_by_one(const StarCovariance &P, double variance, Matrix<4, 2> &K,
                   StarCovariance &P_j) {
    const double uu = P[0][0] + variance, cross = P[0][2], vv = P[2][2] + variance;
    const double S = uu * vv - cross * cross;
    // Columns u and v of I - K H; the other two are those of I.
    Matrix<4, 2> rest;
    Matrix<4, 4> half;
    for (int i = 0; i < 4; ++i) {
        K[i][0] = (P[i][0] * vv - P[i][2] * cross) / S;
        K[i][1] = (P[i][2] * uu - P[i][0] * cross) / S;
        rest[i][0] = (i == 0 ? 1.0 : 0.0) - K[i][0];
        rest[i][1] = (i == 2 ? 1.0 : 0.0) - K[i][1];
    }
    for (int i = 0; i < 4; ++i) {
        for (int j = 0; j < 4; ++j) {
            half[i][j] = rest[i][0] * P[0][j] + rest[i][1] * P[2][j];
            if (i % 2 != 0) {
                half[i][j] += P[i][j];
            }
        }
        for (int j = 0; j <= i; ++j) {
            P_j[i][j] = half[i][0] * rest[j][0] + half[i][2] * rest[j][1] +
                        variance * (K[i][0] * K[j][0] + K[i][1] * K[j][1]);
            if (j % 2 != 0) {
                P_j[i][j] += half[i][j];
            }
        }
    }
}

}  // namespace

// The updates of single centroids are added up one after the other (Welford 1962). x_j = x + K_j z_j
// with covariance P_j; with B = beta_0 + .. + beta_j and d = x_j - mean:
//
//     mean += beta_j / B d,  B P += beta_j P_j + (B - beta_j) beta_j / B d d^T
//
// Differences of large numbers would make the covariance negative where a prior is far wider than R.
void update(const Association &association, int n, const Point *uv, const double *variance,
            StarState &x, StarCovariance &P) {
    double total = association.missed[n];
    StarState mean{};
    StarCovariance mixture, P_j;
    Matrix<4, 2> K;
    for (int i = 0; i < 4; ++i) {
        for (int j = 0; j < 4; ++j) {
            mixture[i][j] = total * P[i][j];
        }
    }
    for (const Pairing *one = association.begin(n); one < association.end(n); ++one) {
        const double beta = one->value;
        if (beta == 0) {
            continue;
        }
        update_by_one(P, variance[one->centroid], K, P_j);
        const double du = uv[one->centroid].x - x[0], dv = uv[one->centroid].y - x[2];
        const double share = beta / (total + beta);
        double d[4];
        for (int i = 0; i < 4; ++i) {
            d[i] = K[i][0] * du + K[i][1] * dv - mean[i];
            mean[i] += share * d[i];
        }
        for (int i = 0; i < 4; ++i) {
            for (int j = 0; j <= i; ++j) {
                mixture[i][j] += beta * P_j[i][j] + total * share * d[i] * d[j];
            }
        }
        total += beta;
    }
    for (int i = 0; i < 4; ++i) {
        x[i] += mean[i];
        for (int j = 0; j < i; ++j) {
            mixture[j][i] = mixture[i][j];
        }
    }
    P = mixture;
}

}  // namespace st
