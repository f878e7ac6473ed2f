"""The identification methods by name."""

from startracker_ros.camera.model import Camera
from startracker_ros.catalog.stars import StarCatalog
from startracker_ros.identify.extended_grid import ExtendedGridIdentifier
from startracker_ros.identify.hausdorff_pivot import PivotIdentifier
from startracker_ros.identify.hausdorff_segment import SegmentIdentifier
from startracker_ros.identify.identification import IdentificationOptions, Identifier
from startracker_ros.identify.pyramid import PyramidIdentifier
from startracker_ros.identify.quad import QuadIdentifier

_METHODS: dict[str, type[Identifier]] = {
    'pyramid': PyramidIdentifier, 'quad': QuadIdentifier, 'hausdorff_pivot': PivotIdentifier,
    'hausdorff_segment': SegmentIdentifier, 'extended_grid': ExtendedGridIdentifier}


def make_identifier(camera: Camera, epoch_year: float,
                    options: IdentificationOptions = IdentificationOptions(),
                    catalog: StarCatalog | None = None) -> Identifier:
    """Return an identifier of the chosen method, its database built or cached."""
    return _METHODS[options.method](camera, epoch_year, options, catalog)
