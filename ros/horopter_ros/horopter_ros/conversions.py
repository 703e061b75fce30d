"""Between ROS messages and the `horopter` package. Messages are passed in or made by `messages`, an object whose attributes
are the message classes, so that nothing of ROS is needed to test this."""
import numpy as np

from horopter import CameraHint, RawFrame, hint_from_camera_info
from horopter.types import quaternion_of

# encoding of sensor_msgs/Image -> (numpy type, channels, order of red, green, blue or None for grey)
ENCODINGS = {
    "mono8": (np.uint8, 1, None),
    "8UC1": (np.uint8, 1, None),
    "mono16": (np.uint16, 1, None),
    "16UC1": (np.uint16, 1, None),
    "rgb8": (np.uint8, 3, (0, 1, 2)),
    "bgr8": (np.uint8, 3, (2, 1, 0)),
    "8UC3": (np.uint8, 3, (2, 1, 0)),
    "rgba8": (np.uint8, 4, (0, 1, 2)),
    "bgra8": (np.uint8, 4, (2, 1, 0)),
    "8UC4": (np.uint8, 4, (2, 1, 0)),
    "rgb16": (np.uint16, 3, (0, 1, 2)),
    "bgr16": (np.uint16, 3, (2, 1, 0)),
    "16UC3": (np.uint16, 3, (2, 1, 0)),
    "rgba16": (np.uint16, 4, (0, 1, 2)),
    "bgra16": (np.uint16, 4, (2, 1, 0)),
    "16UC4": (np.uint16, 4, (2, 1, 0)),
}

# Encodings that the server develops -> (format of RawFrame, numpy type, words in a row for two pixels, rows for two rows)
RAW_ENCODINGS = {
    "nv12": ("NV12", np.uint8, 2, 3),
    "nv21": ("NV21", np.uint8, 2, 3),
    "yuv422": ("UYVY", np.uint8, 4, 2),
    "uyvy": ("UYVY", np.uint8, 4, 2),
    "yuv422_yuy2": ("YUYV", np.uint8, 4, 2),
    "yuyv": ("YUYV", np.uint8, 4, 2),
}
for _ros, _raw in (("rggb", "RG"), ("bggr", "BG"), ("gbrg", "GB"), ("grbg", "GR")):
    RAW_ENCODINGS["bayer_%s8" % _ros] = ("BAYER_%s8" % _raw, np.uint8, 2, 2)
    RAW_ENCODINGS["bayer_%s16" % _ros] = ("BAYER_%s16" % _raw, np.uint16, 2, 2)


def _words(image, kind, per_row, rows):
    """(rows, per_row) of the words of a sensor_msgs/Image in this machine's order; padding at the ends of rows is dropped."""
    kind = np.dtype(kind).newbyteorder(">" if image.is_bigendian else "<")
    row = per_row * kind.itemsize
    data = np.frombuffer(bytes(image.data), np.uint8)
    if image.step < row or data.size < image.step * rows:
        raise ValueError("an image of %d x %d in %s needs more than %d bytes" % (image.width, image.height, image.encoding,
                                                                                data.size))
    bytes_ = np.ascontiguousarray(data[:image.step * rows].reshape(rows, image.step)[:, :row])
    return bytes_.view(kind).astype(kind.newbyteorder("="))


def image_array(image):
    """(h, w) or (h, w, 3) red, green, blue of a sensor_msgs/Image; padding at the ends of rows is dropped.

    Raises ValueError: an encoding that holds no such pixels (see scene_image), too few bytes.
    """
    if image.encoding not in ENCODINGS:
        raise ValueError("image encoding %r is not one of %s" % (image.encoding, ", ".join(sorted(ENCODINGS))))
    kind, channels, order = ENCODINGS[image.encoding]
    words = _words(image, kind, image.width * channels, image.height)
    pixels = words.reshape(image.height, image.width, channels)
    return pixels[:, :, 0] if order is None else np.ascontiguousarray(pixels[:, :, order])


