"""Checks of cluster_test.py with other machines than three replicas behind HAProxy: nginx, Prometheus, eight replicas, rankers."""
import hashlib
import math
import os
import signal
import struct
import sys
import threading
import time
import zlib

import grpc

import machines
from calls import SIDES, Calls, box, cube, grey_image, quantile
from horopter.v1 import catalog_pb2, recognition_pb2
from machines import await_true

QUICK = "--quick" in sys.argv
FAKETIME = "/usr/lib/x86_64-linux-gnu/faketime/libfaketimeMT.so.1"


def serving(cluster, replicas):
    """Calls of these replicas, started, once they serve; they go with the cluster."""
    cluster.others += replicas
    for r in replicas:
        r.start()
    calls = [Calls(r.target) for r in replicas]
    for r, c in zip(replicas, calls):
        await_true(r.name + " serves", c.serves, 90)
    return calls


def more_replicas(cluster, count, name, database=None, **options):
    """Further replicas, of another database if it is named, which serve; they go with the cluster."""
    address = (database or cluster.database).address()
    out = [machines.Replica(cluster.replicas[0].program, cluster.folder, "%s%d" % (name, i + 1), address, **options) for i in range(count)]
    return out, serving(cluster, out)


def end(replicas, calls):
    for c in calls:
        c.close()
    for r in replicas:
        r.kill()


def png(pixels, width, height):
    """Grey, row by row."""
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    rows = b"".join(b"\0" + bytes(pixels[y * width:(y + 1) * width]) for y in range(height))
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)) +
            chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))


def picture(seed, turn, width=480, height=360):
    """A flat-shaded box of calls.box(seed), seen from above its corner, turned about the upright."""
    thing = box(seed)
    corners = [thing.vertices_m[3 * i:3 * i + 3] for i in range(8)]
    middle = [sum(c[k] for c in corners) / 8 for k in range(3)]
    tilt, far, focal = 0.9, 4.0 * thing.diameter_m, 1.5 * width
    seen = []
    for c in corners:
        x, y, z = (c[k] - middle[k] for k in range(3))
        x, y = math.cos(turn) * x - math.sin(turn) * y, math.sin(turn) * x + math.cos(turn) * y
        y, z = math.cos(tilt) * y - math.sin(tilt) * z, math.sin(tilt) * y + math.cos(tilt) * z
        seen.append((width / 2 + focal * x / (z + far), height / 2 + focal * y / (z + far), z + far))
    pixels = bytearray(b"\x60" * (width * height))
    for number, side in sorted(enumerate(SIDES), key=lambda s: -sum(seen[i][2] for i in s[1])):
        inside = [(seen[side[i]], seen[side[(i + 1) % 4]]) for i in range(4)]
        for y in range(height):
            crossings = sorted(a[0] + (y - a[1]) * (b[0] - a[0]) / (b[1] - a[1])
                               for a, b in inside if (a[1] <= y) != (b[1] <= y))
            if len(crossings) == 2:
                left, right = (min(max(int(c + 0.5), 0), width) for c in crossings)
                pixels[y * width + left:y * width + right] = bytes([110 + 24 * number]) * (right - left)
    return png(pixels, width, height)


def scene_of(images, candidates=()):
    request = recognition_pb2.RecognizeSceneRequest(candidate_objects=["objects/" + c for c in candidates])
    for image in images:
        request.images.add(content=image)
    return request


def check_eight(cluster):
    """Write acknowledged -> published by eight replicas."""
    replicas, calls = more_replicas(cluster, 5, "eight")
    everybody, lags = cluster.direct + calls, []
    try:
        for i in range(6 if QUICK else 100):
            made = everybody[i % 8].create("eight%d" % i, 5000 + i)
            acknowledged = time.monotonic()
            for c in everybody:
                await_true("generation %d" % made.revision, lambda c=c: c.generation() >= made.revision, 60, 0.005)
            lags.append(time.monotonic() - acknowledged)
    finally:
        end(replicas, calls)
    return "write acknowledged to searchable on 8 replicas: p50 %.0f ms, p99 %.0f ms (%d writes)" % (
        1e3 * quantile(lags, 0.5), 1e3 * quantile(lags, 0.99), len(lags)), quantile(lags, 0.99) <= 2.0 or QUICK


