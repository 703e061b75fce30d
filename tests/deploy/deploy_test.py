#!/usr/bin/env python3
"""The scripts of deploy/ that decide whether a run was good: they must be able to say no."""
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import unittest

ROOT = os.path.abspath(os.path.join(os.path.dirname(__file__), "..", ".."))
DEPLOY = os.path.join(ROOT, "deploy")
DATASET = os.path.join(ROOT, "tests", "data", "parts")


def run(script, *arguments, **options):
    return subprocess.run([sys.executable, "-B", os.path.join(DEPLOY, script), *arguments],
                          capture_output=True, text=True, **options)


class Summary(unittest.TestCase):

    def summarise(self, cases):
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "r.xml")
            with open(path, "w", encoding="utf-8") as out:
                out.write('<testsuite name="x">%s</testsuite>' % "".join(cases))
            return run("summary.py", path)

    OK = '<testcase name="ok" time="0.5" status="run"></testcase>'
    BAD = '<testcase name="bad" time="1" status="fail"><failure message=""/></testcase>'
    GONE = '<testcase name="gone" time="0" status="notrun"><skipped message="Unable to find executable"/></testcase>'
    SKIPPED = ('<testcase name="data" time="0" status="notrun">'
               '<skipped message="SKIP_REGULAR_EXPRESSION_MATCHED"/></testcase>')

    def test_all_passed_is_a_pass_and_skips_are_named(self):
        said = self.summarise([self.OK, self.SKIPPED])
        self.assertEqual(said.returncode, 0)
        self.assertIn("skipped: data", said.stdout)
        self.assertEqual(said.stdout.splitlines()[-1], "1 passed, 0 failed, 1 skipped")

    def test_a_failure_or_a_missing_program_fails(self):
        for bad, name in ((self.BAD, "bad"), (self.GONE, "gone")):
            said = self.summarise([self.OK, bad])
            self.assertEqual(said.returncode, 1)
            self.assertIn("failed: " + name, said.stdout)
            self.assertEqual(said.stdout.splitlines()[-1], "1 passed, 1 failed, 0 skipped")

    def test_no_test_that_ran_fails(self):
        self.assertEqual(self.summarise([]).returncode, 1)
        self.assertEqual(self.summarise([self.SKIPPED]).returncode, 1)
        self.assertEqual(run("summary.py", "no such file").returncode, 1)


class Build(unittest.TestCase):
    """What deploy/build.sh decides from memory and cores, with stand-ins of cmake and nproc."""

    def build(self, free_mb, cores, *arguments, folder="a tree", configured=False):
        with tempfile.TemporaryDirectory() as root:
            tree = os.path.join(root, folder)
            os.makedirs(os.path.join(tree, "deploy"))
            shutil.copy(os.path.join(DEPLOY, "build.sh"), os.path.join(tree, "deploy"))
            if configured:
                os.makedirs(os.path.join(tree, "build", "release"))
                open(os.path.join(tree, "build", "release", "CMakeCache.txt"), "w", encoding="utf-8").close()
            tools = os.path.join(root, "tools")
            os.makedirs(tools)
            said = os.path.join(root, "said")
            for name, text in (("cmake", 'printf "%%s|" "$@" >>"%s"; echo >>"%s"' % (said, said)), ("nproc", "echo %d" % cores)):
                with open(os.path.join(tools, name), "w", encoding="utf-8") as tool:
                    tool.write("#!/bin/sh\n%s\n" % text)
                os.chmod(os.path.join(tools, name), 0o755)
            meminfo = os.path.join(root, "meminfo")
            with open(meminfo, "w", encoding="utf-8") as out:
                out.write("MemTotal: 99999999 kB\nMemAvailable: %d kB\n" % (free_mb * 1024))
            run = subprocess.run(["bash", os.path.join(tree, "deploy", "build.sh"), *arguments], capture_output=True, text=True,
                                 env={**os.environ, "PATH": tools + ":" + os.environ["PATH"], "HOROPTER_MEMINFO": meminfo})
            asked = ""
            if os.path.exists(said):
                with open(said, encoding="utf-8") as file:
                    self.configured_with, asked = file.read().splitlines()
            return run, asked

    def test_as_many_at_a_time_as_cores_and_memory_allow(self):
        for free_mb, cores, jobs in ((16000, 2, 2), (4500, 1, 1), (4500, 8, 2), (4100, 2, 2), (3900, 2, 1), (700, 4, 1)):
            run, asked = self.build(free_mb, cores)
            self.assertEqual(run.returncode, 0, run.stderr)
            self.assertIn("--parallel|%d|" % jobs, asked, (free_mb, cores))
            self.assertIn("%d at a time" % jobs, run.stdout)
            self.assertEqual("may be killed" in run.stderr, free_mb < 2000)

    def test_jobs_and_targets_are_handed_on(self):
        run, asked = self.build(700, 4, "--jobs", "3", "horopterd", "horopter")
        self.assertEqual(run.returncode, 0, run.stderr)
        self.assertIn("--parallel|3|--target|horopterd|horopter|", asked)
        for wrong in ("0", "-1", "many", "1e3"):
            run, asked = self.build(9000, 4, "--jobs", wrong)
            self.assertEqual((run.returncode, asked), (2, ""), wrong)

    def test_a_first_build_is_in_batches_and_a_folder_keeps_what_it_was_made_with(self):
        batches = "-DHOROPTER_UNITY=ON|"
        for arguments, configured, options in (((), False, batches), ((), True, ""), (("--batches",), True, batches),
                                               (("--single",), False, "-DHOROPTER_UNITY=OFF|"),
                                               (("--single", "--precompiled"), False, "-DHOROPTER_UNITY=OFF|-DHOROPTER_PRECOMPILED_HEADERS=ON|"),
                                               (("--preset", "dev"), False, "")):
            run, _ = self.build(9000, 2, *arguments, configured=configured)
            self.assertEqual(run.returncode, 0, run.stderr)
            preset = "dev" if "dev" in arguments else "release"
            self.assertEqual(self.configured_with, "--preset|%s|%s" % (preset, options), (arguments, configured))


