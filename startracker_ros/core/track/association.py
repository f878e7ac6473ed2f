# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Joint probabilistic data association (JPDA): which centroid belongs to which track.

Weights and probabilities are (tracks, centroids + 1): column 0 is the hypothesis that the
star was missed. Steps 2 to 6 of the filter of Sadeghi, Sabahi and Saberali, with false
centroids as a Poisson process of known density (Bar-Shalom and Fortmann 1988) instead
of phi! / V^phi: then clusters of tracks without a common centroid are independent.
"""

from typing import NamedTuple

import numpy as np
from startracker_ros.core.compiled import compiled

MAX_STEPS = 1_000_000
"""Bound of the steps of a frame: pairings of track and shared centroid (missed counts as one)
times the states after each track (see marginals). Twelve stars that all share twelve
centroids, 10^10 events, are within it and exact. Beyond it only the most probable states
stay, so that no frame takes longer than some 0.1 s."""


class DetectionModel(NamedTuple):
    """
    Gate, probabilities of a detection, and the area of the image.

    gate is a squared Mahalanobis distance; gate_probability that of a detected star to be inside
    it; detection_probability that of a star to have a centroid; image_px2 is the area in which
    false centroids occur.
    """

    gate: float
    gate_probability: float
    detection_probability: float
    image_px2: float


@compiled
def associate(predicted: np.ndarray, covariance: np.ndarray, uv: np.ndarray, error: np.ndarray,
              detection: DetectionModel) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the probabilities (N, M + 1), and the mask (M,) of the centroids in no gate.

    Arguments are those of gated_density(); the density of false centroids is
    that of the centroids in no gate.
    """
    density = _gated_density(predicted, covariance, uv, error, detection.gate)
    unassociated = np.ones(len(uv), np.bool_)
    # One more than counted: the density must be positive.
    clutter = 1
    for centroid in range(len(uv)):
        for track in range(len(predicted)):
            if density[track, centroid] > 0:
                unassociated[centroid] = False
        clutter += unassociated[centroid]
    weight = event_weights(density, detection.detection_probability, detection.gate_probability,
                           clutter / detection.image_px2)
    return marginals(weight, MAX_STEPS), unassociated


@compiled
def most_probable(probability: np.ndarray) -> np.ndarray:
    """Return the most probable centroid (N,) of each track, 0 where there is none at all."""
    best = np.zeros(len(probability), np.int64)
    for track in range(len(probability)):
        for centroid in range(1, probability.shape[1] - 1):
            if probability[track, centroid + 1] > probability[track, best[track] + 1]:
                best[track] = centroid
    return best


def gate_size(probability: float) -> float:
    """Return the squared Mahalanobis distance in two dimensions not exceeded with probability."""
    return -2 * np.log1p(-probability)


def gated_density(predicted: np.ndarray, covariance: np.ndarray, uv: np.ndarray,
                  error: np.ndarray, gate: float) -> np.ndarray:
    """
    Return the density (N, M) per px^2 of centroids about predictions, 0 outside the gate.

    predicted (N, 2) px with covariance (N, 2, 2); centroids uv (M, 2) with covariance error
    (M, 2, 2); gate is a squared Mahalanobis distance. All finite, error positive definite,
    covariance positive semidefinite; the caller ensures it.
    """
    return _gated_density(np.ascontiguousarray(predicted), np.ascontiguousarray(covariance),
                          np.ascontiguousarray(uv), np.ascontiguousarray(error), gate)


@compiled
def _gated_density(predicted: np.ndarray, covariance: np.ndarray, uv: np.ndarray,
                   error: np.ndarray, gate: float) -> np.ndarray:
    density = np.zeros((len(predicted), len(uv)))
    for track in range(len(predicted)):
        for centroid in range(len(uv)):
            du = uv[centroid, 0] - predicted[track, 0]
            uu = covariance[track, 0, 0] + error[centroid, 0, 0]
            # Outside on one axis is outside: true of most pairs.
            if du * du > gate * uu:
                continue
            dv = uv[centroid, 1] - predicted[track, 1]
            vv = covariance[track, 1, 1] + error[centroid, 1, 1]
            if dv * dv > gate * vv:
                continue
            cross = covariance[track, 0, 1] + error[centroid, 0, 1]
            determinant = uu * vv - cross * cross
            distance2 = (vv * du * du - 2 * cross * du * dv + uu * dv * dv) / determinant
            if distance2 <= gate:
                density[track, centroid] = (
                    np.exp(-distance2 / 2) / (2 * np.pi * np.sqrt(determinant)))
    return density