def copied_digest(database, template, name):
    """What object_digest holds of an object that is the template under another name (db/object_digest.h)."""
    def rows(what):
        return [line.split("|") for line in database.sql(what % template).splitlines()]

    def number(text):
        return struct.pack("<d", float(text) + 0.0)

    def size(count):
        return struct.pack("<Q", count)
    text = number(rows("SELECT diameter_m FROM object WHERE object_id = '%s'")[0][0])
    vertices = rows("SELECT x, y, z FROM vertex WHERE object_id = '%s' ORDER BY idx")
    text += size(len(vertices)) + b"".join(number(v) for row in vertices for v in row)
    edges = rows("SELECT kind, start_vertex, end_vertex, dihedral_rad, encode(polyline, 'hex') FROM edge WHERE object_id = '%s' ORDER BY idx")
    text += size(len(edges))
    for kind, start, stop, dihedral, line in edges:
        blob = bytes.fromhex(line)
        text += struct.pack("<qqq", int(kind), int(start), int(stop)) + number(dihedral) + size(len(blob)) + blob
    mesh = bytes.fromhex(rows("SELECT encode(data, 'hex') FROM mesh WHERE object_id = '%s'")[0][0])
    text += size(len(mesh)) + mesh
    turns = rows("SELECT r11, r12, r13, r21, r22, r23, r31, r32, r33, tx, ty, tz FROM symmetry WHERE object_id = '%s' ORDER BY idx")
    text += size(len(turns)) + b"".join(number(v) for row in turns for v in row) + size(0)  # no grasps
    return [hashlib.sha256(b"HDIG" + struct.pack("<I", 1) + size(len(n)) + n.encode() + text).hexdigest() for n in name]


TABLES = {"vertex": "idx, x, y, z", "edge": "idx, kind, start_vertex, end_vertex, dihedral_rad, polyline", "mesh": "data",
          "symmetry": "idx, r11, r12, r13, r21, r22, r23, r31, r32, r33, tx, ty, tz", "derived": "version, address, data",
          "derived_keys": "version, data"}


def write_copies(database, template, names):
    """All of them in one transaction, each a write of its own number. Preparing each would take a second."""
    lines = ["BEGIN;", "CREATE TEMP TABLE copies (n BIGINT, id TEXT, sha256 TEXT);"]
    for n, (name, digest) in enumerate(zip(names, copied_digest(database, template, names))):
        lines.append("INSERT INTO copies VALUES (%d, '%s', '%s');" % (n + 1, name, digest))
    lines.append("INSERT INTO object SELECT id, display_name, diameter_m, create_time, update_time, vertex_count, edge_count, triangle_count, "
                 "(SELECT generation FROM catalog_state) + n, changed_by FROM object, copies WHERE object_id = '%s';" % template)
    for table, columns in TABLES.items():
        lines.append("INSERT INTO %s (object_id, %s) SELECT id, %s FROM %s, copies WHERE object_id = '%s';" % (
            table, columns, columns, table, template))
    lines += ["INSERT INTO object_digest SELECT id, sha256 FROM copies;", "UPDATE catalog_state SET generation = generation + %d;" % len(names),
              "COMMIT;"]
    path = database.data + ".sql"
    with open(path, "w") as script:
        script.write("\n".join(lines))
    os.chmod(path, 0o644)
    database.script(path)


