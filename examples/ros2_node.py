"""A ROS 2 node that watches the extrinsic: ros2 run, with the parameters ``weights`` and ``drive``.

Needs rclpy, cv_bridge, sensor_msgs_py and message_filters of a ROS 2 installation, and uncal.
"""

import json

import numpy as np
import rclpy
from cv_bridge import CvBridge
from message_filters import ApproximateTimeSynchronizer, Subscriber
from rclpy.node import Node
from sensor_msgs.msg import Image, PointCloud2
from sensor_msgs_py.point_cloud2 import read_points
from std_msgs.msg import String

from uncal.monitor import Monitor
from uncal.recordings.frame import Frame, FrameId


class ExtrinsicMonitor(Node):
    """Publishes a verdict, as JSON on ``~/verdict``, for every image with its sweep."""

    def __init__(self) -> None:
        super().__init__("extrinsic_monitor")
        K = self.declare_parameter("K", [0.0] * 9).value
        T = self.declare_parameter("T_cam_lidar", [0.0] * 16).value
        self.K, self.T = np.reshape(K, (3, 3)), np.reshape(T, (4, 4))
        self.monitor = Monitor(self.declare_parameter("weights", "unical").value)
        self.bridge, self.count = CvBridge(), 0
        self.publisher = self.create_publisher(String, "~/verdict", 10)
        topics = Subscriber(self, Image, "image_rect"), Subscriber(self, PointCloud2, "points")
        ApproximateTimeSynchronizer(topics, 10, slop=0.05).registerCallback(self.see)

    def see(self, image: Image, cloud: PointCloud2) -> None:
        """One rectified image and the sweep nearest to it; reflectance is taken as 0..255."""
        rows = read_points(cloud, ("x", "y", "z", "intensity"), skip_nans=True)
        points = np.stack([rows[name].astype(np.float32) for name in rows.dtype.names], -1)
        points[:, 3] = np.clip(points[:, 3] / 255.0, 0.0, 1.0)
        rgb = self.bridge.imgmsg_to_cv2(image, "rgb8")
        time = image.header.stamp.sec + 1e-9 * image.header.stamp.nanosec
        frame = Frame(FrameId("rig", "drive", self.count), rgb, points, self.K, self.T, time)
        self.count += 1
        verdict = self.monitor.update(frame)
        self.publisher.publish(String(data=json.dumps(verdict.as_json())))


if __name__ == "__main__":
    rclpy.init()
    rclpy.spin(ExtrinsicMonitor())