def scene_image(image):
    """A sensor_msgs/Image as the client sends it: an array, or a RawFrame of mosaics and YUV, which the server develops.

    Raises ValueError: an encoding that is not known, too few bytes.
    """
    if image.encoding in ENCODINGS:
        return image_array(image)
    if image.encoding not in RAW_ENCODINGS:
        raise ValueError("image encoding %r is not one of %s" % (image.encoding,
                                                                 ", ".join(sorted({**ENCODINGS, **RAW_ENCODINGS}))))
    name, kind, words_for_two, rows_for_two = RAW_ENCODINGS[image.encoding]
    words = _words(image, kind, image.width * words_for_two // 2, image.height * rows_for_two // 2)
    return RawFrame(name, image.width, image.height, words)


def camera_hint(info, base_from_camera=None, rectified=False, image_size=None, rotation_sigma=None, position_sigma=None):
    """CameraHint of a sensor_msgs/CameraInfo, or of None: see horopter.hint_from_camera_info. An uncalibrated camera (K all 0)
    gives no intrinsics. base_from_camera: 4 x 4, of the optical frame, with its standard deviations (radians, metres; None: the
    server's); image_size: width and height of the image."""
    hint = None if info is None else hint_from_camera_info(info, image_size, rectified)
    if base_from_camera is None:
        return hint
    hint = hint or CameraHint()
    hint.base_from_camera = base_from_camera
    hint.rotation_sigma_rad, hint.position_sigma_m = rotation_sigma, position_sigma
    return hint


def ros_covariance(covariance):
    """36 numbers, row-major, of (x, y, z, rotation X, Y, Z) from a 6 x 6 of (rotation, translation); zeros of None."""
    if covariance is None:
        return [0.0] * 36
    order = [3, 4, 5, 0, 1, 2]
    return [float(v) for v in np.asarray(covariance)[np.ix_(order, order)].reshape(-1)]


def pose_message(matrix, messages):
    pose = messages.Pose()
    pose.position.x, pose.position.y, pose.position.z = (float(v) for v in matrix[:3, 3])
    w, x, y, z = quaternion_of(matrix[:3, :3])
    pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w = x, y, z, w
    return pose


def matrix_of_quaternion(x, y, z, w):
    """3 x 3 of a quaternion as ROS writes it."""
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])


def matrix_of_transform(transform):
    """4 x 4 of a geometry_msgs/Transform."""
    q, t = transform.rotation, transform.translation
    out = np.eye(4)
    out[:3, :3] = matrix_of_quaternion(q.x, q.y, q.z, q.w)
    out[:3, 3] = [t.x, t.y, t.z]
    return out


def pose_with_deviations(message):
    """4 x 4 and the standard deviations (radians, metres) of a geometry_msgs/PoseWithCovariance: of the direction that is known
    least; None where the covariance says nothing (all 0). Raises ValueError: no quaternion, no covariance."""
    q, p = message.pose.orientation, message.pose.position
    numbers = np.array([q.x, q.y, q.z, q.w, p.x, p.y, p.z])
    if not np.isfinite(numbers).all() or abs(np.linalg.norm(numbers[:4]) - 1.0) > 0.01:
        raise ValueError("the pose's quaternion has not the norm 1")
    pose = np.eye(4)
    pose[:3, :3] = matrix_of_quaternion(*(numbers[:4] / np.linalg.norm(numbers[:4])))
    pose[:3, 3] = numbers[4:]
    covariance = np.array(message.covariance, dtype=float).reshape(6, 6)
    if not covariance.any():
        return pose, None, None
    if not np.isfinite(covariance).all() or np.linalg.eigvalsh((covariance + covariance.T) / 2).min() < -1e-9:
        raise ValueError("the pose's covariance is none")
    position, rotation = (float(np.sqrt(max(0.0, np.linalg.eigvalsh(covariance[k:k + 3, k:k + 3]).max()))) for k in (0, 3))
    return pose, rotation or None, position or None


def part_name(part):
    return "%s_%d" % (part.object_id, part.instance)