def check_burst(cluster):
    """10,000 objects in one transaction; two replicas stand still meanwhile, as if they were away for days; one of them had all in memory."""
    own = machines.Postgres(cluster.folder, "burst")
    cluster.others.append(own)
    count = 500 if QUICK else 10_000

    def start(name, *more):
        replica = machines.Replica(cluster.replicas[0].program, cluster.folder, name, own.address(), more=["--max-objects", "20000", *more])
        cluster.others.append(replica)
        replica.start()
        calls = Calls(replica.target)
        await_true(name + " serves", calls.serves, 90)
        return replica, calls
    first, calls = start("template")
    calls.create("template0", 0)
    calls.create("template1", 1, thing=cube())  # with little derived data: the disk is others', too
    size = float(own.sql("SELECT avg(length(d.data) + length(k.data)) FROM derived d JOIN derived_keys k USING (object_id, version) "
                         "WHERE object_id = 'template1'"))
    end([first], [calls])
    # Larger than what is held in memory, as a catalog of so many is.
    replicas, everybody = zip(*[start("burst%d" % i, "--max-resident", "400" if i == 3 else "1") for i in range(4)])
    before = everybody[0].generation()
    for late in replicas[2:]:
        late.process.send_signal(signal.SIGSTOP)
    began = time.monotonic()
    names = ["burst%05d" % i for i in range(count)]
    write_copies(own, "template1", names)
    wrote = time.monotonic()
    for c in everybody[:2]:
        await_true("all are there", lambda c=c: c.info(timeout=60).catalog_generation >= before + count, 300, 0.02)
    searchable = time.monotonic() - wrote
    caught_up, answers = [], []
    for late, c in zip(replicas[2:], everybody[2:]):
        late.process.send_signal(signal.SIGCONT)
        back = time.monotonic()
        await_true("the late one has all", lambda c=c: c.info(timeout=60).catalog_generation >= before + count, 300, 0.02)
        caught_up.append(time.monotonic() - back)
        answers += [c.scene(grey_image(), name)[0].catalog_generation for name in (names[0], names[-1])]
    infos = [c.info() for c in everybody]
    memory = max(machines.memory_mb(r.process.pid) for r in replicas)
    end(replicas, everybody)
    own.kill()
    return "%d objects with %.0f kB of derived data each in one burst, written in %.1f s: all searchable on two replicas %.1f s later; a third, which " \
        "stood still meanwhile, had them %.1f s after it went on, a fourth, which held all in memory until then, %.1f s; unusable %d, pending %d, at most " \
        "%.0f MB of memory" % (
            count, size / 1e3, wrote - began, searchable, *caught_up, sum(i.unusable_object_count for i in infos),
            sum(i.pending_object_count for i in infos), memory), \
        all(i.object_count == count + 2 and i.unusable_object_count == 0 and i.pending_object_count == 0 for i in infos) and \
        answers == [before + count] * 4


def check_nginx(cluster):
    """nginx in front: calls reach all replicas; one is killed, and the calls that begin then are answered by the others."""
    cluster.await_generation(cluster.front.create("nginx-target", 1).revision)
    proxy = machines.Nginx(cluster.folder, cluster.replicas)
    cluster.others.append(proxy)
    prometheus = machines.Prometheus(cluster.folder, {"horopter": [r.metrics for r in cluster.replicas]})
    cluster.others.append(prometheus)
    calls = Calls(proxy.target)
    await_true("nginx serves", calls.serves, 20)
    image = grey_image()

    def served():
        return prometheus.ask('horopter_requests_total{method="GetObject",code="OK"}')
    await_true("Prometheus has scraped", lambda: len(prometheus.ask("up == 1")) == 3, 60)
    before = served()
    for _ in range(90):
        calls.get("nginx-target")
    time.sleep(2.5)
    after = served()
    shares = sorted(int(v - before.get(i, 0)) for i, v in after.items())
    for _ in range(3):
        calls.scene(image, "nginx-target")
    cluster.replicas[0].kill()
    failed = []
    for _ in range(60):
        try:
            calls.get("nginx-target")
        except grpc.RpcError as error:
            failed.append("%s %s" % (error.code(), error.details()))
    cluster.replicas[0].start()
    cluster.await_all()
    proxy.stop()
    prometheus.stop()
    calls.close()
    return "nginx: 90 calls were answered by %s; of 60 begun after one replica was killed %d failed %s" % (shares, len(failed), failed[:1]), \
        len(shares) == 3 and shares[0] >= 15 and sum(shares) == 90 and not failed


