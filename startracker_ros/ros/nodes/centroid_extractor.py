"""centroid_extractor: image_raw, camera_info -> centroids, image_annotated, image_markers."""

from functools import partial

import cv2
import numpy as np
from sensor_msgs.msg import Image, PointCloud2
from startracker_ros.bag.layouts import image_from_message, MessageError
from startracker_ros.camera.model import Camera
from startracker_ros.centroid.extraction import CentroidExtractor, Extraction, ExtractionOptions
from startracker_ros.pipeline.annotate import annotate
from startracker_ros.ros import qos
from startracker_ros.ros.camera_node import CameraNode
from startracker_ros.ros.diagnostics import OK, WARN
from startracker_ros.ros.messages.clouds import centroids_to_message
from startracker_ros.ros.messages.image import image_message_from_cdr, image_to_message
from startracker_ros.ros.messages.image_marker import centroids_to_image_marker
from startracker_ros.ros.node import main_of
from std_msgs.msg import Header
from visualization_msgs.msg import ImageMarker


class CentroidExtractorNode(CameraNode):
    """Turns each image into a list of centroids; an empty list means looked, found none."""

    option_classes = (ExtractionOptions,)
    task = 'centroids'

    def __init__(self) -> None:
        super().__init__('centroid_extractor')
        # The nodes of a pipeline share the cores; OpenCV's threads, with which images are
        # annotated, would only wait for each other.
        cv2.setNumThreads(1)
        self.steady_topic = 'image_raw'
        self._centroids = self.give(PointCloud2, 'centroids', qos.LIST)
        self._annotated = self.give(Image, 'image_annotated', qos.IMAGE)
        self._markers = self.give(ImageMarker, 'image_markers', qos.LIST)

    def configure(self) -> None:
        self._extractor = CentroidExtractor(self.options(ExtractionOptions))

    def prepare(self, camera: Camera) -> None:
        self.tell_of_compiling()
        self._extractor.warm_up()
        # Images are taken from here on: a source that waits for subscribers then loses none.
        self.take(Image, 'image_raw', self._take_image, qos.IMAGE, decode=image_message_from_cdr)

    def _take_image(self, message: Image) -> None:
        image = image_from_message(message)
        camera = self.known_camera()
        if camera is None or not self.in_order('image_raw', message.header.stamp):
            return
        if image.shape != (camera.height, camera.width):
            raise MessageError(
                f'image of {message.width} x {message.height} px does not fit camera_info of '
                f'{camera.width} x {camera.height} px')
        extraction = self._extractor.extract(image)
        self._centroids.publish(centroids_to_message(
            extraction.centroids, camera, message.header))
        self.afterwards(partial(self._tell, message.header, image, extraction))

    def _tell(self, header: Header, image: np.ndarray, extraction: Extraction) -> None:
        """Publish the spots of an image for viewers, and report on it."""
        if self._annotated.get_subscription_count():
            self._annotated.publish(image_to_message(
                annotate(image, extraction.centroids.uv), header))
        if self._markers.get_subscription_count():
            self._markers.publish(centroids_to_image_marker(
                extraction.centroids.uv, header))
        found = len(extraction.centroids)
        self.diagnostics.values.update({
            'centroids': found,
            'background_dn': f'{extraction.background_dn:.1f}',
            'noise_dn': f'{extraction.noise_dn:.2f}',
            'psf_sigma_px': f'{extraction.psf_sigma_px:.2f}'})
        for reason, count in extraction.rejected.items():
            self.diagnostics.counts[f'rejected {reason}'] += count
        good = extraction.status == 'ok'
        self.diagnostics.report(OK if good else WARN,
                                'extracting centroids' if good else extraction.reason)


main = main_of(CentroidExtractorNode)

if __name__ == '__main__':
    main()
