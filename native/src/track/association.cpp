// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "track/association.h"

#include <algorithm>
#include <cmath>

#include "maths/sorting.h"

namespace st {

DetectionModel detection_model(const st_tracking_options &options, const Lens &lens) {
    // In two dimensions chi-square exceeds x with the probability e^(-x / 2).
    return {-2 * std::log1p(-options.gate_probability), options.gate_probability,
            options.detection_probability, static_cast<double>(lens.width) * lens.height};
}

const Pairing *Association::best(int track) const {
    const Pairing *found = nullptr;
    for (const Pairing *one = begin(track); one < end(track); ++one) {
        if (found == nullptr || one->value > found->value) {
            found = one;
        }
    }
    return found;
}

namespace {

size_t most_pairings(int tracks, int centroids) {
    return static_cast<size_t>(tracks) * static_cast<size_t>(std::min(centroids, MOST_PAIRINGS));
}

}  // namespace

size_t association_bytes(int tracks, int centroids) {
    const auto n = static_cast<size_t>(tracks), m = static_cast<size_t>(centroids);
    return Arena::padded<double>(n) + Arena::padded<int32_t>(n + 1) +
           Arena::padded<Pairing>(most_pairings(tracks, centroids)) + Arena::padded<bool>(m);
}

Association association_for(int tracks, int centroids, Arena &arena) {
    const auto n = static_cast<size_t>(tracks), m = static_cast<size_t>(centroids);
    Association association{};
    association.tracks = tracks;
    association.centroids = centroids;
    association.missed = arena.take<double>(n);
    association.start = arena.take<int32_t>(n + 1);
    association.pairing = arena.list<Pairing>(most_pairings(tracks, centroids));
    association.unassociated = arena.take<bool>(m);
    std::fill_n(association.missed, n, 1.0);
    std::fill_n(association.start, n + 1, 0);
    std::fill_n(association.unassociated, m, true);
    return association;
}

void associate(const Places &predicted, const Places &centroids, const DetectionModel &detection,
               Association &association, Arena &work) {
    gate_centroids(predicted, centroids, detection.gate, association, work);
    // One more than counted: the density must be positive.
    int clutter = 1;
    for (int j = 0; j < centroids.count; ++j) {
        clutter += association.unassociated[j] ? 1 : 0;
    }
    weigh_events(detection, clutter / detection.image_px2, association);
    marginalise(association, MAX_STEPS, work);
}

void gate_centroids(const Places &predicted, const Places &centroids, double gate,
                    Association &association, Arena &work) {
    const Arena::Scope scope(work);
    const auto m = static_cast<size_t>(centroids.count);
    auto *inside = work.take<Pairing>(m);
    auto *density = work.take<double>(m);
    association.pairing.clear();
    association.states_left_out = 0;
    association.tracks = predicted.count;
    association.centroids = centroids.count;
    std::fill_n(association.unassociated, m, true);
    association.start[0] = 0;
    for (int n = 0; n < predicted.count; ++n) {
        const Point expected = predicted.uv[n];
        const Covariance2 P = predicted.error[n];
        int count = 0;
        for (int j = 0; j < centroids.count; ++j) {
            const double du = centroids.uv[j].x - expected.x;
            const double uu = P.uu + centroids.error[j].uu;
            // Outside on one axis is outside: true of most pairs.
            if (du * du > gate * uu) {
                continue;
            }
            const double dv = centroids.uv[j].y - expected.y;
            const double vv = P.vv + centroids.error[j].vv;
            if (dv * dv > gate * vv) {
                continue;
            }
            const double uv = P.uv + centroids.error[j].uv, S = uu * vv - uv * uv;
            const double distance2 = (vv * du * du - 2 * uv * du * dv + uu * dv * dv) / S;
            const double value =
                distance2 <= gate ? std::exp(-distance2 / 2) / (2 * M_PI * std::sqrt(S)) : 0.0;
            if (value > 0) {
                inside[count] = {j, value};
                density[count++] = value;
                association.unassociated[j] = false;
            }
        }
        // Too many: those of the largest densities, of equal ones the first.
        double least = 0.0;
        int equal = 0;
        if (count > MOST_PAIRINGS) {
            least = ranked(density, count, count - MOST_PAIRINGS);
            equal = MOST_PAIRINGS;
            for (int k = 0; k < count; ++k) {
                equal -= inside[k].value > least ? 1 : 0;
            }
            association.pairing.left_out += count - MOST_PAIRINGS;
        }
        for (int k = 0; k < count; ++k) {
            if (inside[k].value > least || (inside[k].value == least && equal-- > 0)) {
                association.pairing.add(inside[k]);
            }
        }
        association.start[n + 1] = association.pairing.count;
    }
}

void weigh_events(const DetectionModel &detection, double clutter_px2, Association &association) {
    const double factor = detection.detection_probability / clutter_px2;
    const double missed = 1 - detection.detection_probability * detection.gate_probability;
    std::fill_n(association.missed, association.tracks, missed);
    for (Pairing &one : association.pairing) {
        one.value *= factor;
    }
}

// --- exact sums over the joint events of a cluster of tracks that share centroids ---
//
// The events are never listed. Tracks are processed in order, and the later tracks depend on the
// earlier ones only by the set of centroids assigned so far that they could claim as well. Events
// with the same such set are one state, summed from the first track on (forward); the sums over the
// later tracks follow from the last one back (backward). Both give the marginals, as in the
// forward-backward algorithm (Rabiner 1989) and in the sharing of hypotheses by EHM (Maskell, Briers
// and Wright 2004).

namespace {

/// Sets of assigned centroids, of those between the first and the last of their tracks one bit each,
/// and for each set the sum of its events.
struct States {
    uint64_t *assigned;
    double *sum;
    int count;
};

/// A hash table of indices into keys, at most half full.
struct Table {
    int32_t *slot;
    int bits;