class AnswerFrame:
    """The frame an answer is given in: the base where it is known, else the first recovered camera's optical frame."""

    def __init__(self, scene, base_frame, camera_frames):
        self.in_base = scene.base_from_scene is not None
        self.camera = next((i for i, c in enumerate(scene.cameras) if c.recovered), None)
        self.frame_id = base_frame if self.in_base else camera_frames[self.camera or 0]
        if self.in_base:
            self.frame_from_scene = scene.base_from_scene
        elif self.camera is not None:
            self.frame_from_scene = scene.cameras[self.camera].camera_from_scene
        else:
            self.frame_from_scene = np.eye(4)

    def pose(self, part):
        """Pose (4 x 4) and covariance (6 x 6 of rotation, translation, or None) of a part in this frame."""
        if self.in_base and part.base_from_object is not None:
            return part.base_from_object, part.base_covariance
        if not self.in_base and self.camera is not None and part.images[self.camera].camera_from_object is not None:
            return part.images[self.camera].camera_from_object, part.images[self.camera].covariance
        turn = np.kron(np.eye(2), self.frame_from_scene[:3, :3])
        covariance = None if part.covariance is None else turn @ part.covariance @ turn.T
        return self.frame_from_scene @ part.scene_from_object, covariance


def detections_message(scene, frame, stamp, boxes, messages):
    """vision_msgs/Detection3DArray. boxes: id -> (centre, size) of the part in its own frame, metres; may lack parts."""
    out = messages.Detection3DArray()
    out.header.stamp, out.header.frame_id = stamp, frame.frame_id
    for part in scene.objects:
        pose, covariance = frame.pose(part)
        detection = messages.Detection3D()
        detection.header.stamp, detection.header.frame_id = stamp, frame.frame_id
        detection.id = part_name(part)
        for object_id in [part.object_id] + [a for a in part.alternatives if a != part.object_id]:
            hypothesis = messages.ObjectHypothesisWithPose()
            hypothesis.hypothesis.class_id = object_id
            # What the images do not tell apart shares the probability.
            hypothesis.hypothesis.score = part.score / (1 + len(set(part.alternatives) - {part.object_id}))
            hypothesis.pose.pose = pose_message(pose, messages)
            hypothesis.pose.covariance = ros_covariance(covariance)
            detection.results.append(hypothesis)
        if part.object_id in boxes:
            centre, size = boxes[part.object_id]
            in_frame = pose.copy()
            in_frame[:3, 3] = pose[:3, :3] @ np.asarray(centre) + pose[:3, 3]
            detection.bbox.center = pose_message(in_frame, messages)
            detection.bbox.size.x, detection.bbox.size.y, detection.bbox.size.z = (float(v) for v in size)
        out.detections.append(detection)
    return out


def collision_messages(scene, frame, stamp, meshes, before, messages, most_triangles=20000):
    """moveit_msgs/CollisionObject of each part, to be put into a planning scene, and of each part of `before` (ids) that is not there
    any more, to be taken out. meshes: id -> (vertices n x 3 in metres, triangles m x 3) of the part in its own frame; of more
    triangles than most_triangles its bounding box stands for it."""
    kind = messages.CollisionObject
    out = []
    for part in scene.objects:
        pose, _ = frame.pose(part)
        vertices, triangles = (np.asarray(m) for m in meshes[part.object_id])
        message = kind()
        message.header.stamp, message.header.frame_id = stamp, frame.frame_id
        message.id, message.operation = part_name(part), kind.ADD
        message.type.key = part.object_id
        message.pose = pose_message(pose, messages)
        if len(triangles) <= most_triangles:
            mesh = messages.Mesh()
            for row in triangles:
                triangle = messages.MeshTriangle()
                triangle.vertex_indices = [int(v) for v in row]
                mesh.triangles.append(triangle)
            for row in vertices:
                point = messages.Point()
                point.x, point.y, point.z = (float(v) for v in row)
                mesh.vertices.append(point)
            message.meshes.append(mesh)
            message.mesh_poses.append(pose_message(np.eye(4), messages))
        else:
            low, high = vertices.min(axis=0), vertices.max(axis=0)
            box = messages.SolidPrimitive()
            box.type, box.dimensions = messages.SolidPrimitive.BOX, [float(v) for v in high - low]
            middle = np.eye(4)
            middle[:3, 3] = (low + high) / 2
            message.primitives.append(box)
            message.primitive_poses.append(pose_message(middle, messages))
        out.append(message)
    there = {message.id for message in out}
    for name in sorted(set(before) - there):
        message = kind()
        message.header.stamp, message.header.frame_id = stamp, frame.frame_id
        message.id, message.operation = name, kind.REMOVE
        out.append(message)
    return out


