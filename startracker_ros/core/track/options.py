"""Options of the star tracker."""

from dataclasses import dataclass

from startracker_ros.core.catalog.deep import DEEP_LIMIT
from startracker_ros.core.options import option, Options

MODELS = ('attitude', 'constant_velocity', 'coordinated_turn', 'sna')


@dataclass(frozen=True)
class TrackerOptions(Options):
    """The motion model, the association, and the limits of the state machine."""

    model: str = option(
        'attitude', 'attitude: one rotation moves all stars; constant_velocity and '
        'coordinated_turn: a filter for each star (JPDAF); sna: no filter, each star where it '
        'was measured (star neighbourhood approach)', choices=MODELS)
    magnitude_limit: float = option(
        DEEP_LIMIT, 'faintest catalogue stars that are followed, V; beyond 9 only fields below '
        '4 deg have stars', unit='mag', low=0.0, high=DEEP_LIMIT)
    max_stars: int = option(
        40, 'most stars followed at a time, brightest first', low=4, high=500, live=True)
    min_stars: int = option(
        4, 'fewest stars that must be seen and move as one for a frame to count as good',
        low=3, high=100, live=True)
    acceleration_deg_s2: float = option(
        0.005, 'process noise, 1 sigma of the angular acceleration; more follows manoeuvres '
        'faster, less filters better', unit='deg/s^2', low=1e-6, high=100.0)
    roll_acceleration_deg_s2: float = option(
        0.005, 'the same about the boresight, for the model attitude: a camera that shakes in '
        'roll keeps its boresight filtered', unit='deg/s^2', low=1e-6, high=100.0)
    sigma_floor_px: float = option(
        0.01, 'lower limit of the 1-sigma error of a centroid per axis', unit='px',
        low=1e-4, high=10.0, live=True)
    detection_probability: float = option(
        0.95, 'how often a followed star is among the centroids', low=0.01, high=0.999)
    gate_probability: float = option(
        0.9999, 'how often the centroid of a star is inside its gate', low=0.5, high=0.999999)
    max_missed: int = option(
        5, 'frames in a row without a centroid after which a star is dropped, unless the whole '
        'image is dark', unit='frames', low=0, high=200, live=True)
    confirm_frames: int = option(
        3, 'frames after which a newly found star counts if it was missed in no more than half of '
        'them, and frames in a row in which a gyro must agree with the stars before it is used',
        unit='frames', low=1, high=100, live=True)
    magnitude_tolerance: float = option(
        1.0, 'largest difference of brightness between a newly found star and the catalogue',
        unit='mag', low=0.05, high=20.0, live=True)
    max_residual_px: float = option(
        1.0, 'largest rms residual of the stars of a good frame, measured minus catalogue; raise '
        'it for a lens that is not calibrated', unit='px', low=0.01, high=100.0, live=True)
    max_bad_frames: int = option(
        5, 'frames in a row with stars other than those followed, after which the tracker is lost',
        unit='frames', low=1, high=1000, live=True)
    max_rate_deg_s: float = option(
        10.0, 'fastest turn accepted between two identifications', unit='deg/s', low=0.001,
        high=100.0, live=True)
    max_gap_s: float = option(
        5.0, 'longest time without stars that is bridged, and longest between the two '
        'identifications of a start', unit='s', low=0.01, high=600.0, live=True)