    size_t size() const { return size_t{1} << bits; }
    /// Where a key is, or where it has to go (Knuth, The Art of Computer Programming 3, 6.4).
    int32_t &operator()(const uint64_t *keys, uint64_t key) {
        size_t at = static_cast<size_t>((key * 0x9E3779B97F4A7C15U) >> (64 - bits));
        while (slot[at] >= 0 && keys[slot[at]] != key) {
            at = (at + 1) & (size() - 1);
        }
        return slot[at];
    }
};

int table_bits(size_t entries) {
    int bits = 1;
    while ((size_t{1} << bits) < 2 * entries) {
        ++bits;
    }
    return bits;
}

Table table_for(size_t entries, Arena &work) {
    Table table{nullptr, table_bits(entries)};
    table.slot = work.take<int32_t>(table.size());
    std::fill_n(table.slot, table.size(), -1);
    return table;
}

/// A shared centroid of a track; bit is 0 where all are in use.
struct Shared {
    int32_t pairing;
    uint64_t bit;
};

/// A track of a cluster: its shared centroids, and the bits of those that no later track shares.
struct Layer {
    int32_t track;
    int first, end;
    uint64_t closing;
};

/// What the steps of a cluster need: rows is the association, claims (centroids) counts the tracks
/// of each, remaining those to come; own is its bit.
struct Cluster {
    Association &rows;
    const int32_t *claims;
    int32_t *remaining;
    uint64_t *own;
    Layer *layer;
    int layers;
    Shared *shared;
    int64_t most_states;

    double value(const Shared &pair) const { return rows.pairing[pair.pairing].value; }
    int32_t centroid(const Shared &pair) const { return rows.pairing[pair.pairing].centroid; }