@compiled
def event_weights(density: np.ndarray, detection_probability: float, gate_probability: float,
                  clutter_px2: float) -> np.ndarray:
    """
    Return the factors (N, M + 1) of joint events, relative to every centroid being false.

    clutter_px2 > 0 is the density of false centroids per px^2; both probabilities are below 1.
    """
    weight = np.empty((density.shape[0], density.shape[1] + 1))
    weight[:, 0] = 1 - detection_probability * gate_probability
    weight[:, 1:] = density * (detection_probability / clutter_px2)
    return weight


def joint_probabilities(weight: np.ndarray) -> np.ndarray:
    """
    Return the association probabilities (N, M + 1) of event weights (N, M + 1).

    A joint event gives each track one centroid or none and each centroid to one track at
    most; its probability is proportional to the product of its weights. Exact, up to
    MAX_STEPS and joint_events.OPEN_CENTROIDS. Weights are finite and not negative, and
    positive in column 0.
    """
    return marginals(np.ascontiguousarray(weight), MAX_STEPS)


# --- exact sums over the joint events of a cluster of tracks that share centroids ---
#
# A joint event gives each track one centroid or none and each centroid to one track at most.
# The events are never listed. Tracks are processed in order, and the later tracks depend on
# the earlier ones only by the set of centroids assigned so far that they could claim as well.
# Events with the same such set are one state, summed from the first track on (forward); the
# sums over the later tracks follow from the last one back (backward). Both give the marginals,
# as in the forward-backward algorithm (Rabiner 1989) and in the sharing of hypotheses by EHM
# (Maskell, Briers and Wright 2004).

OPEN_CENTROIDS = 64
"""Most shared centroids between the first and the last of their tracks: one bit each."""

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)


