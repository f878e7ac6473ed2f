"""The models of the motion of stars, by name."""

from startracker_ros.core.attitude.gyro import Gyro
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.track.attitude_model import AttitudeModel
from startracker_ros.core.track.independent_stars import IndependentStarsModel, NeighbourhoodModel
from startracker_ros.core.track.model import StarModel
from startracker_ros.core.track.options import TrackerOptions


def make_model(camera: Camera, options: TrackerOptions, gyro: Gyro) -> StarModel:
    """Return the model that the options name."""
    if options.model == 'attitude':
        return AttitudeModel(camera, options, gyro)
    model = NeighbourhoodModel if options.model == 'sna' else IndependentStarsModel
    return model(camera, options, gyro)
