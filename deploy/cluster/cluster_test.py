#!/usr/bin/python3
"""What docs/cluster.md promises, on one machine; see test.sh.

    cluster_test.py HOROPTERD PACKAGE_FOLDER [--quick] [CHECK ...]
"""
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time

HOROPTERD, PACKAGE = os.path.abspath(sys.argv[1]), os.path.abspath(sys.argv[2])
sys.path.insert(0, PACKAGE)
sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))

import grpc  # noqa: E402

import machines  # noqa: E402
import replica as operations  # noqa: E402
import wider_checks  # noqa: E402
from calls import EDGES, Calls, grey_image, quantile  # noqa: E402
from horopter.v1 import catalog_pb2, recognition_pb2  # noqa: E402
from machines import await_true  # noqa: E402

QUICK = "--quick" in sys.argv


class Cluster:
    """A database, three replicas of it, HAProxy before them."""

    def __init__(self):
        self.folder = tempfile.mkdtemp(prefix="horopter-cluster-")
        os.chmod(self.folder, 0o755)
        self.database = machines.Postgres(self.folder, "primary")
        self.replicas = [machines.Replica(HOROPTERD, self.folder, "replica%d" % (i + 1), self.database.address()) for i in range(3)]
        self.proxy = machines.Haproxy(self.folder, self.replicas)
        self.others = []
        for r in self.replicas:
            r.start()
        self.direct = [Calls(r.target) for r in self.replicas]
        self.front = Calls(self.proxy.target)
        self.await_all()

    def await_all(self):
        for r, calls in zip(self.replicas, self.direct):
            await_true(r.name + " serves", calls.serves, 90)
        await_true("all are in turn", lambda: all(r["status"].startswith("UP") for r in operations.servers(self.proxy.socket)))

    def await_generation(self, generation):
        for calls in self.direct:
            await_true("generation %d" % generation, lambda c=calls: c.generation() >= generation, 20)

    def log_of(self, replica):
        with open(replica.log) as log:
            return log.read()

    def end(self):
        for thing in self.replicas + self.others:
            thing.kill()
        self.proxy.stop()
        self.database.kill()
        shutil.rmtree(self.folder, ignore_errors=True)


def prepared_again(cluster):
    return sum(cluster.log_of(r).count("prepared again") for r in cluster.replicas)


def check_searchable(cluster):
    """Write acknowledged -> published by all three."""
    lags, before = [], prepared_again(cluster)
    for i in range(8 if QUICK else 200):
        made = cluster.direct[i % 3].create("s%d" % i, i)
        acknowledged = time.monotonic()
        for calls in cluster.direct:
            await_true("generation %d" % made.revision, lambda c=calls: c.generation() >= made.revision, 60, 0.005)
        lags.append(time.monotonic() - acknowledged)
    state = cluster.direct[0].get("s0").recognition_status.state
    assert state == catalog_pb2.RecognitionStatus.STATE_READY, state
    prepared = prepared_again(cluster) - before
    return "write acknowledged to searchable on 3 replicas: p50 %.0f ms, p99 %.0f ms (%d writes); prepared a second time: %d" % (
        1e3 * quantile(lags, 0.5), 1e3 * quantile(lags, 0.99), len(lags), prepared), \
        prepared == 0 and (QUICK or quantile(lags, 0.99) <= 2.0)


class Load:
    """Calls of several robots through the front until it is ended."""

    def __init__(self, cluster, callers=4, made="load"):
        self.made = made
        self.failed, self.done, self.acknowledged, self.ended = [], 0, [], False
        self.cluster = cluster
        self.lock = threading.Lock()
        self.threads = [threading.Thread(target=self._call, args=(i,)) for i in range(callers)]
        for t in self.threads:
            t.start()

    def _call(self, number):
        calls, image, i = Calls(self.cluster.proxy.target), grey_image(), 0
        while not self.ended:
            try:
                if number == 0:
                    name = "%s%d" % (self.made, i)
                    calls.create(name, i)
                    self.acknowledged.append(name)
                elif number == 1:
                    calls.scene(image, "load-target")
                else:
                    calls.get("load-target")
                with self.lock:
                    self.done += 1
            except grpc.RpcError as error:
                with self.lock:
                    self.failed.append("%s %s" % (error.code(), error.details()))
            i += 1
            time.sleep(0.02)
        calls.close()

    def end(self):
        self.ended = True
        for t in self.threads:
            t.join()