class DemoVerdict(unittest.TestCase):

    def judge(self, scene, rows, recall):
        """rows: (im_id, obj_id) of the results."""
        with tempfile.TemporaryDirectory() as folder:
            results, scores = os.path.join(folder, "r.csv"), os.path.join(folder, "s.json")
            with open(results, "w", encoding="utf-8") as out:
                out.write("scene_id,im_id,obj_id,score,R,t,time\n")
                for im_id, obj_id in rows:
                    out.write("%d,%d,%d,0.9,1 0 0 0 1 0 0 0 1,0 0 500,1\n" % (scene, im_id, obj_id))
            with open(scores, "w", encoding="utf-8") as out:
                json.dump({"scenes": {str(scene): {"R@10": recall}}}, out)
            return run("demo_verdict.py", DATASET, str(scene), results, scores)

    def test_the_right_object_alone_is_right(self):
        self.assertEqual(self.judge(5, [(i, 19) for i in range(4)], 1.0).returncode, 0)

    def test_repeated_parts_are_counted(self):
        scene_13 = [(i, o) for i in range(4) for o in (3, 9, 9, 10, 14, 16)]
        self.assertEqual(self.judge(13, scene_13, 1.0).returncode, 0)
        self.assertEqual(self.judge(13, [row for row in scene_13 if row[1] != 9] + [(0, 9)], 1.0).returncode, 1)

    def test_wrong_missing_or_further_objects_are_wrong(self):
        self.assertEqual(self.judge(5, [(i, 18) for i in range(4)], 1.0).returncode, 1)
        self.assertEqual(self.judge(5, [], 1.0).returncode, 1)
        said = self.judge(5, [(i, o) for i in range(4) for o in (19, 2)], 1.0)
        self.assertEqual(said.returncode, 1)
        self.assertIn("l_bracket_long", said.stdout)

    def test_a_pose_that_is_off_is_wrong(self):
        self.assertEqual(self.judge(5, [(i, 19) for i in range(4)], 0.75).returncode, 1)
        self.assertEqual(self.judge(5, [(i, 19) for i in range(4)], None).returncode, 1)