def check_age(cluster):
    """Connections that are asked to end every second, under load: no call fails, and clients connect anew."""
    replicas, direct = more_replicas(cluster, 1, "aged", more=["--max-connection-age-seconds", "1"])
    target = cluster.front.create("age-target", 1)
    await_true("it follows", lambda: direct[0].generation() >= target.revision, 20)
    calls, failed, done, ends = Calls(replicas[0].target), [], 0, []
    calls.channel.subscribe(lambda state: ends.append(state) if state == grpc.ChannelConnectivity.IDLE else None)
    image, until = grey_image(), time.monotonic() + (4 if QUICK else 20)
    while time.monotonic() < until:
        try:
            calls.get("age-target") if done % 5 else calls.scene(image, "age-target")
            done += 1
        except grpc.RpcError as error:
            failed.append("%s %s" % (error.code(), error.details()))
    again = len(ends)
    calls.close()
    end(replicas, direct)
    return "connections of a second's age: %d calls, %d failed %s, %d times connected anew" % (done, len(failed), failed[:1], again), \
        not failed and again >= 2


def check_prometheus(cluster):
    """Prometheus scrapes the replicas and HAProxy; what docs/cluster.md says to watch is there, and no alert is wrong at rest."""
    targets = {"horopter": [r.metrics for r in cluster.replicas], "haproxy": [cluster.proxy.stats]}
    prometheus = machines.Prometheus(cluster.folder, targets)
    cluster.others.append(prometheus)
    made = cluster.front.create("prometheus-target", 1)
    cluster.await_generation(made.revision)
    await_true("all are scraped", lambda: len(prometheus.ask("up == 1")) == 4, 60)
    await_true("generations are the same", lambda: set(prometheus.ask("horopter_catalog_generation").values()) == {float(made.revision)}, 20)
    behind = max(prometheus.ask("horopter_catalog_behind_seconds").values())
    queue = prometheus.ask('haproxy_backend_current_queue{proxy="scenes"}')
    alerts = prometheus.ask('ALERTS{alertstate="firing"}')
    prometheus.stop()
    return "Prometheus: 4 of 4 scraped, generation %d on all 3, behind by %.1f s at most, queue of scenes %s, alerts %d" % (
        made.revision, behind, [int(v) for v in queue.values()], len(alerts)), behind < 10 and len(queue) == 1 and not alerts