def await_load_target(cluster):
    """What the load asks for is known to all replicas."""
    try:
        cluster.await_generation(cluster.front.create("load-target", 1).revision)
    except grpc.RpcError as error:
        if error.code() != grpc.StatusCode.ALREADY_EXISTS:  # by an earlier check
            raise


def check_rolling(cluster):
    """Restart of all three, one after the other, under load."""
    await_load_target(cluster)
    load = Load(cluster)
    try:
        for number in range(3):
            restart_under_load(cluster, number)
    finally:
        load.end()
    return "rolling restart of 3 replicas: %d calls, %d failed %s" % (load.done, len(load.failed), load.failed[:3]), \
        load.done > 20 and not load.failed


NEWER_SCHEMA = """BEGIN;
CREATE TABLE of_the_next_version (object_id TEXT COLLATE "C" PRIMARY KEY REFERENCES object ON DELETE CASCADE, note TEXT NOT NULL);
ALTER TABLE object ADD COLUMN of_the_next_version TEXT NOT NULL DEFAULT '';
UPDATE catalog_schema SET version = version + 1, usable_from = version;
COMMIT"""


def restart_under_load(cluster, number):
    replica = cluster.replicas[number]
    operations.drain(cluster.proxy.socket, replica.name, 60)
    replica.stop()
    replica.start()
    await_true(replica.name + " serves", cluster.direct[number].serves, 90)
    operations.ready(cluster.proxy.socket, replica.name, 60)


def check_upgrade(cluster):
    """A newer version's schema appears under running replicas, first one that they may use, then one that they may not. The newer
    program is SQL here, a table and a column more and the two numbers: no two builds that know different schemas and share one exist yet."""
    database = cluster.database
    await_load_target(cluster)
    knows = int(database.sql("SELECT version FROM catalog_schema"))
    load, stages = Load(cluster, made="upgrade"), []

    def goes_on():
        calls, writes = load.done, len(load.acknowledged)
        await_true("calls and writes go on", lambda: load.done >= calls + 40 and len(load.acknowledged) >= writes + 2, 120)

    try:
        goes_on()
        database.sql(NEWER_SCHEMA)
        goes_on()
        restart_under_load(cluster, 0)  # of the older version, on the newer schema
        goes_on()
        kept = database.sql("SELECT version || ' ' || usable_from FROM catalog_schema")
        stages.append((load.done, len(load.failed)))
        database.sql("UPDATE catalog_schema SET usable_from = version")
        goes_on()
        refused = cluster.replicas[0]
        operations.drain(cluster.proxy.socket, refused.name, 60)
        refused.stop()
        refused.start()
        code = refused.process.wait(60)
        goes_on()
        stages.append((load.done, len(load.failed)))
    finally:
        load.end()
        database.sql("DROP TABLE IF EXISTS of_the_next_version; ALTER TABLE object DROP COLUMN IF EXISTS of_the_next_version; "
                     "UPDATE catalog_schema SET version = %d, usable_from = %d" % (knows, knows))
    words = "has schema version %d, this program knows up to %d; use a newer horopterd" % (knows + 1, knows)
    told = refused.said(words)
    refused.start()
    await_true("it serves the schema it knows", cluster.direct[0].serves, 90)
    operations.ready(cluster.proxy.socket, refused.name, 60)
    made = load.acknowledged
    there = cluster.front.ids()
    missing = [n for n in made if n not in there]
    return "schema of version %d under replicas that know %d: usable by them, one restarted: %d calls, %d failed; not usable any more: those " \
        "that run go on, a restarted one ends with %d%s, in all %d calls, %d failed %s; %d objects written meanwhile, %d missing" % (
            knows + 1, knows, *stages[0], code, " and the reason" if told else " WITHOUT THE REASON", *stages[-1], load.failed[:2],
            len(made), len(missing)), \
        kept == "%d %d" % (knows + 1, knows) and not load.failed and code != 0 and told and not missing


