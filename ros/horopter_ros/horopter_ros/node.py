"""The node: newest images in, parts out. Parameters and topics are in the README of the packages."""
import threading
from types import SimpleNamespace

import numpy as np
import rclpy
import tf2_ros
from geometry_msgs.msg import Pose, PoseWithCovarianceStamped, TransformStamped
from horopter_msgs.msg import PartGrasp
from horopter_msgs.srv import Recognize
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image
from trajectory_msgs.msg import JointTrajectoryPoint
from vision_msgs.msg import Detection3D, Detection3DArray, ObjectHypothesisWithPose

from horopter import Client, HoropterError, Security

from . import conversions

MESSAGES = SimpleNamespace(Pose=Pose, PoseWithCovarianceStamped=PoseWithCovarianceStamped,
                           TransformStamped=TransformStamped, PartGrasp=PartGrasp, JointTrajectoryPoint=JointTrajectoryPoint,
                           Detection3D=Detection3D, Detection3DArray=Detection3DArray,
                           ObjectHypothesisWithPose=ObjectHypothesisWithPose)


class Recognizer(Node):

    def __init__(self):
        super().__init__("horopter")
        self.declare_parameter("server", "localhost:50051")
        self.declare_parameter("deadline", 60.0)
        self.declare_parameter("base_frame", "base_link")
        self.declare_parameter("image_topics", ["/image_raw"])
        self.declare_parameter("rectified", False)
        self.declare_parameter("finger_joints", [""])
        self.declare_parameter("gripper_from_tool", [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
        for name in ("tls_ca", "tls_cert", "tls_key", "token_file"):
            self.declare_parameter(name, "")
        self._client = Client(self._value("server"), security=self._security())
        self._newest, self._infos, self._boxes = {}, {}, {}
        self._lock = threading.Lock()
        group = ReentrantCallbackGroup()
        self._topics = list(self._value("image_topics"))
        for topic in self._topics:
            info = topic.rsplit("/", 1)[0] + "/camera_info"
            self.create_subscription(Image, topic, lambda m, t=topic: self._keep(self._newest, t, m),
                                     qos_profile_sensor_data, callback_group=group)
            self.create_subscription(CameraInfo, info, lambda m, t=topic: self._keep(self._infos, t, m),
                                     qos_profile_sensor_data, callback_group=group)
        self._tf = tf2_ros.Buffer()
        self._tf_listener = tf2_ros.TransformListener(self._tf, self)
        self._tf_out = tf2_ros.TransformBroadcaster(self)
        self._detections = self.create_publisher(Detection3DArray, "~/detections", 1)
        self._poses = {}
        self.create_service(Recognize, "~/recognize", self._recognize, callback_group=group)

    def _value(self, name):
        return self.get_parameter(name).value

    def _security(self):
        return Security(ca_file=self._value("tls_ca") or None, cert_file=self._value("tls_cert") or None,
                        key_file=self._value("tls_key") or None, token_file=self._value("token_file") or None)

    def _keep(self, where, topic, message):
        with self._lock:
            where[topic] = message

    def _base_from_camera(self, frame_id, stamp):
        try:
            found = self._tf.lookup_transform(self._value("base_frame"), frame_id, stamp)
            return conversions.matrix_of_transform(found.transform)
        except tf2_ros.TransformException:
            return None

    def _box(self, object_id):
        if object_id not in self._boxes:
            points = np.array(self._client.get_object(object_id).raw.mesh.vertices_m).reshape(-1, 3)
            low, high = points.min(axis=0), points.max(axis=0)
            self._boxes[object_id] = ((low + high) / 2, high - low)
        return self._boxes[object_id]

    def _recognize(self, request, response):
        with self._lock:
            images = [self._newest[t] for t in self._topics if t in self._newest]
            infos = [self._infos.get(t) for t in self._topics if t in self._newest]
        if not images:
            response.reasons, response.message = ["ERROR"], "no image has come in on %s" % ", ".join(self._topics)
            return response
        try:
            hints = [conversions.camera_hint(info, self._base_from_camera(image.header.frame_id, image.header.stamp),
                                             self._value("rectified"), (image.width, image.height))
                     for image, info in zip(images, infos)]
            scene = self._client.recognize([conversions.scene_image(i) for i in images], hints,
                                           list(request.candidates) or None,
                                           deadline_s=request.deadline or self._value("deadline"))
            boxes = {part.object_id: self._box(part.object_id) for part in scene.objects}
        except (HoropterError, ValueError) as error:
            response.reasons, response.message = ["ERROR"], str(error)
            response.request_id = getattr(error, "request_id", None) or ""
            return response
        self._fill(response, scene, images, boxes)
        return response

    def _fill(self, response, scene, images, boxes):
        frame = conversions.AnswerFrame(scene, self._value("base_frame"), [i.header.frame_id for i in images])
        stamp = images[0].header.stamp
        response.success, response.complete = bool(scene.objects), scene.complete
        response.reasons = [r.kind for r in scene.reasons]
        response.message, response.request_id = "; ".join(r.detail for r in scene.reasons if r.detail), scene.request_id
        response.detections = conversions.detections_message(scene, frame, stamp, boxes, MESSAGES)
        x, y, z, qx, qy, qz, qw = self._value("gripper_from_tool")
        transform = SimpleNamespace(translation=SimpleNamespace(x=x, y=y, z=z),
                                    rotation=SimpleNamespace(x=qx, y=qy, z=qz, w=qw))
        joints = [j for j in self._value("finger_joints") if j]
        response.grasps = conversions.grasp_messages(scene, frame, stamp, MESSAGES,
                                                     conversions.matrix_of_transform(transform), joints)
        self._detections.publish(response.detections)
        for name, message in conversions.pose_messages(scene, frame, stamp, MESSAGES):
            if name not in self._poses:
                topic = "~/poses/" + name.replace("-", "_")  # names of topics have no dashes
                self._poses[name] = self.create_publisher(PoseWithCovarianceStamped, topic, 1)
            self._poses[name].publish(message)
        for message in conversions.transform_messages(scene, frame, stamp, MESSAGES):
            self._tf_out.sendTransform(message)


def main():
    rclpy.init()
    executor = MultiThreadedExecutor()
    executor.add_node(Recognizer())
    try:
        executor.spin()
    except KeyboardInterrupt:
        pass


if __name__ == "__main__":
    main()