    /// Return the weight of the choices that no other track has: missed, or not shared.
    double free_weight(int track) const {
        double total = rows.missed[track];
        for (const Pairing *one = rows.begin(track); one < rows.end(track); ++one) {
            if (claims[one->centroid] == 1) {
                total += one->value;
            }
        }
        return total;
    }
};

/// Order the tracks so that few shared centroids are open at a time: the next track is the one after
/// which fewest are open.
void order_layers(Cluster &cluster) {
    for (int l = 0; l < cluster.layers; ++l) {
        int best = -1, fewest = 0;
        for (int t = l; t < cluster.layers; ++t) {
            int growth = 0;
            for (int k = cluster.layer[t].first; k < cluster.layer[t].end; ++k) {
                const int32_t j = cluster.centroid(cluster.shared[k]);
                growth += (cluster.remaining[j] == cluster.claims[j] ? 1 : 0) -
                          (cluster.remaining[j] == 1 ? 1 : 0);
            }
            if (best < 0 || growth < fewest) {
                best = t;
                fewest = growth;
            }
        }
        // Those not yet chosen stay in the order of the tracks.
        std::rotate(cluster.layer + l, cluster.layer + best, cluster.layer + best + 1);
        for (int k = cluster.layer[l].first; k < cluster.layer[l].end; ++k) {
            --cluster.remaining[cluster.centroid(cluster.shared[k])];
        }
    }
}

/// Give each shared centroid a bit, from the first to the last of its tracks; where all are in use
/// the least probable pairing has none.
void give_bits(Cluster &cluster, Arena &work) {
    for (int l = 0; l < cluster.layers; ++l) {
        for (int k = cluster.layer[l].first; k < cluster.layer[l].end; ++k) {
            const int32_t j = cluster.centroid(cluster.shared[k]);
            cluster.remaining[j] = cluster.claims[j];
        }
    }
    uint64_t used = 0;
    for (int l = 0; l < cluster.layers; ++l) {
        const Arena::Scope scope(work);
        Layer &layer = cluster.layer[l];
        const int count = layer.end - layer.first;
        auto *order = work.take<int>(static_cast<size_t>(count));
        auto *spare = work.take<int>(static_cast<size_t>(count));
        for (int k = 0; k < count; ++k) {
            order[k] = layer.first + k;
        }
        sort(order, count, spare, [&](int a, int b) {
            return cluster.value(cluster.shared[a]) > cluster.value(cluster.shared[b]);
        });
        for (int k = 0; k < count; ++k) {
            Shared &pair = cluster.shared[order[k]];
            const int32_t j = cluster.centroid(pair);
            if (cluster.own[j] == 0 && used != ~uint64_t{0}) {
                cluster.own[j] = ~used & (used + 1);
                used |= cluster.own[j];
            }
            pair.bit = cluster.own[j];
            --cluster.remaining[j];
        }
        layer.closing = 0;
        for (int k = layer.first; k < layer.end; ++k) {
            const int32_t j = cluster.centroid(cluster.shared[k]);
            if (cluster.remaining[j] == 0) {
                layer.closing |= cluster.own[j];
                used &= ~cluster.own[j];
            }
        }
    }
}

/// Call use(state, pair, claim, value) for each choice of a track in each state: pair is -1 for
/// the choices that no other track has.
template <class Use>
void choose(const Cluster &cluster, const Layer &layer, double free, const States &before,
            Use use) {
    for (int s = 0; s < before.count; ++s) {
        use(s, -1, uint64_t{0}, free);
        for (int k = layer.first; k < layer.end; ++k) {
            const uint64_t claim = cluster.shared[k].bit;
            if (claim != 0 && (before.assigned[s] & claim) == 0) {
                use(s, k, claim, cluster.value(cluster.shared[k]));
            }
        }
    }
}

/// Return the number of choices of a track: its shared centroids with a bit, and none of them.
int choices_of(const Cluster &cluster, const Layer &layer) {
    int choices = 1;
    for (int k = layer.first; k < layer.end; ++k) {
        choices += cluster.shared[k].bit != 0 ? 1 : 0;
    }
    return choices;
}

/// Return the bound of the states after a track, so that they and those found by the next one fit.
int most_after(const Cluster &cluster, int l) {
    int most = MOST_STATES / cluster.layers;
    if (l + 1 < cluster.layers) {
        most = std::min(most, MOST_STATES / choices_of(cluster, cluster.layer[l + 1]));
    }
    return static_cast<int>(std::max<int64_t>(1, std::min<int64_t>(most, cluster.most_states)));
}

/// Fill in the states after a track, at most so many, the most probable ones, and the sums of their
/// events over the largest, which is returned.
double step(Cluster &cluster, const Layer &layer, const States &before, int most, States &after,
            Arena &work) {
    const Arena::Scope scope(work);
    const auto bound = static_cast<size_t>(before.count * choices_of(cluster, layer));
    States found{work.take<uint64_t>(bound), work.take<double>(bound), 0};
    Table table = table_for(bound, work);
    choose(cluster, layer, cluster.free_weight(layer.track), before,
           [&](int s, int, uint64_t claim, double value) {
               const uint64_t assigned = (before.assigned[s] | claim) & ~layer.closing;
               int32_t &slot = table(found.assigned, assigned);
               if (slot < 0) {
                   slot = found.count;
                   found.assigned[found.count] = assigned;
                   found.sum[found.count++] = 0.0;
               }
               found.sum[slot] += before.sum[s] * value;
           });
    double largest = 0.0;
    for (int s = 0; s < found.count; ++s) {
        largest = std::fmax(largest, found.sum[s]);
    }
    int32_t *order = nullptr;
    after.count = found.count;
    if (found.count > most) {
        // The table is not needed any more, and has room for both.
        order = table.slot;
        for (int s = 0; s < found.count; ++s) {
            order[s] = s;
        }
        sort(order, found.count, order + found.count,
             [&](int32_t a, int32_t b) { return found.sum[a] > found.sum[b]; });
        after.count = most;
        cluster.rows.states_left_out += found.count - after.count;
    }
    for (int s = 0; s < after.count; ++s) {
        const int from = order == nullptr ? s : order[s];
        after.assigned[s] = found.assigned[from];
        after.sum[s] = found.sum[from] / largest;
    }
    return largest;
}

/// Fill in the sums (before.count) over this track and later ones, and make its row marginals.
void step_back(Cluster &cluster, const Layer &layer, const States &before, const States &after,
               const double *after_sum, double *before_sum, Arena &work) {
    const Arena::Scope scope(work);
    Table table = table_for(static_cast<size_t>(after.count), work);
    for (int s = 0; s < after.count; ++s) {
        table(after.assigned, after.assigned[s]) = s;
    }
    const int count = layer.end - layer.first;
    auto *chosen = work.take<double>(static_cast<size_t>(count));
    std::fill_n(chosen, count, 0.0);
    std::fill_n(before_sum, before.count, 0.0);
    const double free = cluster.free_weight(layer.track);
    double free_sum = 0.0;
    choose(cluster, layer, free, before, [&](int s, int k, uint64_t claim, double value) {
        const int32_t next = table(after.assigned, (before.assigned[s] | claim) & ~layer.closing);
        if (next < 0) {
            return;
        }
        value *= after_sum[next];
        before_sum[s] += value;
        (k < 0 ? free_sum : chosen[k - layer.first]) += before.sum[s] * value;
    });
    double total = free_sum, largest = 0.0;
    for (int k = 0; k < count; ++k) {
        total += chosen[k];
    }
    for (int s = 0; s < before.count; ++s) {
        largest = std::fmax(largest, before_sum[s]);
    }
    for (int s = 0; s < before.count; ++s) {
        before_sum[s] /= largest;
    }
    Association &rows = cluster.rows;
    rows.missed[layer.track] *= free_sum / (free * total);
    for (Pairing *one = rows.begin(layer.track); one < rows.end(layer.track); ++one) {
        if (cluster.claims[one->centroid] == 1) {
            one->value *= free_sum / (free * total);
        }
    }
    for (int k = 0; k < count; ++k) {
        rows.pairing[cluster.shared[layer.first + k].pairing].value = chosen[k] / total;
    }
}

/// Turn the rows of a cluster from weights into marginal probabilities; return the logarithm of the
/// sum of its events.
double marginalise_cluster(Cluster &cluster, Arena &work) {
    const Arena::Scope scope(work);
    double log_sum = 0.0;
    order_layers(cluster);
    give_bits(cluster, work);
    // The states before each layer, and after the last one.
    auto *states = work.take<States>(static_cast<size_t>(cluster.layers) + 1);
    states[0] = {work.take<uint64_t>(1), work.take<double>(1), 1};
    states[0].assigned[0] = 0;
    states[0].sum[0] = 1.0;
    for (int l = 0; l < cluster.layers; ++l) {
        const Layer &layer = cluster.layer[l];
        const int most = most_after(cluster, l);
        const auto bound =
            static_cast<size_t>(std::min(most, states[l].count * choices_of(cluster, layer)));
        states[l + 1] = {work.take<uint64_t>(bound), work.take<double>(bound), 0};
        log_sum += std::log(step(cluster, layer, states[l], most, states[l + 1], work));
    }
    double *after = work.take<double>(static_cast<size_t>(states[cluster.layers].count));
    std::fill_n(after, states[cluster.layers].count, 1.0);
    double *before = nullptr;
    for (int l = cluster.layers - 1; l >= 0; --l) {
        before = work.take<double>(static_cast<size_t>(states[l].count));
        step_back(cluster, cluster.layer[l], states[l], states[l + 1], after, before, work);
        after = before;
    }
    // After the last track all centroids are closed: one state is left, of the sum 1.
    return log_sum;
}

/// Return the representative of the cluster of a track, the path to it halved.
int32_t root_of(int32_t *parent, int32_t track) {
    while (parent[track] != track) {
        parent[track] = parent[parent[track]];
        track = parent[track];
    }
    return track;
}

}  // namespace

size_t association_work_bytes(int tracks, int centroids) {
    const auto n = static_cast<size_t>(tracks), m = static_cast<size_t>(centroids);
    const size_t pairs = most_pairings(tracks, centroids);
    const size_t gates = Arena::padded<Pairing>(m) + Arena::padded<double>(m);
    const size_t clusters = 3 * Arena::padded<int32_t>(m) + Arena::padded<uint64_t>(m) +
                            2 * Arena::padded<int32_t>(n) + Arena::padded<bool>(n) +
                            Arena::padded<Layer>(n) + Arena::padded<Shared>(pairs) +
                            Arena::padded<States>(n + 1) + 2 * Arena::padded<int>(pairs);
    // Of each state three numbers; those found by a track, before they are chosen from, are as many.
    const size_t states = 3 * (Arena::padded<double>(MOST_STATES) + (n + 2) * (ALIGNMENT + 8));
    const size_t found = 2 * Arena::padded<double>(MOST_STATES) +
                         Arena::padded<int32_t>(size_t{1} << table_bits(MOST_STATES)) +
                         Arena::padded<double>(MOST_PAIRINGS);
    return std::max(gates, clusters + states + found);
}

double marginalise(Association &association, int64_t max_steps, Arena &work) {
    const Arena::Scope scope(work);
    const int tracks = association.tracks;
    const auto n = static_cast<size_t>(tracks), m = static_cast<size_t>(association.centroids);
    auto *claims = work.take<int32_t>(m), *first = work.take<int32_t>(m);
    auto *parent = work.take<int32_t>(n);
    std::fill_n(claims, m, 0);
    double log_sum = 0.0;
    for (int track = 0; track < tracks; ++track) {
        parent[track] = track;
    }
    for (int track = 0; track < tracks; ++track) {
        double total = association.missed[track];
        for (Pairing *one = association.begin(track); one < association.end(track); ++one) {
            total += one->value;
        }
        log_sum += std::log(total);
        association.missed[track] /= total;
        for (Pairing *one = association.begin(track); one < association.end(track); ++one) {
            one->value /= total;
            int32_t &claimed = claims[one->centroid];
            if (claimed == 0) {
                first[one->centroid] = track;
            }
            const int32_t root = root_of(parent, track);
            parent[root] = root_of(parent, first[one->centroid]);
            ++claimed;
        }
    }
    // Each shared centroid of a track, and the choice of none, is a pairing of the clusters.
    auto *is_member = work.take<bool>(n);
    int64_t pairings = 0;
    int shared_count = 0;
    for (int track = 0; track < tracks; ++track) {
        int shared = 0;
        for (const Pairing *one = association.begin(track); one < association.end(track); ++one) {
            shared += claims[one->centroid] > 1 ? 1 : 0;
        }
        is_member[track] = shared > 0;
        pairings += shared + (shared > 0 ? 1 : 0);
        shared_count += shared;
    }
    if (pairings == 0) {
        return log_sum;
    }
    auto *remaining = work.take<int32_t>(m);
    auto *own = work.take<uint64_t>(m);
    std::copy_n(claims, m, remaining);
    std::fill_n(own, m, uint64_t{0});
    const auto members = static_cast<size_t>(std::count(is_member, is_member + tracks, true));
    auto *layer = work.take<Layer>(members);
    auto *shared = work.take<Shared>(static_cast<size_t>(shared_count));
    for (int root = 0; root < tracks; ++root) {
        if (!is_member[root] || root_of(parent, root) != root) {
            continue;
        }
        int layers = 0, count = 0;
        for (int track = 0; track < tracks; ++track) {
            if (!is_member[track] || root_of(parent, track) != root) {
                continue;
            }
            const int begin = count;
            for (int k = association.start[track]; k < association.start[track + 1]; ++k) {
                if (claims[association.pairing[k].centroid] > 1) {
                    shared[count++] = {k, 0};
                }
            }
            layer[layers++] = {track, begin, count, 0};
        }
        Cluster cluster{
            association, claims,
            remaining,   own,
            layer,       layers,
            shared,      std::max<int64_t>(1, max_steps / std::max<int64_t>(1, pairings))};
        log_sum += marginalise_cluster(cluster, work);
    }
    return log_sum;
}

}  // namespace st