class History:
    """One writer's model: what must be there, what may be."""

    def __init__(self, cluster, name):
        self.cluster, self.name = cluster, name
        self.there, self.unsure, self.ended = {}, {}, False
        self.acknowledged = 0
        self.thread = threading.Thread(target=self._write)
        self.thread.start()

    def _write(self):
        calls, i, rng = Calls(self.cluster.proxy.target), 0, random.Random(self.name)
        while not self.ended:
            i += 1
            name = "%s-%d" % (self.name, i)
            seed = None if self.there and rng.random() < 0.3 else i
            if seed is None:
                name = rng.choice(sorted(self.there))
            self.unsure[name] = self.there.pop(name, None), seed
            for attempt in range(400):
                try:
                    if seed is None:
                        calls.delete(name)
                    else:
                        calls.create(name, seed, request_id="r-" + name)
                    del self.unsure[name]
                    self.acknowledged += 1
                    if seed is not None:
                        self.there[name] = seed
                    break
                except grpc.RpcError as error:
                    if error.code() not in (grpc.StatusCode.UNAVAILABLE, grpc.StatusCode.DEADLINE_EXCEEDED,
                                            grpc.StatusCode.UNKNOWN, grpc.StatusCode.CANCELLED):
                        self.unsure[name] += ("%s: %s" % (error.code(), error.details()),)
                        break
                    time.sleep(0.1)
        calls.close()

    def end(self):
        self.ended = True
        self.thread.join()


def check_kills(cluster):
    """kill -9 of database and replicas in turn while two clients write; then the history against the model."""
    rng = random.Random(63)
    writers = [History(cluster, "w%d" % i) for i in range(2)]
    backwards, watching = [], [True]

    def watch(index):
        last, process = 0, None
        while watching[0]:
            try:
                now = cluster.direct[index].generation()
                if cluster.replicas[index].process is process and now < last:
                    backwards.append((index, last, now))
                last, process = now, cluster.replicas[index].process
            except grpc.RpcError:
                last, process = 0, None
            time.sleep(0.02)
    watchers = [threading.Thread(target=watch, args=(i,)) for i in range(3)]
    for w in watchers:
        w.start()
    rounds = 6 if QUICK else 200
    try:
        for k in range(rounds):
            # Something was written since the last one; then anywhere in the next write.
            before = sum(w.acknowledged for w in writers)
            await_true("a write", lambda b=before: sum(w.acknowledged for w in writers) > b, 120)
            time.sleep(rng.uniform(0.0, 0.6))
            victim = k % 4
            if victim == 3:
                cluster.database.kill()
                cluster.database.start()
            else:
                cluster.replicas[victim].kill()
                cluster.replicas[victim].start()
        cluster.await_all()
        time.sleep(0.5)
    finally:
        for w in writers:
            w.end()
        watching[0] = False
        for w in watchers:
            w.join()
    found, wrong = cluster.front.ids(), []
    for w in writers:
        wrong += ["%s was acknowledged and is missing or another" % n for n, seed in w.there.items() if found.get(n) != "box %d" % seed]
        wrong += ["%s: %s" % (n, state[2]) for n, state in w.unsure.items() if len(state) > 2]
        wrong += ["%s was removed and is there" % n for n in found if n.startswith(w.name + "-") and n not in w.there and n not in w.unsure]
    newest = max(c.generation() for c in cluster.direct)
    for c in cluster.direct:
        await_true("all agree", lambda c=c: c.generation() >= newest and c.info().object_count == len(found), 30)
    for name in rng.sample(sorted(found), min(10, len(found))):
        if len(cluster.front.get(name).edges) not in (0, len(EDGES)):
            wrong.append(name + " is there by half")
    problems = [p for answer in cluster.front.catalog.VerifyCatalog(catalog_pb2.VerifyCatalogRequest(), timeout=300)
                for p in answer.problems]
    wrong += ["verify: %s" % p for p in problems]
    return "%d kill -9: %d writes acknowledged, violations %d, generations that went back %d %s" % (
        rounds, sum(w.acknowledged for w in writers), len(wrong), len(backwards), wrong[:3]), \
        not wrong and not backwards and sum(w.acknowledged for w in writers) >= rounds


def check_gone(cluster):
    """The database is gone: what serves goes on and says how old it is, what starts waits."""
    cluster.await_generation(cluster.front.create("gone-target", 1).revision)
    image = grey_image()
    _, call = cluster.front.scene(image, "gone-target")
    fresh = int(dict(call.trailing_metadata())["horopter-catalog-age-ms"])
    cluster.database.stop()
    time.sleep(1.5)
    _, call = cluster.front.scene(image, "gone-target")
    old = int(dict(call.trailing_metadata())["horopter-catalog-age-ms"])
    refused = None
    try:
        cluster.direct[0].create("gone-new", 2)
    except grpc.RpcError as error:
        refused = error.code()
    last = cluster.replicas[2]
    last.stop()
    last.start()
    await_true("it says so", lambda: last.said("it is tried again every second"))
    await_true("its health is NOT_SERVING", lambda: cluster.direct[2].health() == 2)
    try:
        cluster.direct[2].info(timeout=5)
        waits = "it serves"
    except grpc.RpcError as error:
        waits = error.details() if error.code() == grpc.StatusCode.UNAVAILABLE else str(error.code())
    cluster.database.start()
    began = time.monotonic()
    await_true("it serves", cluster.direct[2].serves, 60)
    served = time.monotonic() - began
    cluster.await_all()
    cluster.direct[0].create("gone-new", 2)
    return "database gone: answers go on, %d ms old before and %d ms after; a write is %s; a start waits (health NOT_SERVING, calls: " \
        "%s) and serves %.1f s after it is back" % (fresh, old, refused.name if refused else "TAKEN", waits, served), \
        fresh < old and old >= 1500 and refused == grpc.StatusCode.UNAVAILABLE and "waits for the database" in waits


