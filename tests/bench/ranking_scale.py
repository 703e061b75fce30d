#!/usr/bin/env python3
"""Rankers of very many objects on this machine, asked over the network: docs/cluster.md and ADR 98 have its figures.

    ranking_scale.py PROGRAM CACHE SPLIT COUNT SHARDS DATASET [OTHER_DATASET ...] [--rounds N] [--drawn N] [--pictures N]
                     [--one] [--lose] [--seconds S]
      PROGRAM   build/release/tests/bench/ranking_scale
      CACHE     folder for what is derived of the data sets' parts
      --drawn   N drawn questions about one part each in place of the scenes of SPLIT
      --pictures  of each drawn question: one to three
      --one     also one ranker of all, after the others have ended: what the shards are compared with
      --lose    also with one ranker killed

Prints a line of JSON: bytes an object, resident memory, milliseconds and CPU seconds a question, shown objects that are listed.
"""
import argparse
import json
import os
import socket
import subprocess


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


class Ranker:
    def __init__(self, options, shard, shards):
        self.port, self.said = free_port(), ""
        self.process = subprocess.Popen([options.program, "serve", str(options.count), "%d/%d" % (shard, shards), str(self.port),
                                         options.cache, *options.dataset], stdout=subprocess.PIPE, text=True)

    def await_ready(self):
        if self.said:
            return
        self.said = self.process.stdout.readline().strip()
        if self.process.stdout.readline().strip() != "ready":
            raise SystemExit("a ranker did not start: " + self.said)

    def memory_mb(self):
        with open("/proc/%d/status" % self.process.pid) as status:
            return int(next(line for line in status if line.startswith("VmRSS")).split()[1]) / 1024

    def cpu_seconds(self):
        with open("/proc/%d/stat" % self.process.pid) as stat:
            fields = stat.read().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def kill(self):
        self.process.kill()
        self.process.wait()


def quantile(values, share):
    return sorted(values)[min(len(values) - 1, int(share * len(values)))] if values else None


def ask(options, rankers):
    before = [r.cpu_seconds() for r in rankers if r.process.poll() is None]
    answer = subprocess.run([options.program, "ask", options.dataset[0], options.split, options.cache, str(options.seconds),
                             ",".join("127.0.0.1:%d" % r.port for r in rankers), "--rounds", str(options.rounds), "--drawn",
                             str(options.drawn), "--pictures", str(options.pictures)],
                            stdout=subprocess.PIPE, text=True, check=True)
    out = json.loads(answer.stdout)
    questions = max(1, len(out["ms"]) + out["failed"])
    after = [r.cpu_seconds() for r in rankers if r.process.poll() is None]
    each = [(b - a) / questions for a, b in zip(before, after)]
    out["cpu_s"], out["slowest_cpu_s"] = sum(each), max(each, default=0.0)
    return out


def figures(out):
    return {"questions": len(out["ms"]), "failed": out["failed"], "shown": out["shown"], "right": out["right"], "lost": out["lost"],
            "p50_ms": round(quantile(out["ms"], 0.5)), "p99_ms": round(quantile(out["ms"], 0.99)), "cpu_s": round(out["cpu_s"], 2),
            "slowest_cpu_s": round(out["slowest_cpu_s"], 2), "request_kb": round(out["request_kb"])}


def serve(options, shards):
    rankers = []
    for i in range(shards):  # the first one leaves what it derived in the cache
        rankers.append(Ranker(options, i + 1, shards))
        if i == 0 or i % 2 == 0:
            for r in rankers[-2:]:
                r.await_ready()
    if shards % 2 == 0:
        rankers[-1].await_ready()
    return rankers


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, kind in (("program", str), ("cache", str), ("split", str), ("count", int), ("shards", int)):
        parser.add_argument(name, type=kind)
    parser.add_argument("dataset", nargs="+")
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--drawn", type=int, default=0)
    parser.add_argument("--pictures", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--one", action="store_true")
    parser.add_argument("--lose", action="store_true")
    options = parser.parse_args()
    options.program = os.path.abspath(options.program)
    options.dataset = [os.path.abspath(d) for d in options.dataset]
    for dataset in options.dataset:
        os.makedirs(os.path.join(options.cache, os.path.basename(dataset)), exist_ok=True)
    rankers, report = [], {"count": options.count, "shards": options.shards}
    try:
        rankers = serve(options, options.shards)
        report["said"] = [r.said for r in rankers]
        sharded = ask(options, rankers)
        report["sharded"] = figures(sharded)
        report["memory_mb"] = [round(r.memory_mb()) for r in rankers]
        if options.lose:
            rankers[-1].kill()
            report["one_lost"] = figures(ask(options, rankers))
        if options.one:
            for r in rankers:
                r.kill()
            rankers = serve(options, 1)
            options.rounds = 1
            one = ask(options, rankers)
            report["one"] = figures(one)
            report["one_memory_mb"] = round(rankers[0].memory_mb())
            pairs = list(zip(one["lists"], sharded["lists"]))
            report["list_of_one"] = sum(len(a["listed"]) for a, _ in pairs)
            report["of_it_in_that_of_shards"] = sum(len(set(a["listed"]) & set(b["listed"])) for a, b in pairs)
            report["right_of_both"] = sum(len(set(a["right"]) & set(b["right"])) for a, b in pairs)
    finally:
        for r in rankers:
            r.kill()
    print(json.dumps(report))


if __name__ == "__main__":
    main()