def pose_messages(scene, frame, stamp, messages):
    """(name, geometry_msgs/PoseWithCovarianceStamped) of each part."""
    out = []
    for part in scene.objects:
        pose, covariance = frame.pose(part)
        message = messages.PoseWithCovarianceStamped()
        message.header.stamp, message.header.frame_id = stamp, frame.frame_id
        message.pose.pose = pose_message(pose, messages)
        message.pose.covariance = ros_covariance(covariance)
        out.append((part_name(part), message))
    return out


def transform_messages(scene, frame, stamp, messages):
    """geometry_msgs/TransformStamped of each part: frame horopter/ID_N in the answer's frame."""
    out = []
    for part in scene.objects:
        pose, _ = frame.pose(part)
        as_pose = pose_message(pose, messages)
        message = messages.TransformStamped()
        message.header.stamp, message.header.frame_id = stamp, frame.frame_id
        message.child_frame_id = "horopter/" + part_name(part)
        p = as_pose.position
        message.transform.translation.x, message.transform.translation.y, message.transform.translation.z = p.x, p.y, p.z
        message.transform.rotation = as_pose.orientation
        out.append(message)
    return out


def grasp_messages(scene, frame, stamp, messages, gripper_from_tool=None, finger_joints=()):
    """horopter_msgs/PartGrasp of every reachable grasp, best first for each part.

    gripper_from_tool: 4 x 4, MoveIt's end effector link in the gripper frame of the server (between the tips, z approaches,
    x closes); finger_joints: names of two joints that open by half the jaw opening each, for the pre-grasp posture.
    """
    tool = np.eye(4) if gripper_from_tool is None else gripper_from_tool
    out = []
    for part in scene.objects:
        for grasp in part.grasps:
            frame_from_gripper = frame.frame_from_scene @ grasp.scene_from_gripper
            message = messages.PartGrasp()
            message.part, message.instance, message.name = part.object_id, part.instance, grasp.name
            message.success, message.jaw_opening = grasp.success, grasp.jaw_opening_m
            g = message.grasp
            g.id = "%s/%s" % (part_name(part), grasp.name)
            g.grasp_pose.header.stamp, g.grasp_pose.header.frame_id = stamp, frame.frame_id
            g.grasp_pose.pose = pose_message(frame_from_gripper @ tool, messages)
            g.grasp_quality = grasp.quality * grasp.success
            approach = frame.frame_from_scene @ grasp.scene_from_pregrasp
            way = frame_from_gripper[:3, 3] - approach[:3, 3]
            distance = float(np.linalg.norm(way))
            direction = way / distance if distance > 1e-9 else frame_from_gripper[:3, 2]
            _translation(g.pre_grasp_approach, direction, distance, stamp, frame.frame_id)
            _translation(g.post_grasp_retreat, -direction, distance, stamp, frame.frame_id)
            # A cup has no joints to open.
            joints = () if grasp.cup_radius_m is not None else finger_joints
            for posture, opening in ((g.pre_grasp_posture, grasp.jaw_opening_m), (g.grasp_posture, grasp.grip_width_m)):
                posture.joint_names = list(joints)
                if joints:
                    point = messages.JointTrajectoryPoint()
                    point.positions = [opening / 2] * len(joints)
                    posture.points.append(point)
            out.append(message)
    return out


def expected_messages(scene, expected, messages):
    """horopter_msgs/ExpectedOutcome of every part that the request expected (ExpectedPart)."""
    out = []
    for told in scene.expected.outcomes if scene.expected is not None else ():
        message = messages.ExpectedOutcome()
        message.part = expected[told.expected_index].object_id
        message.label, message.state, message.detail = told.label, told.state, told.detail
        for name, probability in told.probabilities.items():
            setattr(message, name.lower(), probability)
        message.found_part, message.found_instance = told.object_id or "", told.instance
        message.distance = float("nan") if told.distance_m is None else told.distance_m
        message.rotation = float("nan") if told.rotation_rad is None else told.rotation_rad
        out.append(message)
    return out


def _translation(out, direction, distance, stamp, frame_id):
    out.direction.header.stamp, out.direction.header.frame_id = stamp, frame_id
    out.direction.vector.x, out.direction.vector.y, out.direction.vector.z = (float(v) for v in direction)
    out.desired_distance = distance
    out.min_distance = 0.5 * distance