def check_poisoned(cluster):
    """Derived data that were damaged are found, prepared anew and stored."""
    cluster.front.create("poisoned", 77)
    before = cluster.database.sql("SELECT md5(data) FROM derived WHERE object_id = 'poisoned'")
    cluster.database.sql("UPDATE derived SET data = overlay(data placing '\\xdeadbeef'::bytea from length(data) / 2) "
                         "WHERE object_id = 'poisoned'")
    target = cluster.replicas[1]
    operations.drain(cluster.proxy.socket, target.name, 60)
    target.stop()
    target.start()
    await_true("it serves", cluster.direct[1].serves, 60)
    operations.ready(cluster.proxy.socket, target.name, 60)
    began = time.monotonic()
    await_true("it is whole again", lambda: cluster.database.sql(
        "SELECT md5(data) FROM derived WHERE object_id = 'poisoned'") == before, 60)
    ready = lambda: cluster.direct[1].get("poisoned").recognition_status.state == catalog_pb2.RecognitionStatus.STATE_READY  # noqa: E731
    await_true("it is used again", ready, 60)
    return "poisoned derived data: the same bytes again %.1f s after the replica served" % (time.monotonic() - began), True


def check_partition(cluster):
    """A replica whose wire to the database is cut serves what it has, says how old that is, and catches up."""
    wire = machines.Wire(cluster.database.port)
    address = "postgresql://horopter@127.0.0.1:%d/postgres?tcp_user_timeout=3000&keepalives_idle=1&keepalives_interval=1" % wire.port
    apart = machines.Replica(HOROPTERD, cluster.folder, "apart", address)
    cluster.others.append(apart)
    apart.start()
    calls = Calls(apart.target)
    await_true("it serves", calls.serves, 60)
    made = cluster.front.create("partition-target", 5)
    await_true("it follows", lambda: calls.generation() >= made.revision, 20)
    wire.cut = True
    time.sleep(1.0)
    made = cluster.front.create("partition-new", 6)
    _, call = calls.scene(grey_image(), "partition-target")
    age = int(dict(call.trailing_metadata())["horopter-catalog-age-ms"])
    asked = None
    try:
        calls.scene(grey_image(), "partition-target", metadata=(("horopter-min-generation", str(made.revision)),))
    except grpc.RpcError as error:
        asked = error.code()
    wire.cut = False
    began = time.monotonic()
    await_true("it catches up", lambda: calls.generation() >= made.revision, 60)
    took = time.monotonic() - began
    calls.scene(grey_image(), "partition-new", metadata=(("horopter-min-generation", str(made.revision)),))
    apart.kill()
    return "partition: answers %d ms old; asked for what it cannot have: %s; caught up %.1f s after it was healed" % (
        age, asked.name if asked else "ANSWERED", took), age >= 900 and asked == grpc.StatusCode.UNAVAILABLE


def check_failover(cluster):
    """The primary is killed, a synchronous standby promoted by hand: no acknowledged write is lost."""
    standby = machines.Postgres(cluster.folder, "standby", follow=cluster.database)
    cluster.database.sql("ALTER SYSTEM SET synchronous_standby_names = '*'")
    cluster.database.sql("SELECT pg_reload_conf()")
    await_true("it is synchronous", lambda: cluster.database.sql("SELECT count(*) FROM pg_stat_replication WHERE sync_state = 'sync'") == "1")
    for r, calls in zip(cluster.replicas, cluster.direct):
        r.stop()
        r.address = cluster.database.address(standby)
        r.start()
    cluster.await_all()
    writer = History(cluster, "f")
    await_true("writes", lambda: writer.acknowledged >= 5, 60)
    cluster.database.kill()
    began = time.monotonic()
    at_kill = writer.acknowledged
    standby.promote()
    await_true("writes go on", lambda: writer.acknowledged > at_kill + 2, 90)
    took = time.monotonic() - began
    writer.end()
    found = cluster.front.ids()
    lost = [n for n, seed in writer.there.items() if found.get(n) != "box %d" % seed]
    cluster.database = standby
    anew = sum(r.said("does not follow from") for r in cluster.replicas)
    return "failover: %d writes acknowledged, %d lost; writes went on %.1f s after the kill; replicas that loaded everything anew: %d" % (
        writer.acknowledged, len(lost), took, anew), not lost and anew == 0


