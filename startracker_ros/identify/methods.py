"""The identification methods by name."""

from importlib import import_module

from startracker_ros.camera import Camera
from startracker_ros.catalog.stars import StarCatalog
from startracker_ros.identify.identification import IdentificationOptions, Identifier

_CLASSES = {
    'pyramid': 'PyramidIdentifier',
    'quad': 'QuadIdentifier',
    'hausdorff_pivot': 'PivotIdentifier',
    'hausdorff_segment': 'SegmentIdentifier',
    'extended_grid': 'ExtendedGridIdentifier',
}


def make_identifier(camera: Camera, epoch_year: float,
                    options: IdentificationOptions = IdentificationOptions(),
                    catalog: StarCatalog | None = None) -> Identifier:
    """Return an identifier of the chosen method, its database built or out of the cache."""
    module = import_module(f'startracker_ros.identify.{options.method}')
    return getattr(module, _CLASSES[options.method])(camera, epoch_year, options, catalog)