class OwnCameras(unittest.TestCase):
    """Poses under the cameras of the answer, from the ground truth of scene 1, moved."""

    def judge(self, move_px=0.0, camera_px=0.0, recall=0.0):
        """The part moved sideways by what shifts it move_px; the answer's principal point off by camera_px."""
        folder_1 = os.path.join(DATASET, "val", "000001")
        with open(os.path.join(folder_1, "scene_gt.json"), encoding="utf-8") as file:
            truth = json.load(file)
        with open(os.path.join(folder_1, "scene_camera.json"), encoding="utf-8") as file:
            cameras = json.load(file)
        with tempfile.TemporaryDirectory() as folder:
            results, scores = os.path.join(folder, "r.csv"), os.path.join(folder, "s.json")
            own = {}
            with open(results, "w", encoding="utf-8") as out:
                out.write("scene_id,im_id,obj_id,score,R,t,time\n")
                for image, instances in truth.items():
                    k = list(cameras[image]["cam_K"])
                    for i in instances:
                        t = list(i["cam_t_m2c"])
                        t[0] += (move_px - camera_px) * t[2] / k[0]
                        out.write("1,%s,%d,0.9,%s,%s,1\n" % (image, i["obj_id"], " ".join(map(str, i["cam_R_m2c"])),
                                                              " ".join(map(str, t))))
                    k[2] += camera_px
                    own[image] = {"cam_K": k}
            with open(os.path.join(folder, "r.cameras.json"), "w", encoding="utf-8") as out:
                json.dump({"1": own}, out)
            with open(scores, "w", encoding="utf-8") as out:
                json.dump({"scenes": {"1": {"R@10": recall}}}, out)
            return run("demo_verdict.py", DATASET, "1", results, scores)

    def test_the_true_pose_is_right_and_one_that_is_off_is_wrong(self):
        said = self.judge()
        self.assertEqual(said.returncode, 0, said.stdout + said.stderr)
        self.assertIn("1.000 under the answer's own", said.stdout)
        self.assertEqual(self.judge(move_px=14.0).returncode, 1)

    def test_a_principal_point_that_is_off_with_the_pose_is_right_under_the_own_cameras(self):
        self.assertEqual(self.judge(camera_px=15.0).returncode, 0)
        self.assertEqual(self.judge(camera_px=15.0, move_px=15.0).returncode, 1)


class Scripts(unittest.TestCase):

    def test_unknown_arguments_print_the_usage(self):
        for script in ("install.sh", "build.sh", "check.sh", "demo.sh"):
            said = subprocess.run(["bash", os.path.join(DEPLOY, script), "--no-such-option"],
                                  capture_output=True, text=True)
            self.assertEqual(said.returncode, 2, script)
            self.assertIn("deploy/" + script, said.stderr, script)

    def test_packages_are_named_once_with_group_and_reason(self):
        names = []
        with open(os.path.join(DEPLOY, "packages.txt"), encoding="utf-8") as file:
            for line in file:
                if line.strip() and not line.startswith("#"):
                    self.assertRegex(line, r"^\S+ +(build|test|page|package|dev) +# \S")
                    names.append(line.split()[0])
        self.assertEqual(len(names), len(set(names)))
        self.assertGreater(len(names), 10)

    def test_node_is_asked_for_only_where_the_page_is_wanted_and_none_is_there(self):
        def missing(*options, node):
            with tempfile.TemporaryDirectory() as folder:
                for name in ["dpkg-query", "apt-get"] + (["node", "npm"] if node else []):
                    with open(os.path.join(folder, name), "w", encoding="utf-8") as file:
                        file.write("#!/bin/sh\nexit 1\n")
                    os.chmod(file.name, 0o755)
                for name in ("sh", "bash", "dirname"):
                    os.symlink(shutil.which(name), os.path.join(folder, name))
                listed = subprocess.run([shutil.which("bash"), os.path.join(DEPLOY, "install.sh"), "--list", *options], env={"PATH": folder},
                                        capture_output=True, text=True, check=True)
                return listed.stdout.split()
        self.assertIn("g++", missing(node=False))
        self.assertNotIn("nodejs", missing(node=False))
        self.assertIn("nodejs", missing("--page", node=False))
        self.assertIn("npm", missing("--dev", node=False))
        self.assertNotIn("nodejs", missing("--page", node=True))
        self.assertIn("clang-tidy", missing("--dev", node=True))

    def test_alerts_ask_for_figures_that_there_are(self):
        told = set()
        for name in ("telemetry.cc", "live_figures.cc"):
            with open(os.path.join(ROOT, "server", "service", name), encoding="utf-8") as file:
                told |= set(re.findall(r'"((?:horopter|process)_[a-z_]+)"', file.read()))
        with open(os.path.join(DEPLOY, "grafana", "alerts.yml"), encoding="utf-8") as file:
            expressions = re.findall(r"^ +expr: (.*)$", file.read(), re.M)
        self.assertGreater(len(expressions), 8)
        for expression in expressions:
            for name in re.findall(r"\b(?:horopter|process)_[a-z_]+", expression):
                self.assertIn(re.sub("_bucket$", "", name), told, expression)


if __name__ == "__main__":
    unittest.main()