def check_queue(cluster):
    """Scenes beyond workers and queue are refused at once, with a time to come again; the others are answered."""
    made = cluster.front.create("queue-target", 3)
    cluster.await_generation(made.revision)
    calls = Calls(cluster.proxy.target)
    request = recognition_pb2.RecognizeSceneRequest(candidate_objects=["objects/queue-target"])
    request.images.add(content=grey_image())
    for r in cluster.replicas:  # each takes one and gets no further; HAProxy's checks have not failed yet
        r.process.send_signal(signal.SIGSTOP)
    try:
        sent = [calls.recognition.RecognizeScene.future(request, timeout=120) for _ in range(15)]
        await_true("some are refused", lambda: sum(f.done() for f in sent) >= 4, 10)
    finally:
        for r in cluster.replicas:
            r.process.send_signal(signal.SIGCONT)
    answered, refused, other = 0, 0, []
    for future in sent:
        error = future.exception()
        if error is None:
            answered += 1
        elif error.code() == grpc.StatusCode.RESOURCE_EXHAUSTED and "retry-after-ms" in dict(error.trailing_metadata()):
            refused += 1
        else:
            other.append("%s %s" % (error.code(), error.details()))
    cluster.await_all()
    return "3 workers and a queue of 8: of 15 scenes %d answered, %d told to come again, %d otherwise %s" % (
        answered, refused, len(other), other[:2]), answered == 11 and refused == 4


def check_migrate(cluster):
    """The catalog into a file and from there into another schema, while it is served."""
    cluster.front.create("migrated", 8)
    file = os.path.join(cluster.folder, "copy.db")
    cluster.database.sql("CREATE SCHEMA copied")
    copies = [(cluster.database.address(), file), (file, cluster.database.address() + "?options=-csearch_path%3Dcopied")]
    said, began = [], time.monotonic()
    for source, target in copies:
        done = subprocess.run([HOROPTERD, "--db", source, "--copy-catalog-to", target], capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise AssertionError(done.stderr)
        said.append(done.stdout.strip().splitlines()[-1])
    took = time.monotonic() - began
    digests = {line.split()[-1] for line in said}
    objects = int(said[0].split()[0])
    return "migrate: %d objects to a file and back to PostgreSQL in %.1f s, digest %s" % (objects, took, digests), \
        len(digests) == 1 and objects == len(cluster.front.ids())


CHECKS = {"searchable": check_searchable, "rolling": check_rolling, "upgrade": check_upgrade, "queue": check_queue, "poisoned": check_poisoned,
          "migrate": check_migrate, "partition": check_partition, "gone": check_gone, **wider_checks.CHECKS, "kills": check_kills, "failover": check_failover}


def main():
    absent = machines.missing()
    if absent:
        print("cluster test skipped: not installed: " + absent)
        return 77
    names = [a for a in sys.argv[3:] if not a.startswith("--")] or list(CHECKS)
    began, failed = time.monotonic(), []
    cluster = Cluster()
    try:
        print("up in %.1f s: PostgreSQL, 3 replicas, HAProxy" % (time.monotonic() - began), flush=True)
        for name in names:
            start = time.monotonic()
            try:
                figure, kept = CHECKS[name](cluster)
            except Exception as error:  # whatever it is, the others run
                figure, kept = "%s: %s" % (type(error).__name__, error), False
                for r in cluster.replicas:
                    print("--- %s\n%s" % (r.name, cluster.log_of(r)[-1500:]))
            print("%-4s %-10s %s (%.1f s)" % ("ok" if kept else "BAD", name, figure, time.monotonic() - start), flush=True)
            if not kept:
                failed.append(name)
    finally:
        cluster.end()
    print("%d checks, %d failed, %.0f s" % (len(names), len(failed), time.monotonic() - began))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
