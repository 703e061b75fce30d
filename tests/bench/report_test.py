"""Tests of the recorded runs, their report and their recorder; and that the pages are what the runs in the tree say."""
import json
import os
import re
import shutil
import stat
import subprocess
import sys
import tempfile
import unittest

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path.insert(0, HERE)
import record  # noqa: E402
import record_decision  # noqa: E402
import record_program  # noqa: E402
import report  # noqa: E402
import run_files  # noqa: E402


def scene(number, right, targets=4, tier="T1", **more):
    """`right` of the targets are answered, all rightly."""
    row = {"scene": number, "tier": tier, "images": 4, "targets": targets, "mspd": right, "mssd": right, "r10": right, "own10": right,
           "estimates": [[0.9, 1, 1]] * right, "rel_mm": [0.5], "rel_deg": [0.1], "f_err": [0.01], "seconds": 2.0, "cpu_seconds": 3.0,
           "sift_cpu_seconds": 0.3, "state": "RECOGNIZED"}
    row.update(more)
    return row


def run(scenes, name="parts-dev", order=1, **more):
    out = {"format": run_files.FORMAT, "kind": "recognition", "name": name, "commit": "%07d" % order, "order": order, "command": "record",
           "date": "2026-01-01T00:00:00Z", "machine": {"cpu": "c", "cores": 2, "shared": True, "load": [1, 1]}, "n": len(scenes), "split": "val",
           "objects": 20, "min_visib": 0.3, "variants": "", "peak_memory_mb": 100, "scenes": scenes}
    out.update(more)
    return out


