#!/usr/bin/env python3
"""What watchers cost recognition: the same request again and again, in turn without and with clients that watch each answer with its
pictures. Prints for both the median and the 99th percentile of the times, and the server's processor time a request; then the ratios of
the two, and of the medians of rounds that follow each other. Times say nothing on a machine that has other work, which is said.

    watch_report.py HOROPTERD PACKAGE_FOLDER SOURCES [--watchers N] [--rounds N] [--requests N]
"""
import argparse
import os
import subprocess
import sys
import tempfile
import time

arguments = argparse.ArgumentParser()
arguments.add_argument("horopterd")
arguments.add_argument("package")
arguments.add_argument("sources")
arguments.add_argument("--watchers", type=int, default=100)
arguments.add_argument("--rounds", type=int, default=4, help="of each kind")
arguments.add_argument("--requests", type=int, default=5, help="in a round")
arguments.add_argument("--parts", type=int, nargs="*", default=[1, 2, 3])
arguments.add_argument("--watch", help=argparse.SUPPRESS)  # the address: this process only watches
options = arguments.parse_args()
sys.path.insert(0, os.path.abspath(options.package))
sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "support"))

import grpc  # noqa: E402

import horopter  # noqa: E402
from horopter.v1 import answers_pb2, answers_pb2_grpc  # noqa: E402
from mock_server import Mock  # noqa: E402


def watch(address):
    """Watches with as many streams as one connection has, in a process of its own; says when all have begun."""
    import threading
    begun = threading.Semaphore(0)
    stubs = [answers_pb2_grpc.AnswerServiceStub(grpc.insecure_channel(address, options=[("grpc.use_local_subchannel_pool", 1)])) for _ in range(4)]

    def one(stub):
        for answer in stub.WatchAnswers(answers_pb2.WatchAnswersRequest(previews=True)):
            if answer.number == 0:
                begun.release()

    for i in range(options.watchers):
        threading.Thread(target=one, args=(stubs[i % len(stubs)],), daemon=True).start()
    for _ in range(options.watchers):
        begun.acquire()
    print("watching", flush=True)
    sys.stdin.read()
    os._exit(0)


def processor_seconds(pid):
    with open("/proc/%d/stat" % pid, encoding="utf-8") as file:
        fields = file.read().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def percentile(values, share):
    values = sorted(values)
    return values[min(len(values) - 1, int(share * len(values)))]


def main():
    data = os.path.join(options.sources, "tests", "data", "parts")
    images = [os.path.join(data, "val", "000011", "rgb", "%06d.png" % i) for i in range(4)]
    with tempfile.TemporaryDirectory() as folder, Mock(options.horopterd, "--db", os.path.join(folder, "parts.db"), "--listen",
                                                       "localhost:0") as server, horopter.Client(server.address, deadline_s=600) as client:
        for number in options.parts:
            client.import_object("part-%d" % number, os.path.join(data, "cad", "obj_%06d.step" % number))
        client.recognize(images)
        times, spent = {False: [], True: []}, {False: 0.0, True: 0.0}
        rounds = {False: [], True: []}  # median of each
        busy = os.getloadavg()[0]
        for turn in range(2 * options.rounds):
            watched = turn % 2 == 1
            watcher = None
            if watched:
                watcher = subprocess.Popen([sys.executable, __file__, options.horopterd, options.package, options.sources, "--watchers",
                                            str(options.watchers), "--watch", server.address], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
                assert watcher.stdout.readline() == b"watching\n"
            before = processor_seconds(server.process.pid)
            for _ in range(options.requests):
                began = time.monotonic()
                client.recognize(images)
                times[watched].append(time.monotonic() - began)
            rounds[watched].append(percentile(times[watched][-options.requests:], 0.5))
            busy = max(busy, os.getloadavg()[0])
            if watcher:
                time.sleep(1.0)  # the last answer reaches all of them, and counts
            spent[watched] += processor_seconds(server.process.pid) - before
            if watcher:
                watcher.communicate(b"")
        for watched in (False, True):
            count = len(times[watched])
            print("%-12s %3d requests, median %.2f s, 99th percentile %.2f s, %.2f processor seconds a request" % (
                "%d watching" % options.watchers if watched else "nobody", count, percentile(times[watched], 0.5),
                percentile(times[watched], 0.99), spent[watched] / count))
        with_without = [percentile(times[True], share) / percentile(times[False], share) for share in (0.5, 0.99)]
        paired = percentile([w / n for n, w in zip(rounds[False], rounds[True])], 0.5)
        print("watched / nobody: median %.3f, 99th percentile %.3f, medians of neighbouring rounds %.3f, processor time %.3f" % (
            *with_without, paired, spent[True] / spent[False]))
        if busy > os.cpu_count() + 1.5:
            print("the machine had other work (load %.1f on %d cores): of these only the processor time means something" % (
                busy, os.cpu_count()))


if __name__ == "__main__":
    if options.watch:
        watch(options.watch)
    else:
        main()
