"""The attitude of each frame of a run by SNA, JPDAF and the coupled filter."""

from collections.abc import Callable, Sequence

import numpy as np
from startracker_ros.core.attitude.estimate import estimate_attitude
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.centroid.centroids import Centroids, round_errors
from startracker_ros.core.maths.rotation import multiply, quaternion_from_rotation_vector
from startracker_ros.core.track.association import (
    event_weights, gate_size, gated_density, joint_probabilities)
from startracker_ros.core.track.jpdaf import predict, update
from startracker_ros.core.track.motion_models import (
    constant_velocity, coordinated_turn, image_jacobian, POSITION, VELOCITY)
from startracker_ros.core.track.neighbourhood import propagated, star_neighbourhood
from startracker_ros.core.track.options import TrackerOptions
from startracker_ros.core.track.tracker import StarTracker
from startracker_ros.evaluation.campaign.jpdaf_runs import (
    BLOCK_S, CAMERA, Cell, DETECTION_PROBABILITY, DT_S, FALSE_POINTS, FRAMES, ORBIT_RATE_RAD_S,
    RATE_SIGMA_RAD_S, Run, STARS)

METHODS = 'SNA', 'JPDAF, TRIAD', 'JPDAF, optimal', 'attitude-coupled'
COUPLED = METHODS[-1]
CLUTTER_PX2 = FALSE_POINTS / (CAMERA.width * CAMERA.height)
GATE_PROBABILITY = 1 - 1e-9
"""Close to 1: the jitter makes jumps far in the tails of a Gaussian of their variance."""

LEAST_DEG_S2 = 1e-6
"""The smallest acceleration that the tracker accepts: a constant rate."""


def velocity_changes(cell: Cell) -> tuple[float, float]:
    """
    Return 1-sigma changes per frame, of any star's velocity in px/s and of the roll rate.

    One rule for all cells: the change of velocity that is not in the model, as a random walk of
    the same size. The constant-velocity model lacks the curve of the path across the image, a
    steady acceleration of 2 w^2 times the distance from the centre. Both models lack the roll
    of the jitter, a rate uniform in +-jitter, constant in each block: its change moves stars
    across their radius, and during the block the Coriolis and the centrifugal acceleration of
    a rolling image act. Distances are those of the edge.
    """
    edge_px, focal_px = CAMERA.width / 2, CAMERA.fx
    jitter = np.radians(cell.jitter_deg_s)
    curve = 2 * ORBIT_RATE_RAD_S ** 2 * edge_px
    speed = ORBIT_RATE_RAD_S * (focal_px if cell.motion == 'linear' else edge_px)
    # The rms of a uniform rate is jitter / sqrt(3), that of its square jitter^2 / sqrt(5).
    rolling = np.hypot(2 * jitter / np.sqrt(3) * speed, jitter ** 2 / np.sqrt(5) * edge_px)
    steady = DT_S * np.hypot(curve * np.sqrt(FRAMES), rolling * np.sqrt(BLOCK_S / DT_S))
    return steady, jitter * np.sqrt(2 / 3 * DT_S / BLOCK_S)


def body_changes(cell: Cell) -> tuple[float, float]:
    """
    Return 1-sigma changes per frame of the body rate across and about the boresight, rad/s.

    By the same rule: a rate that is constant in space changes on the axes of a rolling camera.
    """
    across = 0.0
    if cell.motion == 'linear':
        across = (ORBIT_RATE_RAD_S * np.radians(cell.jitter_deg_s) / np.sqrt(3)
                  * np.sqrt(DT_S * BLOCK_S))
    return across, velocity_changes(cell)[1]


