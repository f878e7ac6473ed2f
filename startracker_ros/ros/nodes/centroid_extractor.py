# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""centroid_extractor: images and what is known of them -> centroids, annotated images."""

from functools import partial

import cv2
import numpy as np
from sensor_msgs.msg import Image, PointCloud2, TimeReference
from startracker_ros.core.centroid.extraction import Extraction, ExtractionOptions
from startracker_ros.core.centroid.prediction import PredictedCentroids
from startracker_ros.core.exposure.image_figures import FWHM_PER_SIGMA
from startracker_ros.core.stages.annotate import annotate, Labels, mark_bodies
from startracker_ros.core.stages.bodies import BodyInImage
from startracker_ros.core.stages.extraction import ExtractionStage, SearchOptions
from startracker_ros.core.stages.frame_path import FramePath
from startracker_ros.io.bags.layouts import ns_from_stamp, StarImage
from startracker_ros.io.bags.telemetry import ExposureTimes
from startracker_ros.ros import qos
from startracker_ros.ros.camera_node import CameraNode
from startracker_ros.ros.diagnostics import OK, WARN
from startracker_ros.ros.image_topic import (
    subscribe_images, TransportOptions, why_images_are_missing)
from startracker_ros.ros.messages.clouds import (
    bodies_from_message, centroids_to_message, predictions_from_message)
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.image import centroids_to_image_marker, image_to_message
from startracker_ros.ros.node import main_of, publish_if_subscribed, publish_value
from std_msgs.msg import Header
from visualization_msgs.msg import ImageMarker


class CentroidExtractorNode(CameraNode):
    """Extracts the centroids of each image; an empty list means that there are none."""

    option_classes = (ExtractionOptions, SearchOptions, TransportOptions)
    task = 'centroids'

    def __init__(self) -> None:
        super().__init__('centroid_extractor')
        # The nodes of a pipeline share the cores: more threads of OpenCV would only compete.
        cv2.setNumThreads(1)
        self.frame_topic = self.options(TransportOptions).topic
        self._centroids = self.advertise(PointCloud2, 'centroids', qos.LIST)
        self._annotated = self.advertise(Image, 'image_annotated', qos.IMAGE)
        self._markers = self.advertise(ImageMarker, 'image_markers', qos.LIST)
        # At once, to count the frames that come before it is ready for images.
        self.subscribe_camera_info()
        self.subscribe(PointCloud2, 'predicted_centroids', self._on_predicted, qos.LIST)
        self.subscribe(TimeReference, 'exposure_start',
                       lambda message: self._exposures.add(message), qos.LIST, first=True)
        if self.one_call is not None:
            self.one_call.extractor = self

    def restart(self) -> None:
        self._predicted: PredictedCentroids | None = None
        self._bodies: tuple[BodyInImage, ...] = ()
        self._exposures = ExposureTimes()
        self._stage = ExtractionStage(self.options(ExtractionOptions),
                                      self.options(SearchOptions))
        if self.one_call is not None:
            self.one_call.restart()

    def use_path(self, path: FramePath) -> None:
        """Extract on a path that serves other nodes as well."""
        self._stage = path.extraction
        # Live options that have changed meanwhile.
        self.set_live_options()

    def set_live_options(self) -> None:
        self._stage.set_options(self.options(ExtractionOptions), self.options(SearchOptions))

    def get_ready(self) -> None:
        if self.has_publisher(self.frame_topic):
            self.report_camera()
        subscribe_images(self, self._on_image)

    def why_missing(self) -> str:
        return why_images_are_missing(self)

    def _on_predicted(self, message: PointCloud2) -> None:
        camera = self.camera_or_drop()
        if camera is not None:
            # A message that is rejected leaves no older prediction in use.
            self._predicted, self._bodies = None, ()
            self._predicted = predictions_from_message(message, camera)
            self._bodies = bodies_from_message(message)

    def _on_image(self, image: StarImage, header: Header) -> None:
        camera = self.camera_or_drop()
        if camera is None or not self.in_order(self.frame_topic, header.stamp):
            return
        image.check_size(camera)
        stamp_ns = ns_from_stamp(header.stamp)
        header = make_header(stamp_ns, self.follow_frame(header.frame_id))
        extraction = self._extract(stamp_ns, image, header.frame_id)
        centroids, windowed = extraction.centroids, self._stage.windowed
        publish_value(self._centroids, header, (centroids, windowed and len(centroids) > 0),
                      partial(centroids_to_message, centroids, camera, header, windowed))
        self.defer(partial(self._report, header, image, extraction))

    def _extract(self, stamp_ns: int, image: StarImage, frame_id: str) -> Extraction:
        exposure_s = self._exposures.at(stamp_ns)
        if self.one_call is not None:
            path = self.one_call.process(stamp_ns, image, exposure_s, frame_id)
            if path is not None:
                return path.extracted()
        return self._stage.process(
            stamp_ns, image.pixels, self._predicted,
            lost=self.has_publisher('predicted_centroids'), cell=image.cell,
            exposure_s=exposure_s)

    def _picture(self, image: np.ndarray, extraction: Extraction) -> np.ndarray:
        """Return the image with its centroids and bodies marked."""
        labels = Labels(image.shape, extraction.centroids.uv)
        picture = annotate(image, extraction.centroids.uv, rejected=extraction.rejected_uv,
                           labels=labels)
        mark_bodies(picture, self._bodies, labels)
        return picture

    def _report(self, header: Header, image: StarImage, extraction: Extraction) -> None:
        """Publish the centroids for viewers, and the status."""
        publish_if_subscribed(self._annotated, lambda: image_to_message(
            self._picture(image.in_full(), extraction), header))
        publish_if_subscribed(self._markers, lambda: centroids_to_image_marker(
            extraction.centroids.uv, header))
        self.diagnostics.describe = partial(_describe, extraction, self._stage.windowed)
        for reason, count in extraction.rejected.items():
            self.diagnostics.counts[f'rejected {reason}'] += count
        good = extraction.status == 'ok'
        self.diagnostics.report(OK if good else WARN,
                                'extracting centroids' if good else extraction.reason)


def _describe(extraction: Extraction, windowed: bool) -> dict[str, object]:
    return {'centroids': len(extraction.centroids),
            'background_dn': f'{extraction.background_dn:.1f}',
            'noise_dn': f'{extraction.noise_dn:.2f}',
            'psf_sigma_px': f'{extraction.psf_sigma_px:.2f}',
            'fwhm_px': f'{FWHM_PER_SIGMA * extraction.psf_sigma_px:.2f}',
            'streak_px': f'{extraction.streak_px:.1f}',
            'searched': 'near predictions' if windowed else 'whole image'}


main = main_of(CentroidExtractorNode)

if __name__ == '__main__':
    main()