@compiled
def marginals(weight: np.ndarray, max_steps: int) -> np.ndarray:
    """
    Return the association probabilities (N, M + 1) of event weights (N, M + 1).

    max_steps bounds the states after each track times the pairings of all clusters.
    """
    tracks, columns = weight.shape
    probability = np.empty((tracks, columns))
    claims = np.zeros(columns, np.int64)
    first = np.zeros(columns, np.int64)
    parent = np.arange(tracks)
    for track in range(tracks):
        total = 0.0
        for column in range(columns):
            total += weight[track, column]
        for column in range(columns):
            probability[track, column] = weight[track, column] / total
            if column > 0 and weight[track, column] > 0:
                if claims[column] == 0:
                    first[column] = track
                parent[_root(parent, track)] = _root(parent, first[column])
                claims[column] += 1
    member = np.zeros(tracks, np.bool_)
    pairings = 0
    for track in range(tracks):
        for column in range(1, columns):
            if claims[column] > 1 and weight[track, column] > 0:
                member[track] = True
                pairings += 1
        pairings += member[track]
    most_states = max(1, max_steps // max(1, pairings))
    for root in range(tracks):
        if member[root] and _root(parent, root) == root:
            cluster = np.array([track for track in range(tracks)
                                if member[track] and _root(parent, track) == root])
            _marginalise(probability, cluster, claims, most_states)
    return probability


@compiled
def _root(parent: np.ndarray, track: int) -> int:
    """Return the representative of the cluster of a track, the path to it halved."""
    while parent[track] != track:
        parent[track] = parent[parent[track]]
        track = parent[track]
    return track


@compiled
def _marginalise(probability: np.ndarray, cluster: np.ndarray, claims: np.ndarray, most_states: int
                 ) -> None:
    """Turn the rows of a cluster (T,) from weights into marginal probabilities."""
    layers = len(cluster)
    start, column = _pairings(probability, cluster, claims)
    order = _order(start, column, claims)
    bit, closing = _bits(probability, cluster, order, start, column, claims)
    # Assigned sets and sums of their events before layer l: from begin[l] to begin[l + 1].
    begin = np.zeros(layers + 2, np.int64)
    begin[1] = 1
    assigned, forward = np.zeros(1, np.uint64), np.ones(1)
    for layer in range(layers):
        position = order[layer]
        row = probability[cluster[position]]
        pairs = slice(start[position], start[position + 1])
        new_assigned, new_forward = _step(
            assigned[begin[layer]:], forward[begin[layer]:], row, _free(row, claims),
            column[pairs], bit[pairs], closing[layer], most_states)
        begin[layer + 2] = begin[layer + 1] + len(new_assigned)
        old_assigned, old_forward = assigned, forward
        assigned = np.empty(begin[layer + 2], np.uint64)
        forward = np.empty(begin[layer + 2])
        assigned[:begin[layer + 1]], assigned[begin[layer + 1]:] = old_assigned, new_assigned
        forward[:begin[layer + 1]], forward[begin[layer + 1]:] = old_forward, new_forward
    backward = np.ones(begin[layers + 1] - begin[layers])
    for layer in range(layers - 1, -1, -1):
        position = order[layer]
        row = probability[cluster[position]]
        pairs = slice(start[position], start[position + 1])
        backward = _step_back(
            assigned[begin[layer]:begin[layer + 1]], forward[begin[layer]:begin[layer + 1]],
            assigned[begin[layer + 1]:begin[layer + 2]], backward, row, _free(row, claims), claims,
            column[pairs], bit[pairs], closing[layer])


@compiled
def _pairings(probability: np.ndarray, cluster: np.ndarray, claims: np.ndarray
              ) -> tuple[np.ndarray, np.ndarray]:
    """Return the shared centroids of each track as start (T + 1,) into columns (K,)."""
    start = np.zeros(len(cluster) + 1, np.int64)
    columns = probability.shape[1]
    column = np.empty(len(cluster) * (columns - 1), np.int64)
    count = 0
    for position in range(len(cluster)):
        for choice in range(1, columns):
            if claims[choice] > 1 and probability[cluster[position], choice] > 0:
                column[count] = choice
                count += 1
        start[position + 1] = count
    return start, column[:count]


@compiled
def _free(row: np.ndarray, claims: np.ndarray) -> float:
    """Return the weight of the choices that no other track has: missed, or not shared."""
    total = row[0]
    for choice in range(1, len(row)):
        if claims[choice] == 1:
            total += row[choice]
    return total


@compiled
def _order(start: np.ndarray, column: np.ndarray, claims: np.ndarray) -> np.ndarray:
    """
    Return an order (T,) of the tracks with few shared centroids open at a time.

    The next track is the one after which fewest are open.
    """
    tracks = len(start) - 1
    remaining = claims.copy()
    order = np.empty(tracks, np.int64)
    done = np.zeros(tracks, np.bool_)
    for layer in range(tracks):
        best, fewest = -1, 0
        for track in range(tracks):
            if done[track]:
                continue
            growth = 0
            for choice in column[start[track]:start[track + 1]]:
                growth += (remaining[choice] == claims[choice]) - (remaining[choice] == 1)
            if best < 0 or growth < fewest:
                best, fewest = track, growth
        order[layer] = best
        done[best] = True
        for choice in column[start[best]:start[best + 1]]:
            remaining[choice] -= 1
    return order


@compiled
def _bits(probability: np.ndarray, cluster: np.ndarray, order: np.ndarray, start: np.ndarray,
          column: np.ndarray, claims: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the bit (K,) of each pairing and the bits (T,) that close with each track.

    A bit is reused after the last track of its centroid. Where all are in use the least
    probable pairing has none, 0.
    """
    bit = np.zeros(len(column), np.uint64)
    closing = np.zeros(len(order), np.uint64)
    own = np.zeros(len(claims), np.uint64)
    remaining = claims.copy()
    used = np.uint64(0)
    for layer in range(len(order)):
        position = order[layer]
        pairs = np.arange(start[position], start[position + 1])
        row = probability[cluster[position]]
        for pair in pairs[np.argsort(-row[column[pairs]])]:
            choice = column[pair]
            if own[choice] == 0 and used != ~np.uint64(0):
                own[choice] = ~used & (used + np.uint64(1))
                used |= own[choice]
            bit[pair] = own[choice]
            remaining[choice] -= 1
        for choice in column[pairs]:
            if remaining[choice] == 0:
                closing[layer] |= own[choice]
                used &= ~own[choice]
    return bit, closing


@compiled
def _step(assigned: np.ndarray, forward: np.ndarray, row: np.ndarray, free: float,
          column: np.ndarray, bit: np.ndarray, closing: int, most_states: int
          ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the states after a track: assigned sets (S,) and the sums of their events (S,).

    At most most_states of them, the most probable ones.
    """
    bound = len(assigned) * (len(column) + 1)
    new_assigned, new_forward = np.empty(bound, np.uint64), np.zeros(bound)
    table, shift = _table(bound)
    count = 0
    for state in range(len(assigned)):
        for pair in range(-1, len(column)):
            claim = np.uint64(0)
            value = free
            if pair >= 0:
                claim = bit[pair]
                value = row[column[pair]]
                if claim == 0 or assigned[state] & claim:
                    continue
            after = (assigned[state] | claim) & ~closing
            slot = _slot(table, shift, new_assigned, after)
            if table[slot] < 0:
                table[slot] = count
                new_assigned[count] = after
                count += 1
            new_forward[table[slot]] += forward[state] * value
    new_assigned, new_forward = new_assigned[:count], new_forward[:count]
    if count > most_states:
        best = np.argsort(-new_forward)[:most_states]
        new_assigned, new_forward = new_assigned[best], new_forward[best]
    return new_assigned, new_forward / new_forward.max()


@compiled
def _step_back(assigned: np.ndarray, forward: np.ndarray, next_assigned: np.ndarray,
               next_backward: np.ndarray, row: np.ndarray, free: float, claims: np.ndarray,
               column: np.ndarray, bit: np.ndarray, closing: int) -> np.ndarray:
    """Return the sums (S,) over this track and later ones; make row its marginals."""
    table, shift = _table(len(next_assigned))
    for state in range(len(next_assigned)):
        table[_slot(table, shift, next_assigned, next_assigned[state])] = state
    backward = np.zeros(len(assigned))
    chosen = np.zeros(len(column))
    free_sum = 0.0
    for state in range(len(assigned)):
        for pair in range(-1, len(column)):
            claim = np.uint64(0)
            value = free
            if pair >= 0:
                claim = bit[pair]
                value = row[column[pair]]
                if claim == 0 or assigned[state] & claim:
                    continue
            after = table[_slot(table, shift, next_assigned, (assigned[state] | claim) & ~closing)]
            if after < 0:
                continue
            value *= next_backward[after]
            backward[state] += value
            if pair < 0:
                free_sum += forward[state] * value
            else:
                chosen[pair] += forward[state] * value
    total = free_sum
    for pair in range(len(column)):
        total += chosen[pair]
    for choice in range(len(row)):
        if choice == 0 or claims[choice] == 1:
            row[choice] *= free_sum / (free * total)
    for pair in range(len(column)):
        row[column[pair]] = chosen[pair] / total
    return backward / backward.max()


@compiled
def _table(entries: int) -> tuple[np.ndarray, np.uint64]:
    """Return an empty hash table, at most half full with entries, and the shift of its hash."""
    bits = 1
    while (1 << bits) < 2 * entries:
        bits += 1
    table = np.empty(1 << bits, np.int32)
    for slot in range(len(table)):
        table[slot] = -1
    return table, np.uint64(64 - bits)


@compiled
def _slot(table: np.ndarray, shift: np.uint64, keys: np.ndarray, key: np.uint64) -> np.int64:
    """Return where a key is in the table of indices into keys, or where it has to go."""
    slot = np.int64((key * _GOLDEN) >> shift)
    while table[slot] >= 0 and keys[table[slot]] != key:
        slot = (slot + 1) & (len(table) - 1)
    return slot