def star_model(cell: Cell) -> tuple[np.ndarray, Callable[[np.ndarray], np.ndarray]]:
    """Return the transition (4, 4) of a star, and its process noise (N, 4, 4) at uv (N, 2)."""
    steady, roll = velocity_changes(cell)

    def model(velocity_change: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
        change_u, change_v = velocity_change
        if cell.motion == 'linear':
            return constant_velocity(DT_S, (change_u / DT_S, change_v / DT_S))
        return coordinated_turn(DT_S, -ORBIT_RATE_RAD_S,
                                (change_u / np.sqrt(DT_S), change_v / np.sqrt(DT_S)))

    transition, steady_noise = model((steady, steady))
    rolling = model((0.0, roll))[1]

    def noise(uv: np.ndarray) -> np.ndarray:
        # A roll moves the star at (x, y) from the centre along (-y, x).
        turn = np.zeros((len(uv), 4, 4))
        x, y = (uv - [CAMERA.cx, CAMERA.cy]).T[..., None]
        turn[:, [0, 1], [0, 1]] = turn[:, [2, 3], [2, 3]] = x
        turn[:, [2, 3], [0, 1]] = y
        turn[:, [0, 1], [2, 3]] = -y
        return steady_noise + turn @ rolling @ np.swapaxes(turn, 1, 2)

    return transition, noise


def track_stars(state: np.ndarray, covariance: np.ndarray, frames: Sequence[np.ndarray],
                sigma_px: float, transition: np.ndarray,
                noise: Callable[[np.ndarray], np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return states (F + 1, N, 4) and covariances, the start and after each frame (M, 2) px."""
    gate = gate_size(GATE_PROBABILITY)
    states, covariances = [state], [covariance]
    for uv in frames:
        state, covariance = predict(state, covariance, transition, noise(state[:, POSITION]))
        variance = np.full(len(uv), sigma_px ** 2)
        density = gated_density(state[:, POSITION], covariance[:, ::2, ::2], uv,
                                round_errors(variance), gate)
        probability = joint_probabilities(event_weights(
            density, DETECTION_PROBABILITY, GATE_PROBABILITY, CLUTTER_PX2))
        state, covariance = update(state, covariance, uv, variance, probability)
        states.append(state)
        covariances.append(covariance)
    return np.stack(states), np.stack(covariances)


def _jpdaf(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """Return filtered positions (F, 4, 2) px and their sigma (F, 4) per axis."""
    rate_variance = np.full(3, RATE_SIGMA_RAD_S ** 2)
    # Uniform in +-jitter.
    rate_variance[2] += np.radians(run.cell.jitter_deg_s) ** 2 / 3
    jacobian = image_jacobian(CAMERA, CAMERA.unproject(run.start))
    state = np.empty((STARS, 4))
    state[:, POSITION], state[:, VELOCITY] = run.start, jacobian @ run.start_rate_rad_s
    covariance = np.zeros((STARS, 4, 4))
    covariance[:, POSITION, POSITION] = run.cell.variance_px2
    covariance[:, 1::2, 1::2] = (jacobian * rate_variance) @ np.swapaxes(jacobian, 1, 2)
    states, covariances = track_stars(state, covariance, run.centroids[1:], run.cell.sigma_px,
                                      *star_model(run.cell))
    variance = (covariances[..., 0, 0] + covariances[..., 2, 2]) / 2
    return states[..., POSITION], np.sqrt(variance)


def _neighbourhood(run: Run) -> np.ndarray:
    """
    Return the index (F, 4) of the centroid that SNA assigns to each star, -1 for none.

    The body rate is the true one; a missed star is propagated.
    """
    uv_stars = run.start
    assigned = [run.seen[0]]
    for rate, uv in zip(run.rate_rad_s, run.centroids[1:]):
        uv_stars = propagated(CAMERA, uv_stars, rate, DT_S)
        index = star_neighbourhood(CAMERA, uv_stars, run.icrf, uv,
                                   np.full(len(uv), run.cell.sigma_px))
        uv_stars[index >= 0] = uv[index[index >= 0]]
        assigned.append(index)
    return np.stack(assigned)


def _star_neighbourhood_attitudes(run: Run) -> np.ndarray:
    """
    Return the attitudes (F, 4) of SNA: TRIAD, or the true body rate with fewer than three stars.

    Two stars may be next to each other: the error of one such attitude would dominate a run.
    """
    quaternions = []
    for k, (index, uv) in enumerate(zip(_neighbourhood(run), run.centroids)):
        found = index >= 0
        if found.sum() >= 3:
            quaternion = _attitude(uv[index[found]], run.icrf[found], np.ones(found.sum()),
                                   'triad')
        else:
            quaternion = multiply(quaternion, quaternion_from_rotation_vector(
                run.rate_rad_s[k - 1] * DT_S))
        quaternions.append(quaternion)
    return np.stack(quaternions)


def _coupled(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the attitudes (F, 4) of the tracker with one filter, and their covariances.

    It is initialised by two identified frames, which give the rate; frames of too few stars are
    propagated by the rate.
    """
    numbers = np.arange(1, STARS + 1, dtype=np.int32)
    across, roll = np.degrees(body_changes(run.cell)) / DT_S
    tracker = StarTracker(
        CAMERA, OnboardCatalog(numbers, run.icrf, np.full(STARS, 4.0),
                               *np.zeros((2, STARS), bool)),
        TrackerOptions(model='attitude', max_stars=STARS, min_stars=STARS - 1,
                       acceleration_deg_s2=max(across, LEAST_DEG_S2),
                       roll_acceleration_deg_s2=max(roll, LEAST_DEG_S2),
                       detection_probability=DETECTION_PROBABILITY))
    quaternions, covariances = [], []
    started, rate = False, run.start_rate_rad_s
    for k, (uv, seen) in enumerate(zip(run.centroids, run.seen)):
        stamp_ns = round((k + 1) * DT_S * 1e9)
        frame = Centroids(uv=uv, flux=np.ones(len(uv)), snr=np.full(len(uv), 30.0),
                          sigma_px=np.full(len(uv), run.cell.sigma_px))
        tracker.update(stamp_ns, frame)
        visible = seen >= 0
        if not started:
            hip = np.zeros(len(uv), np.int32)
            hip[seen[visible]] = numbers[visible]
            tracker.identified(stamp_ns, frame, hip)
        if tracker.attitude is not None:
            started, attitude, rate = True, tracker.attitude.attitude, tracker.attitude.rate_rad_s
            quaternion, covariance = attitude.quaternion, attitude.covariance_sensor
        elif not started and visible.sum() >= 2:
            attitude = estimate_attitude(
                CAMERA.unproject(uv[seen[visible]]), run.icrf[visible],
                np.full(visible.sum(), run.cell.sigma_px * CAMERA.pixel_rad))
            quaternion, covariance = attitude.quaternion, attitude.covariance_sensor
        else:
            quaternion = multiply(quaternion, quaternion_from_rotation_vector(rate * DT_S))
        quaternions.append(quaternion)
        covariances.append(covariance)
    return np.stack(quaternions), np.stack(covariances)


def attitudes(run: Run) -> tuple[list[np.ndarray], np.ndarray]:
    """Return the quaternions (F, 4) of each of METHODS, and the covariances of the last."""
    positions, sigma_px = _jpdaf(run)
    filtered = [np.stack([_attitude(uv, run.icrf, sigma, solver)
                          for uv, sigma in zip(positions, sigma_px)])
                for solver in ('triad', 'quest')]
    coupled, covariance = _coupled(run)
    return [_star_neighbourhood_attitudes(run), *filtered, coupled], covariance


def _attitude(uv: np.ndarray, icrf: np.ndarray, sigma_px: np.ndarray, solver: str) -> np.ndarray:
    return estimate_attitude(CAMERA.unproject(uv), icrf, sigma_px * CAMERA.pixel_rad,
                             solver).quaternion
