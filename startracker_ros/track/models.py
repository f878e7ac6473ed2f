"""The models of the motion of stars, by name."""

from startracker_ros.attitude.gyro import Gyro
from startracker_ros.camera.model import Camera
from startracker_ros.catalog.apparent import ApparentCatalog
from startracker_ros.track.attitude_model import AttitudeModel
from startracker_ros.track.independent_stars import IndependentStarsModel, NeighbourhoodModel
from startracker_ros.track.model import StarModel
from startracker_ros.track.options import TrackerOptions


def make_model(camera: Camera, sky: ApparentCatalog, options: TrackerOptions, gyro: Gyro
               ) -> StarModel:
    """Return the model that the options name."""
    if options.model == 'attitude':
        return AttitudeModel(camera, sky, options, gyro)
    model = NeighbourhoodModel if options.model == 'sna' else IndependentStarsModel
    return model(camera, sky, options)
