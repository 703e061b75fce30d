"""Calls of robots and operators, and simple objects and images, for the tests of a cluster."""
import itertools
import math
import random

import grpc

from horopter.v1 import (catalog_pb2, catalog_pb2_grpc, recognition_pb2, recognition_pb2_grpc, server_pb2,  # noqa: E402
                         server_pb2_grpc)

SIDES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
EDGES = sorted({tuple(sorted((s[i], s[(i + 1) % 4]))) for s in SIDES for i in range(4)})


def box(seed):
    """A box of its own size."""
    rng = random.Random(seed)
    size = [rng.uniform(0.02, 0.2) for _ in range(3)]
    corners = [[size[k] * (i >> k & 1) for k in range(3)] for i in range(8)]
    thing = catalog_pb2.Object(display_name="box %d" % seed, diameter_m=math.dist(corners[0], corners[7]))
    thing.vertices_m.extend(x for c in corners for x in c)
    for a, b in EDGES:
        edge = thing.edges.add(kind=catalog_pb2.ModelEdge.CURVE_KIND_LINE, start_vertex=a, end_vertex=b, dihedral_rad=math.pi / 2)
        edge.polyline_m.extend(corners[a] + corners[b])
    thing.mesh.vertices_m.extend(x for c in corners for x in c)
    for a, b, c, d in SIDES:
        thing.mesh.triangles.extend((a, b, c, a, c, d))
    return thing


def rotate(q, v):
    """By a unit quaternion w, x, y, z."""
    w, u = q[0], q[1:]
    cross = lambda a, b: [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]  # noqa: E731
    once = cross(u, v)
    return [v[k] + 2 * (w * once[k] + cross(u, once)[k]) for k in range(3)]


def cube():
    """A box with all its symmetries, so that little is derived of it."""
    thing = box(0)
    side = 0.05
    corners = [[side * (i >> k & 1) for k in range(3)] for i in range(8)]
    thing.display_name, thing.diameter_m = "cube", math.dist(corners[0], corners[7])
    thing.vertices_m[:] = thing.mesh.vertices_m[:] = [x for c in corners for x in c]
    for edge in thing.edges:
        edge.polyline_m[:] = corners[edge.start_vertex] + corners[edge.end_vertex]
    for q in itertools.product((-1, 0, 1), repeat=4):
        parts = sum(map(abs, q))
        if parts not in (1, 2, 4) or q == (1, 0, 0, 0) or next(v for v in q if v) < 0:
            continue  # -q is the same turn
        w, x, y, z = (v / math.sqrt(parts) for v in q)
        turn = thing.object_from_symmetric_object.add()
        turn.rotation.w, turn.rotation.x, turn.rotation.y, turn.rotation.z = w, x, y, z
        turned = rotate((w, x, y, z), [side / 2] * 3)  # the middle, which stays
        turn.translation_m.x, turn.translation_m.y, turn.translation_m.z = (side / 2 - v for v in turned)
    return thing


class Calls:
    """A connection of its own to one address."""

    def __init__(self, target):
        self.channel = grpc.insecure_channel(target, options=[("grpc.use_local_subchannel_pool", 1),
                                                              ("grpc.initial_reconnect_backoff_ms", 100),
                                                              ("grpc.max_reconnect_backoff_ms", 300)])
        self.catalog = catalog_pb2_grpc.CatalogServiceStub(self.channel)
        self.server = server_pb2_grpc.ServerServiceStub(self.channel)
        self.recognition = recognition_pb2_grpc.RecognitionServiceStub(self.channel)

    def info(self, timeout=20):
        return self.server.GetServerInfo(server_pb2.GetServerInfoRequest(), timeout=timeout)

    def generation(self):
        return self.info().catalog_generation

    def create(self, name, seed, request_id="", timeout=40, thing=None):
        """A box, or that thing."""
        return self.catalog.CreateObject(catalog_pb2.CreateObjectRequest(object_id=name, object=thing or box(seed), request_id=request_id),
                                         timeout=timeout)

    def delete(self, name, timeout=40):
        return self.catalog.DeleteObject(catalog_pb2.DeleteObjectRequest(name="objects/" + name, allow_missing=True), timeout=timeout)

    def get(self, name, timeout=20):
        return self.catalog.GetObject(catalog_pb2.GetObjectRequest(name="objects/" + name), timeout=timeout)

    def ids(self):
        request, found = catalog_pb2.ListObjectsRequest(page_size=200), {}
        while True:
            answer = self.catalog.ListObjects(request, timeout=60)
            found.update((o.name.split("/")[1], o.display_name) for o in answer.objects)
            if not answer.next_page_token:
                return found
            request.page_token = answer.next_page_token

    def scene(self, image, candidate, timeout=120, metadata=()):
        request = recognition_pb2.RecognizeSceneRequest(candidate_objects=["objects/" + candidate])
        request.images.add(content=image)
        return self.recognition.RecognizeScene.with_call(request, timeout=timeout, metadata=metadata)

    def health(self):
        """Of grpc.health.v1: 1 SERVING, 2 NOT_SERVING; 0: no answer."""
        check = self.channel.unary_unary("/grpc.health.v1.Health/Check")
        try:
            return (check(b"", timeout=2) + b"\0\0")[1]
        except grpc.RpcError:
            return 0

    def serves(self):
        try:
            self.info(timeout=2)
            return True
        except grpc.RpcError:
            return False

    def close(self):
        self.channel.close()


def grey_image():
    """A small PNG of nothing."""
    import struct
    import zlib
    width, height = 64, 48

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    rows = b"".join(b"\0" + b"\x80" * width for _ in range(height))
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)) +
            chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))


def quantile(values, share):
    return sorted(values)[min(len(values) - 1, math.ceil(share * len(values)) - 1)]