class Folder(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.mkdtemp()
        self.addCleanup(shutil.rmtree, self.folder)
        self.runs = os.path.join(self.folder, "runs")
        os.makedirs(self.runs)
        os.makedirs(os.path.join(self.folder, "docs"))
        self.write("README.md", "# X\n\n%s\n%s\n\nend\n" % (report.BEGIN, report.END))

    def write(self, name, content):
        with open(os.path.join(self.folder, name), "w", encoding="utf-8") as file:
            file.write(content if isinstance(content, str) else run_files.dumps(content))

    def read(self, name):
        with open(os.path.join(self.folder, name), encoding="utf-8") as file:
            return file.read()

    def report(self, *arguments):
        return subprocess.run([sys.executable, "-B", os.path.join(HERE, "report.py"), "--root", self.folder, "--runs", self.runs, *arguments],
                              capture_output=True, text=True, check=False)


class Statistics(unittest.TestCase):
    def test_an_interval_holds_its_figure_and_shrinks_with_more_scenes(self):
        few = [scene(i, i % 5) for i in range(8)]
        many = [scene(i, i % 5) for i in range(80)]
        for scenes in (few, many):
            low, high = run_files.interval(scenes, run_files.recall("own10"))
            self.assertLessEqual(low, run_files.recall("own10")(scenes))
            self.assertGreaterEqual(high, run_files.recall("own10")(scenes))
        width = [high - low for low, high in (run_files.interval(s, run_files.recall("own10")) for s in (few, many))]
        self.assertLess(width[1], 0.5 * width[0])

    def test_scenes_that_are_all_alike_leave_no_doubt(self):
        self.assertEqual(run_files.interval([scene(i, 2) for i in range(5)], run_files.average_recall), (0.5, 0.5))

    def test_two_scenes_have_no_interval_and_none_no_figure(self):
        self.assertIsNone(run_files.interval([scene(1, 1), scene(2, 2)], run_files.precision))
        self.assertIsNone(run_files.average_recall([]))
        self.assertIsNone(run_files.precision([scene(1, 0)]))
        self.assertIsNone(run_files.quantile([None], 0.5))

    def test_recall_counts_targets_and_not_scenes(self):
        self.assertAlmostEqual(run_files.recall("own10")([scene(1, 1, targets=1), scene(2, 0, targets=9)]), 0.1)

    def test_a_difference_pairs_scenes(self):
        before, after = [scene(i, i % 4) for i in range(9)], [scene(i, i % 4 + 1) for i in range(9)]
        value, ends = run_files.difference(before, after[3:], run_files.recall("own10"))
        self.assertAlmostEqual(value, 0.25)  # one target of four more in each scene: the pairs leave no doubt
        self.assertAlmostEqual(ends[0], 0.25)
        self.assertAlmostEqual(ends[1], 0.25)

    def test_quantiles_lie_between_neighbours(self):
        self.assertEqual(run_files.quantile([3, 1, None, 2], 0.5), 2)
        self.assertAlmostEqual(run_files.quantile([0, 10], 0.95), 9.5)


class Files(Folder):
    def test_what_is_written_is_read_again(self):
        self.write("runs/a.json", run([scene(1, 2)]))
        self.assertEqual(run_files.read_all(self.runs), [run([scene(1, 2)])])

    def test_a_broken_file_is_named(self):
        for broken in ("", "{", "[]", '{"format": "other"}', json.dumps({k: v for k, v in run([]).items() if k != "commit"}),
                       json.dumps(run([], kind="guess")), json.dumps(run([{"scene": 1}])), json.dumps({**run([]), "scenes": 3})):
            self.write("runs/b.json", broken)
            with self.assertRaisesRegex(run_files.BadRun, "b.json"):
                run_files.read_all(self.runs)
            done = self.report()
            self.assertEqual(done.returncode, 1, broken)
            self.assertIn("b.json", done.stderr)
            self.assertNotIn("Traceback", done.stderr)


class Decision(Folder):
    PRINTED = ("3 true obj_000004 0.9912 worst 2.5 px alternatives 0\n3 true obj_000007 0.9500 worst 31.0 px alternatives 1\n"
               "3 shapes 0.12 of 2.50 s: features 0.10\n  something is said\n4 shapes 0.00 of 1.00 s: features 0.10\n4 true none\n")

    def test_what_the_program_prints_is_read_by_scene(self):
        scenes = record_decision.answers(self.PRINTED, "true")
        self.assertEqual([(s["scene"], len(s["answers"])) for s in scenes], [(3, 2), (4, 0)])
        self.assertEqual(scenes[0]["answers"], [[0.9912, 1, 0, "obj_000004"], [0.95, 0, 1, "obj_000007"]])
        self.assertEqual(scenes[0]["seconds"], 2.5)

    def test_nothing_is_right_under_another_catalog(self):
        scenes = record_decision.answers(self.PRINTED.replace("true", "mirror"), "mirror")
        self.assertEqual([a[1] for a in scenes[0]["answers"]], [0, 0])

    def test_separation_is_the_share_of_pairs_in_order(self):
        self.assertEqual(report.separation([[0.9, 1], [0.8, 1], [0.1, 0]]), 1.0)
        self.assertEqual(report.separation([[0.5, 1], [0.5, 0]]), 0.5)
        self.assertIsNone(report.separation([[0.5, 1]]))

    def test_wrong_answers_that_are_sure_stand_in_the_table_and_curves_are_drawn(self):
        of = {"true": [[0.99, 1, 0, "a"], [0.6, 1, 0, "b"]], "mirror": [[0.95, 0, 0, "a"], [0.95, 0, 1, "b"]]}
        body = [{"scene": i, "catalog": c, "answers": a, "seconds": 1.0} for c, a in of.items() for i in range(2)]
        self.write("runs/d.json", run(body, kind="decision"))
        self.assertEqual(self.report().returncode, 0)
        page = self.read("docs/benchmarks.md")
        self.assertIn("| parts-dev | 0000001 | true | 2 | 4 | 4 | 2 | 0 | 0.500 |", page)
        self.assertIn("|  |  | mirror | 2 | 4 | 0 | 2 | 2 |  |", page)
        self.assertIn("renders: 8 answers", self.read("docs/images/decision.svg"))
        self.assertEqual(self.report("--check").returncode, 0)
        self.write("docs/images/decision.svg", "edited")
        self.assertEqual(self.report("--check").returncode, 1)


class Pages(Folder):
    def test_the_newest_run_stands_in_the_tables_and_the_change_beside_it(self):
        self.write("runs/new.json", run([scene(i, 4) for i in range(4)], order=2))
        self.write("runs/old.json", run([scene(i, 2) for i in range(4)], order=1))
        self.assertEqual(self.report().returncode, 0)
        page = self.read("docs/benchmarks.md")
        self.assertIn("| parts-dev | 0000002 | all | 4 | 16 | 1.00 (1.00 - 1.00) |", page)
        self.assertIn("| parts-dev | 0000001 - 0000002 | 4 | +0.500 (+0.500, +0.500) |", page)
        readme = self.read("README.md")
        self.assertIn("| 20 | 1.00 (1.00 - 1.00) |", readme)
        self.assertTrue(readme.startswith("# X\n") and readme.endswith("\nend\n"))

    def test_without_a_run_the_pages_say_so(self):
        self.assertEqual(self.report().returncode, 0)
        self.assertIn("No run is recorded", self.read("README.md"))
        self.assertIn("No run is recorded", self.read("docs/benchmarks.md"))

    def test_check_finds_a_page_that_was_edited_and_writes_nothing(self):
        self.write("runs/a.json", run([scene(i, 2) for i in range(3)]))
        self.assertEqual(self.report("--check").returncode, 1)
        self.assertFalse(os.path.exists(os.path.join(self.folder, "docs", "benchmarks.md")))
        self.report()
        self.assertEqual(self.report("--check").returncode, 0)
        self.write("docs/benchmarks.md", self.read("docs/benchmarks.md").replace("0.50", "0.95"))
        done = self.report("--check")
        self.assertEqual(done.returncode, 1)
        self.assertIn("docs/benchmarks.md", done.stderr)

    def test_photographs_have_a_row_of_their_own_however_bad(self):
        self.write("runs/a.json", run([scene(1, 0, state="NOTHING_FOUND")], name="real-dev/tools", objects=4))
        self.write("runs/b.json", run([scene(1, 1)], name="real-dev/lmo", objects=8))
        self.assertEqual(self.report().returncode, 0)
        row = next(line for line in self.read("README.md").splitlines() if line.startswith("| real-dev |"))
        self.assertIn("| 4 - 8 | 0.12 |", row)

    def test_variants_count_as_ablation_and_nowhere_else(self):
        self.write("runs/a.json", run([scene(i, 4) for i in range(4)]))
        self.write("runs/b.json", run([scene(i, 3) for i in range(3)], variants="routes=aspects"))
        self.assertEqual(self.report().returncode, 0)
        page = self.read("docs/benchmarks.md")
        self.assertIn("| routes=aspects | parts-dev | 0000001 | 3 | -0.250 (-0.250, -0.250) |", page)
        self.assertIn("| parts-dev | 0000001 | all | 4 | 16 | 1.00", page)

    def test_what_an_ablation_is_compared_with_is_no_figure_of_the_set(self):
        self.write("runs/a.json", run([scene(i, 4) for i in range(4)]))
        later = {"commit": "0000002", "order": 2}
        self.write("runs/b.json", dict(run([scene(i, 2) for i in range(2)]), ablation=True, **later))
        self.write("runs/c.json", dict(run([scene(i, 1) for i in range(2)], variants="standing=off"), **later))
        self.assertEqual(self.report().returncode, 0)
        page = self.read("docs/benchmarks.md")
        self.assertIn("| standing=off | parts-dev | 0000002 | 2 | -0.250 |", page)
        self.assertIn("| parts-dev | 0000001 | all | 4 | 16 | 1.00", page)
        self.assertNotIn("| parts-dev | 0000002 | all |", page)

    def test_wall_times_of_a_shared_machine_are_not_shown(self):
        idle = run([scene(1, 4, seconds=77.7)])
        idle["machine"] = dict(idle["machine"], shared=False)
        for shown, of in ((True, idle), (False, run([scene(1, 4, seconds=77.7)]))):
            self.write("runs/a.json", of)
            self.report()
            self.assertEqual("77.7" in self.read("docs/benchmarks.md"), shown)

    def test_every_kind_has_its_table(self):
        peer = run([{"scene": 1, "targets": 4, "r10": 1, "own10": 1, "cpu_seconds": 9}], kind="peer", peer="LINE-2D", given="K")
        self.write("runs/a.json", run([scene(1, 4)]))
        self.write("runs/p.json", peer)
        self.write("runs/c.json", run([{"set": "s", "scene": 1, "images": 5, "method": m, "registered": r, "rotation_deg": 1.0, "focal_error": -0.02}
                                       for m, r in (("Horopter", 5), ("COLMAP", 3))], kind="cameras", name="cameras"))
        program = run([], kind="program", name="index", figures=[{"what": "box query", "value": 1.14, "unit": "us"}])
        del program["scenes"]
        self.write("runs/i.json", program)
        self.assertEqual(self.report().returncode, 0)
        page = self.read("docs/benchmarks.md")
        self.assertIn("| parts-dev | LINE-2D | K | 1 | 4 | 0.25 |", page)
        self.assertIn("| s | Horopter | 0000001 | 1 of 1 | 5 of 5 | 0.020 | 1.00 | - |", page)
        self.assertIn("| s | COLMAP | 0000001 | 0 of 1 | 3 of 5 |", page)
        self.assertIn("| box query | 1.14 | us |", page)

    def test_a_readme_without_its_marks_and_a_set_nobody_describes_are_refused(self):
        self.write("runs/a.json", run([scene(1, 4)], name="mystery"))
        self.assertIn("mystery", self.report().stderr)
        self.write("runs/a.json", run([scene(1, 4)]))
        self.write("README.md", "# X\n")
        self.assertIn("README.md", self.report().stderr)


SERVER = """#!/bin/sh
echo "listening on 127.0.0.1:9"
exec sleep 600
"""
CLIENT = """#!%s
import json, sys
a = sys.argv
if "enroll" in a: sys.exit(0)
if "list" in a: print('{"objects": [{}, {}]}'); sys.exit(0)
if "recognize" in a:
    n = int(a[a.index("--scenes") + 1])
    open(a[a.index("--out") + 1], "w").write("scene_id,im_id,obj_id,score,R,t,time\\n%%d,0,1,0.9,1 0 0 0 1 0 0 0 1,0 0 1,2\\n" %% n)
    print(json.dumps({"scene": n, "seconds": 2.0, "state": "RECOGNIZED"})); sys.exit(0)
of = dict(tier="T1", targets=2, MSPD=0.5, MSSD=1.0, R10=0.5, own10=None, rel_mm_values=[1.0], rel_deg_values=[2.0], f_err_values=[],
          estimates=[{"score": 0.9, "right": True, "own_px": 3.0}, {"score": 0.4, "right": False, "own_px": None}])
print(json.dumps({"scenes": {n: of for n in a[a.index("--scenes") + 1].split(",")}}))
""" % sys.executable


@unittest.skipUnless(os.path.exists(os.path.join(run_files.ROOT, ".git")), "a run names its commit: needs a clone")
class Recorder(Folder):
    """With a server and a client that do nothing but answer; the real ones are recorded by hand."""

    def setUp(self):
        super().setUp()
        for name, text in (("horopterd", SERVER), ("horopter", CLIENT)):
            self.write(name, text)
            os.chmod(os.path.join(self.folder, name), stat.S_IRWXU)
        for number in (1, 2):
            os.makedirs(os.path.join(self.folder, "set", "val", "%06d" % number, "rgb"))

    def record(self, *arguments):
        return subprocess.run([sys.executable, "-B", os.path.join(HERE, "record.py"), os.path.join(self.folder, "set"), "val",
                               os.path.join(self.folder, "out.json"), "--name", "parts-dev", "--programs", self.folder, "--shared", *arguments],
                              capture_output=True, text=True, check=False)

    def test_a_run_is_scored_scene_by_scene(self):
        done = self.record("--keep", os.path.join(self.folder, "kept"))
        self.assertEqual(done.returncode, 0, done.stderr + done.stdout)
        recorded = run_files.read(os.path.join(self.folder, "out.json"))
        self.assertEqual([s["scene"] for s in recorded["scenes"]], [1, 2])
        first = recorded["scenes"][0]
        self.assertEqual((first["targets"], first["mspd"], first["mssd"], first["own10"]), (2, 1.0, 2.0, 0.0))
        self.assertEqual(first["estimates"], [[0.9, 1, 1], [0.4, 0, 0]])
        self.assertEqual(recorded["objects"], 2)
        self.assertTrue(recorded["machine"]["shared"])
        self.assertNotIn(self.folder, json.dumps(recorded))  # no path of a machine in what is published
        self.assertEqual(len(self.read("kept/results.csv").splitlines()), 3)

    def test_a_run_that_was_broken_off_goes_on(self):
        kept = os.path.join(self.folder, "kept")
        self.assertEqual(self.record("--keep", kept, "--scenes", "2").returncode, 0)
        self.write("horopter", CLIENT.replace('"seconds": 2.0', '"seconds": 9.0'))
        self.assertEqual(self.record("--keep", kept).returncode, 0)
        self.assertEqual([s["seconds"] for s in run_files.read(os.path.join(self.folder, "out.json"))["scenes"]], [9.0, 2.0])
        other = self.record("--keep", kept, "--variants", "routes=aspects")
        self.assertNotEqual(other.returncode, 0)
        self.assertIn("another run", other.stderr)

    def test_scenes_may_be_chosen_and_none_is_an_error(self):
        self.assertEqual(self.record("--scenes", "2").returncode, 0)
        self.assertEqual(run_files.read(os.path.join(self.folder, "out.json"))["n"], 1)
        self.assertNotEqual(self.record("--scenes", "7").returncode, 0)

    def test_a_set_of_which_nothing_is_enrolled_is_no_run(self):
        self.write("horopter", CLIENT.replace("[{}, {}]", "[]"))
        done = self.record()
        self.assertNotEqual(done.returncode, 0)
        self.assertIn("nothing is enrolled", done.stderr)

    def test_parts_that_are_refused_are_told_and_noted(self):
        refusal = 'if "enroll" in sys.argv:\n    print("[2/3] obj_000002 not enrolled: INVALID_ARGUMENT: no edges")\n    sys.exit(3)\n'
        self.write("horopter", re.sub(r"(?m)^import .*$", lambda found: found.group() + "\nimport sys\n" + refusal, CLIENT, count=1))
        done = self.record()
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("obj_000002 not enrolled", done.stderr)
        self.assertEqual(run_files.read(os.path.join(self.folder, "out.json"))["note"], "1 parts were not enrolled and count as missed")

    def test_a_server_that_does_not_come_up_is_told(self):
        self.write("horopterd", "#!/bin/sh\necho no such thing >&2\nexit 1\n")
        done = self.record()
        self.assertNotEqual(done.returncode, 0)
        self.assertIn("no such thing", done.stderr)
        self.assertFalse(os.path.exists(os.path.join(self.folder, "out.json")))


class Programs(unittest.TestCase):
    def test_the_index_stands_beside_its_best_peer(self):
        table = ("BM ...\n\n| data/d/n/query, us | scan | x-tree | boost_packed | fastest |\n|---|---|---|---|---|\n"
                 "| uniform/6/100000/box | 900 | 1.5 | 2.5 | x-tree |\n| uniform/6/100000/point | 8e+02 | 0.3 | | x-tree |\n")
        figures = record_program.index(table)
        self.assertEqual([(f["what"], f["value"]) for f in figures], [("uniform/6/100000/box", 1.5), ("uniform/6/100000/point", 0.3)])
        self.assertIn("2.5 (boost_packed)", figures[0]["unit"])
        self.assertIn("800 (scan)", figures[1]["unit"])
        self.assertEqual(record_program.index("no table"), [])

    def test_round_trips_are_read(self):
        text = "300 requests of 81234 bytes: whole 3.10 / 9.20 ms, without decoding 0.54 / 2.10 ms (p50 / p99)\n"
        self.assertEqual([f["value"] for f in record_program.service(text)], [3.1, 9.2, 0.54, 2.1])
        self.assertEqual(record_program.service("Segmentation fault"), [])


class Tree(unittest.TestCase):
    PAGES = ("README.md", "CONTRIBUTING.md", "SECURITY.md", "CHANGELOG.md", "docs/README.md", "docs/architecture.md", "docs/benchmarks.md",
             "docs/history/README.md", "docs/history/results.md", "docs/images/README.md", "tests/bench/results.md", "tests/bench/runs/README.md")

    def test_every_link_between_pages_leads_somewhere(self):
        for page in self.PAGES:
            path = os.path.join(run_files.ROOT, page)
            with open(path, encoding="utf-8") as file:
                for link in re.findall(r"\]\(([^)#]+)[^)]*\)", file.read()):
                    if "://" not in link:
                        self.assertTrue(os.path.exists(os.path.join(os.path.dirname(path), link)), "%s: %s" % (page, link))

    def test_the_readme_can_be_read_in_a_few_minutes(self):
        with open(os.path.join(run_files.ROOT, "README.md"), encoding="utf-8") as file:
            self.assertLessEqual(len(file.read().split()), 900)

    def test_the_pages_are_what_the_runs_say(self):
        done = subprocess.run([sys.executable, "-B", os.path.join(HERE, "report.py"), "--check"], capture_output=True, text=True, check=False)
        self.assertEqual(done.returncode, 0, done.stderr)


if __name__ == "__main__":
    unittest.main()