def check_credentials(cluster):
    """The password of the database changes: who is connected goes on, and connects anew with the new one without a restart."""
    database, passfile = cluster.database, os.path.join(cluster.folder, "pgpass")
    hba = os.path.join(database.data, "pg_hba.conf")
    with open(hba) as f:
        rules = f.read()
    with open(hba, "w") as f:
        f.write("host all rotated 127.0.0.1/32 scram-sha-256\n" + rules)

    def give(password):
        with open(os.open(passfile, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "w") as f:
            f.write("*:*:*:rotated:%s\n" % password)
    database.sql("CREATE ROLE rotated LOGIN SUPERUSER PASSWORD 'first'")
    database.sql("SELECT pg_reload_conf()")
    give("first")
    apart = machines.Replica(cluster.replicas[0].program, cluster.folder, "rotated",
                             "postgresql://rotated@127.0.0.1:%d/postgres?passfile=%s" % (database.port, passfile))
    cluster.others.append(apart)
    apart.start()
    calls = Calls(apart.target)
    await_true("it serves", calls.serves, 60)
    target = cluster.front.create("credentials-target", 1)
    await_true("it follows", lambda: calls.generation() >= target.revision, 20)
    database.sql("ALTER ROLE rotated PASSWORD 'second'")
    database.sql("SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE usename = 'rotated'")
    missed = cluster.front.create("credentials-new", 2)
    time.sleep(1.5)
    calls.scene(grey_image(), "credentials-target")  # goes on with what it has
    stays = calls.generation() < missed.revision
    give("second")
    began = time.monotonic()
    await_true("it follows again", lambda: calls.generation() >= missed.revision, 30)
    took = time.monotonic() - began
    said = "password authentication failed" in cluster.log_of(apart)
    secret = any(w in cluster.log_of(apart) for w in ("first", "second'"))
    calls.close()
    apart.kill()
    return "password changed: answers go on without it, %s; followed %.1f s after the new passfile; said in the log: %s, the password: %s" % (
        "the catalog stays" if stays else "THE CATALOG FOLLOWED", took, said, secret), stays and said and not secret


def check_clock(cluster):
    """Replicas whose clocks are an hour ahead and three days behind write and follow as the others do."""
    if not os.path.exists(FAKETIME):
        return "left out: libfaketime is not installed", True
    replicas, calls = [], []
    for name, skew in (("ahead", "+3600"), ("behind", "-259200")):
        environment = {"LD_PRELOAD": FAKETIME, "FAKETIME": skew, "FAKETIME_DONT_FAKE_MONOTONIC": "1", "DONT_FAKE_MONOTONIC": "1"}
        some, its = more_replicas(cluster, 1, name, environment=environment)
        replicas += some
        calls += its
    everybody, lags, wrong = cluster.direct + calls, [], 0
    last = 0
    for i in range(6 if QUICK else 40):
        writer = everybody[(3 + i) % 5]
        name = "clock%d" % (i // 2)
        request_id = "clock-%d" % (i // 2)
        made = writer.create(name, 7000 + i // 2, request_id=request_id)  # every second one is a repetition by another
        wrong += made.revision < last
        last = max(last, made.revision)
        began = time.monotonic()
        for c in everybody:
            await_true("generation %d" % made.revision, lambda c=c: c.generation() >= made.revision, 20, 0.005)
        lags.append(time.monotonic() - began)
    ages = []
    for c in calls:
        _, call = c.scene(grey_image(), "clock0")
        ages.append(int(dict(call.trailing_metadata())["horopter-catalog-age-ms"]))
    skews = [int(c.info().start_time.seconds - time.time()) for c in calls]
    end(replicas, calls)
    return "clocks off by %s s: %d writes, half of them repeated by another, searchable on all 5 within %.0f ms, generations that went " \
        "back %d, age of the catalog in answers at most %d ms" % (skews, len(lags), 1e3 * max(lags), wrong, max(ages)), \
        wrong == 0 and max(lags) < 5 and 0 <= max(ages) < 5000 and skews[0] > 3000 and skews[1] < -250_000


def check_tenants(cluster):
    """Two catalogs in one database, with the same ids: each server has its own."""
    cluster.database.sql("CREATE SCHEMA plant7")
    cluster.front.create("tenant-same", 1)
    other = machines.Replica(cluster.replicas[0].program, cluster.folder, "plant7",
                             cluster.database.address() + "?options=-csearch_path%3Dplant7")
    cluster.others.append(other)
    other.start()
    calls = Calls(other.target)
    await_true("it serves", calls.serves, 60)
    empty = calls.info().object_count
    calls.create("tenant-same", 2)
    names = [c.get("tenant-same").display_name for c in (cluster.direct[0], calls)]
    cluster.front.delete("tenant-same")
    kept = calls.get("tenant-same").display_name
    calls.close()
    other.kill()
    return "two catalogs with one id: %s; after one was removed the other is %r" % (names, kept), \
        empty == 0 and names == ["box 1", "box 2"] and kept == "box 2"


def check_overhead(cluster):
    """CPU seconds of servers and balancer for a set of images, of four replicas against one."""
    own = machines.Postgres(cluster.folder, "overhead")
    cluster.others.append(own)
    replicas, calls = more_replicas(cluster, 4, "of-four", own)
    newest = max(calls[0].create("part%d" % i, i).revision for i in range(8))
    for c in calls:
        await_true("it follows", lambda c=c: c.generation() >= newest, 60)
    requests = [scene_of([picture(seed, turn) for turn in (0.4, 0.9, 1.5)]) for seed in range(4)]
    for c in calls:
        for request in requests:
            c.recognition.RecognizeScene(request, timeout=300)

    def spent(some, ends, sets):
        before = sum(r.cpu_seconds() for r in some)
        for i in range(sets):
            ends[i % len(ends)].recognition.RecognizeScene(requests[i // len(ends) % 4], timeout=300)
        return sum(r.cpu_seconds() for r in some) - before
    # In turns, so that what else the machine does falls on both; a multiple of 16 has each image on each replica.
    sets, rounds, one, four = 16, 1 if QUICK else 3, 0.0, 0.0
    for _ in range(rounds):
        one += spent(replicas[:1], calls[:1], sets)
        four += spent(replicas, calls, sets)
    front = machines.Haproxy(cluster.folder, replicas[:3])
    through = Calls(front.target)
    await_true("HAProxy serves", through.serves, 20)
    before = machines.cpu_seconds(front.process.pid)
    for i in range(sets):
        through.recognition.RecognizeScene(requests[i % 4], timeout=300)
    proxy = (machines.cpu_seconds(front.process.pid) - before) / sets
    through.close()
    front.stop()
    end(replicas, calls)
    own.kill()
    one, four = one / sets / rounds, four / sets / rounds + proxy
    return "CPU seconds a set of 3 images: one replica alone %.3f; four, of which three idle in turn, and HAProxy (%.4f) %.3f: %+.1f %% " \
        "(%d sets each)" % (one, proxy, four, 100 * (four / one - 1), sets * rounds), four <= 1.05 * one or QUICK


def check_rankers(cluster):
    """Two rankers and a server that asks them; one is killed and comes back."""
    program, folder, address = cluster.replicas[0].program, cluster.folder, cluster.database.address()
    made = max(cluster.front.create("ranked%d" % i, 100 + i).revision for i in range(12))
    rankers = [machines.Replica(program, folder, "ranker%d" % n, address, more=["--role", "ranker", "--shard", "%d/2" % n]) for n in (1, 2)]
    server = machines.Replica(program, folder, "asks-rankers", address, more=[
        "--rank-above", "10", "--ranker-seconds", "20", "--rankers", ",".join(r.target for r in rankers)])
    everybody = [*rankers, server]
    calls = serving(cluster, everybody)
    for c in calls:
        await_true("it follows", lambda c=c: c.generation() >= made, 20)
    asked, image = calls[2].recognition, [picture(103, turn) for turn in (0.4, 0.9, 1.5)]

    def ranking(answer):
        stage = [s for s in answer.stages if s.stage == "ranking"]
        return (dict(stage[0].counts) if stage else None), [
            u.step for u in answer.unsearched if u.cause == recognition_pb2.UnsearchedStep.CAUSE_UNAVAILABLE]
    whole, lost_before = ranking(asked.RecognizeScene(scene_of(image), timeout=300))
    named, _ = ranking(asked.RecognizeScene(scene_of(image, ["ranked3"]), timeout=300))
    rankers[1].kill()
    failed, lost = 0, []
    for _ in range(2 if QUICK else 20):
        try:
            _, steps = ranking(asked.RecognizeScene(scene_of(image), timeout=300))
            lost.append(steps)
        except grpc.RpcError:
            failed += 1
    rankers[1].start()
    await_true("the ranker serves", calls[1].serves, 60)
    again = ["?"]
    until = time.monotonic() + 30
    while again and time.monotonic() < until:
        _, again = ranking(asked.RecognizeScene(scene_of(image), timeout=300))
    refused = None
    try:
        calls[0].recognition.RecognizeScene(scene_of(image), timeout=60)
    except grpc.RpcError as error:
        refused = error.code()
    end(everybody, calls)
    return "rankers: 2 listed %d parts; with one killed %d of %d calls failed, %d answers name it; back: %s; candidates ask none: %s; a " \
        "ranker that is asked for a scene: %s" % (whole["parts_listed"] if whole else -1, failed, len(lost) + failed, lost.count(["ranker 2 of 2"]),
                                                  again or "none lost", named is None, refused.name if refused else "ANSWERED"), \
        bool(whole) and whole["rankers_lost"] == 0 and whole["parts_listed"] > 0 and not lost_before and named is None and failed == 0 and \
        all(s == ["ranker 2 of 2"] for s in lost) and not again and refused == grpc.StatusCode.FAILED_PRECONDITION


def recognised(calls, names):
    """Those of the names that a scene may ask for: a name that is not in what is served is NOT_FOUND."""
    found = set()
    for name in names:
        try:
            calls.scene(grey_image(), name)
            found.add(name)
        except grpc.RpcError as error:
            if error.code() != grpc.StatusCode.NOT_FOUND:
                raise
    return found


class Scenes:
    """Scenes of one part, of each replica in turn, until it is ended."""

    def __init__(self, everybody, name):
        self.done, self.failed, self.ended = 0, [], False
        self.thread = threading.Thread(target=self._call, args=(everybody, name))
        self.thread.start()

    def _call(self, everybody, name):
        while not self.ended:
            try:
                everybody[self.done % len(everybody)].scene(grey_image(), name)
            except grpc.RpcError as error:
                self.failed.append("%s %s" % (error.code(), error.details()))
            self.done += 1
            time.sleep(0.05)

    def end(self):
        self.ended = True
        self.thread.join()


def check_restore(cluster):
    """Restored to a moment while replicas run; one of them stands still until as much was written again as was lost."""
    own = machines.Postgres(cluster.folder, "restored", archives=True)
    cluster.others.append(own)
    replicas, everybody = more_replicas(cluster, 4, "restored", own)
    calls, late = everybody[:3], everybody[3]
    first, then, lost = (["%s%d" % (word, i) for i in range(4)] for word in ("first", "then", "lost"))
    for i, name in enumerate(first):
        calls[i % 3].create(name, i)
    backup = own.data + "-base"
    own.back_up(backup)
    for i, name in enumerate(then):
        calls[i % 3].create(name, 10 + i)
    calls[0].delete("first0")
    kept = set(first[1:] + then)
    point, moment = calls[0].generation(), own.sql("SELECT clock_timestamp()")
    for i, name in enumerate(lost):
        calls[i % 3].create(name, 20 + i)
    calls[0].delete("first1")
    calls[1].catalog.UpdateObject(catalog_pb2.UpdateObjectRequest(object=catalog_pb2.Object(
        name="objects/first2", display_name="changed")), timeout=40)
    newest = calls[1].generation()
    for c in everybody:
        await_true("it follows", lambda c=c: c.generation() == newest, 20)
    replicas[3].process.send_signal(signal.SIGSTOP)
    scenes = Scenes(calls, "then0")
    began = time.monotonic()
    try:
        own.restore(backup, moment)
        answers = time.monotonic()
        for c in calls:
            await_true("it has the moment's catalog", lambda c=c: c.generation() == point, 60)
        served = time.monotonic()
    finally:
        scenes.end()
    every = first + then + lost
    exact = [recognised(c, every) == kept and set(c.ids()) == kept and c.info().object_count == len(kept) and
             c.get("first2").display_name == "box 2" for c in calls]
    noticed = "does not follow from what was generation %d here" % newest
    said = sum(r.said(noticed) for r in replicas[:3])
    again = ["again%d" % i for i in range(newest - point)]  # the generation is then what the fourth has
    made = max(calls[i % 3].create(name, 30 + i).revision for i, name in enumerate(again))
    for c in calls:
        await_true("it follows", lambda c=c: c.generation() >= made, 20)
    found, wanted = [recognised(c, again) == set(again) for c in calls], kept | set(again)
    before = len(set(first[2:] + then + lost) ^ wanted)
    replicas[3].process.send_signal(signal.SIGCONT)
    went_on = time.monotonic()
    await_true("the late one notices", lambda: replicas[3].said(noticed), 60)
    await_true("it has loaded all", lambda: late.info().object_count == len(wanted) and recognised(late, wanted) == wanted, 60)
    late_s = time.monotonic() - went_on
    differs = len(recognised(late, every + again) ^ wanted)
    last = calls[0].create("last", 60).revision
    await_true("it follows", lambda: late.generation() >= last, 20)
    end(replicas, everybody)
    own.kill()
    return "restored to a moment, generation %d to %d: all 3 replicas serve exactly its %d objects: %s, %.2f s after the database answers (%.1f s " \
        "after it was stopped), %d say so in the log; %d scenes meanwhile, %d failed %s; %d writes after it searchable: %s; a fourth, still " \
        "until its generation came again, of %d objects that differed then differs in %d %.1f s after it goes on" % (
            newest, point, len(kept), exact, served - answers, served - began, said, scenes.done, len(scenes.failed), scenes.failed[:1],
            len(again), found, before, differs, late_s), \
        all(exact) and said == 3 and scenes.done > 0 and not scenes.failed and all(found) and made == newest and before > 0 and differs == 0


CHECKS = {"eight": check_eight, "nginx": check_nginx, "age": check_age, "prometheus": check_prometheus, "credentials": check_credentials,
          "clock": check_clock, "tenants": check_tenants, "overhead": check_overhead, "rankers": check_rankers, "restore": check_restore,
          "burst": check_burst}
