"""The node: newest images in, parts out. Parameters and topics are in the README of the packages."""
import asyncio
import threading
import time
from types import SimpleNamespace

import numpy as np
import rclpy
import tf2_ros
from geometry_msgs.msg import Point, Pose, PoseWithCovarianceStamped, TransformStamped
from horopter_msgs.action import Recognize as RecognizeAction
from horopter_msgs.msg import ExpectedOutcome, PartGrasp
from horopter_msgs.srv import Recognize
from moveit_msgs.msg import CollisionObject
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.duration import Duration
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image
from shape_msgs.msg import Mesh, MeshTriangle, SolidPrimitive
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectoryPoint
from vision_msgs.msg import Detection3D, Detection3DArray, ObjectHypothesisWithPose

from horopter import AsyncClient, Client, HoropterError, Security

from . import conversions, images, settings

MESSAGES = SimpleNamespace(Pose=Pose, PoseWithCovarianceStamped=PoseWithCovarianceStamped,
                           TransformStamped=TransformStamped, PartGrasp=PartGrasp, JointTrajectoryPoint=JointTrajectoryPoint,
                           Detection3D=Detection3D, Detection3DArray=Detection3DArray, ExpectedOutcome=ExpectedOutcome,
                           ObjectHypothesisWithPose=ObjectHypothesisWithPose, CollisionObject=CollisionObject, Mesh=Mesh,
                           MeshTriangle=MeshTriangle, SolidPrimitive=SolidPrimitive, Point=Point)


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
        for name, default in settings.PARAMETERS.items():
            self.declare_parameter(name, default)
        self._client = Client(self._value("server"), security=self._security())
        self._infos, self._camera_poses, self._meshes = {}, {}, {}
        self._generation = None  # of the catalog that the meshes are of
        self._in_planning_scene = set()  # ids of collision objects
        self._lock = threading.Lock()
        group = ReentrantCallbackGroup()
        self._topics = list(self._value("image_topics"))
        self._buffer = images.ImageBuffer(self._topics, self._value("sync_slop"), self._value("max_image_age"))
        self._arm_topics, self._collection = settings.arm_topics(self._value), images.Collection()
        for topic, poses in settings.pose_topics(self._value).items():
            self.create_subscription(PoseWithCovarianceStamped, poses, lambda m, t=topic: self._keep(self._camera_poses, t, m), 1,
                                     callback_group=group)
        for topic in self._topics:
            info = topic.rsplit("/", 1)[0] + "/camera_info"
            self.create_subscription(Image, topic, lambda m, t=topic: self._keep_image(t, m),
                                     qos_profile_sensor_data, callback_group=group)
            self.create_subscription(CameraInfo, info, lambda m, t=topic: self._keep(self._infos, t, m),
                                     qos_profile_sensor_data, callback_group=group)
        self._tf = tf2_ros.Buffer()
        self._tf_listener = tf2_ros.TransformListener(self._tf, self)
        self._tf_out = tf2_ros.TransformBroadcaster(self)
        self._detections = self.create_publisher(Detection3DArray, "~/detections", 1)
        self._collision_objects = self.create_publisher(CollisionObject, "/collision_object", 10)
        self._poses = {}
        self.create_service(Trigger, "~/take", self._take, callback_group=group)
        self.create_service(Trigger, "~/forget", self._forget, callback_group=group)
        self.create_service(Recognize, "~/recognize", self._recognize, callback_group=group)
        self._action = ActionServer(self, RecognizeAction, "~/recognize", self._execute, callback_group=group,
                                    cancel_callback=lambda _: CancelResponse.ACCEPT)

    def _value(self, name):
        return self.get_parameter(name).value

    def _security(self):
        return Security(ca_file=self._value("tls_ca") or None, cert_file=self._value("tls_cert") or None,
                        key_file=self._value("tls_key") or None, token_file=self._value("token_file") or None)

    def _keep(self, where, topic, message):
        with self._lock:
            where[topic] = message

    def _keep_image(self, topic, message):
        with self._lock:
            self._buffer.add(topic, message)

    def _base_from_camera(self, frame_id, stamp):
        """Of TF at that time, for which it waits a little: transforms come later than images. None: not known."""
        try:
            found = self._tf.lookup_transform(self._value("base_frame"), frame_id, stamp, Duration(seconds=self._value("tf_timeout")))
            return conversions.matrix_of_transform(found.transform)
        except tf2_ros.TransformException:
            return None

    def _camera_pose(self, topic, image):
        """Pose of the camera in the base with its deviations (radians, metres), None where they, or it, are not known. Raises
        ValueError."""
        sigmas = self._value("camera_rotation_sigma") or None, self._value("camera_position_sigma") or None
        with self._lock:
            told = self._camera_poses.get(topic)
        if told is None:
            return (self._base_from_camera(image.header.frame_id, image.header.stamp), *sigmas)
        if told.header.frame_id != self._value("base_frame"):
            raise ValueError("the pose of the camera of %s is in %s, not in %s" % (topic, told.header.frame_id,
                                                                                   self._value("base_frame")))
        pose, *told_sigmas = conversions.pose_with_deviations(told.pose)
        return (pose, *(t if t is not None else s for t, s in zip(told_sigmas, sigmas)))

    def _take(self, _, response):
        """Service ~/take: keeps the newest image of each camera that moves, with the camera's pose, for the next answer."""
        try:
            if not self._arm_topics:
                raise ValueError("arm_topics names no camera that moves")
            for topic in self._arm_topics:
                with self._lock:
                    image = self._buffer.newest(topic)
                if image is None:
                    raise ValueError("no image has come in on %s" % topic)
                pose = self._base_from_camera(image.header.frame_id, image.header.stamp)
                with self._lock:
                    self._collection.add(topic, image, pose)
            response.success, response.message = True, "%d images are taken" % len(self._collection.views())
        except ValueError as error:
            response.success, response.message = False, str(error)
        return response

    def _forget(self, _, response):
        """Service ~/forget: drops what was taken."""
        with self._lock:
            self._collection.clear()
        response.success, response.message = True, "0 images are taken"
        return response

    def _mesh(self, object_id):
        """Vertices and triangles of the part in its own frame."""
        if object_id not in self._meshes:
            mesh = self._client.get_object(object_id).raw.mesh
            self._meshes[object_id] = (np.array(mesh.vertices_m).reshape(-1, 3), np.array(mesh.triangles, dtype=int).reshape(-1, 3))
        return self._meshes[object_id]

    def _box(self, object_id):
        points = self._mesh(object_id)[0]
        low, high = points.min(axis=0), points.max(axis=0)
        return (low + high) / 2, high - low

    def _views(self):
        """[(topic, image, pose, rotation deviation, position deviation)]: of fixed cameras of one moment, of cameras that move all that
        was taken. Raises ValueError."""
        now = self.get_clock().now().nanoseconds if self._value("max_image_age") else None
        with self._lock:
            together = self._buffer.of_one_moment(now)
            taken = self._collection.views()
        if taken:
            together = {t: i for t, i in together.items() if t not in self._arm_topics}
        views = [(t, i, *self._camera_pose(t, i)) for t, i in together.items()]
        sigmas = self._value("camera_rotation_sigma") or None, self._value("camera_position_sigma") or None
        views += [(t, i, pose, *sigmas) for t, i, pose in taken]
        missing = [t for t in self._topics if t not in {v[0] for v in views}]
        if missing and self._value("all_images") and views:
            raise ValueError("no image of the same moment on %s" % ", ".join(missing))
        return views

    def _question(self, request):
        """The images, and the arguments of Client.recognize; no images: none has come in. Raises ValueError."""
        views = self._views()
        if not views:
            return [], {}
        with self._lock:
            infos = [self._infos.get(view[0]) for view in views]
        hints = [conversions.camera_hint(info, pose, self._value("rectified"), (image.width, image.height), rotation, position)
                 for info, (_, image, pose, rotation, position) in zip(infos, views)]
        arguments = settings.request_arguments(self._value, [view[0] for view in views], request.expected,
                                               request.image_regions, request.space_regions)
        return [view[1] for view in views], dict(arguments, images=[conversions.scene_image(view[1]) for view in views], hints=hints,
                                                 candidates=list(request.candidates) or None,
                                                 deadline_s=request.deadline or self._value("deadline"))

    def _answer(self, request, response, ask):
        """Fills a response, or the result of an action. ask: keyword arguments -> Scene, or None of a call that was cancelled."""
        try:
            asked, arguments = self._question(request)
            if not asked:
                response.reasons, response.message = ["ERROR"], "no image has come in on %s" % ", ".join(self._topics)
                return response
            scene = ask(arguments)
            if scene is None:
                response.reasons, response.message = ["ERROR"], "cancelled"
                return response
            if scene.catalog_generation != self._generation:
                self._meshes, self._generation = {}, scene.catalog_generation
            boxes = {part.object_id: self._box(part.object_id) for part in scene.objects}
        except (HoropterError, ValueError) as error:
            response.reasons, response.message = ["ERROR"], str(error)
            response.request_id = getattr(error, "request_id", None) or ""
            return response
        self._fill(response, scene, asked, boxes)
        with self._lock:
            self._collection.clear()
        response.expected = conversions.expected_messages(scene, arguments["expected"], MESSAGES)
        response.all_present = scene.expected is None or scene.expected.all_present
        return response

    def _recognize(self, request, response):
        return self._answer(request, response, lambda arguments: self._client.recognize(**arguments))

    def _execute(self, goal):
        cancelled = []

        def ask(arguments):
            scene = asyncio.run(self._ask_until_cancelled(goal, arguments))
            if scene is None:
                cancelled.append(True)
            return scene

        result = self._answer(goal.request, RecognizeAction.Result(), ask)
        if cancelled:
            goal.canceled()
        elif result.reasons[:1] == ["ERROR"]:
            goal.abort()
        else:
            goal.succeed()
        return result

    async def _ask_until_cancelled(self, goal, arguments):
        """The answer; None once the goal was cancelled, which ends the call, too."""
        start = time.monotonic()
        async with AsyncClient(self._value("server"), security=self._security()) as client:
            call = asyncio.ensure_future(client.recognize(**arguments))
            while not (await asyncio.wait([call], timeout=0.1))[0]:
                feedback = RecognizeAction.Feedback()
                feedback.elapsed = time.monotonic() - start
                goal.publish_feedback(feedback)
                if goal.is_cancel_requested:
                    call.cancel()
                    await asyncio.wait([call])
                    return None
            return call.result()

    def _fill(self, response, scene, asked, boxes):
        frame = conversions.AnswerFrame(scene, self._value("base_frame"), [i.header.frame_id for i in asked])
        stamp = asked[0].header.stamp
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
        if self._value("collision_objects"):
            response.collision_objects = conversions.collision_messages(
                scene, frame, stamp, self._meshes, self._in_planning_scene, MESSAGES, self._value("collision_max_triangles"))
            self._in_planning_scene = {conversions.part_name(part) for part in scene.objects}
            for message in response.collision_objects:
                self._collision_objects.publish(message)
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
