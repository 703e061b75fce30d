#!/usr/bin/env python3
"""The scripts that make packages and releases, and the terms of every file."""
import fnmatch
import gzip
import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
import unittest
import zipfile

ROOT = os.path.abspath(os.path.join(os.path.dirname(__file__), "..", ".."))
DEPLOY = os.path.join(ROOT, "deploy")


def run(script, *arguments, **environment):
    return subprocess.run([sys.executable, "-B", os.path.join(DEPLOY, script), *arguments], capture_output=True, text=True, check=False,
                          env=dict(os.environ, **environment))


def read(path, mode="rb"):
    with open(path, mode) as file:
        return file.read()


class Pages(unittest.TestCase):
    """Of the packages: what they link to is installed (the list of package_page.py is compared with what installs it)."""

    def test_links_lead_to_what_is_installed_and_words_stay(self):
        sys.path.insert(0, DEPLOY)
        import package_page  # pylint: disable=import-outside-toplevel,import-error
        made = package_page.page("docs/cell.md", "![p](images/x.png)\n\n*Left ([how](x.md)).*\n\nSee [how](operations.md#tls), [here](#a), [why](../server/adr), "
                                 "[there](https://example.org) and [the terms](../LICENSE).\n")
        self.assertEqual(made, "\n\nSee [how](../horopter-server/operations.md#tls), [here](#a), why, [there](https://example.org) and "
                         "[the terms](/usr/share/common-licenses/Apache-2.0).\n")
        cmake = read(os.path.join(DEPLOY, "install.cmake"), "r")
        for source, installed in package_page.INSTALLED.items():
            self.assertTrue(os.path.exists(os.path.join(ROOT, source)), source)
            if installed.endswith(".md"):
                self.assertIn(source, cmake)
        for source in re.findall(r"package_page\((\S+\.md) ", cmake):
            for target in re.findall(r"\]\(([^)#\s]+)", package_page.page(source, read(os.path.join(ROOT, source), "r"))):
                self.assertTrue(target in package_page.INSTALLED.values() or "://" in target, (source, target))

    def test_a_page_that_is_not_there_makes_none(self):
        with tempfile.TemporaryDirectory() as folder:
            self.assertNotEqual(run("package_page.py", "no.md", os.path.join(folder, "out.md")).returncode, 0)
            self.assertEqual(os.listdir(folder), [])


class Wheel(unittest.TestCase):
    PROJECT = ('[project]\nname = "horopter"\nversion = "1.2.3rc1"\ndescription = "x"\nlicense = { text = "Apache-2.0" }\n'
               'requires-python = ">=3.9"\ndependencies = ["numpy>=1.20"]\n[tool.setuptools]\npackages = ["horopter", "horopter.v1"]\n')

    def setUp(self):
        folder = tempfile.TemporaryDirectory(prefix="with a blank ")
        self.addCleanup(folder.cleanup)
        self.folder = folder.name
        self.package = os.path.join(self.folder, "package")
        os.makedirs(os.path.join(self.package, "horopter", "v1"))
        self.write("pyproject.toml", self.PROJECT)
        self.write("horopter/__init__.py", '__version__ = "1.2.3rc1"\n')
        self.write("horopter/py.typed", "")
        self.write("horopter/v1/__init__.py", "")

    def write(self, name, text):
        with open(os.path.join(self.package, name), "w", encoding="utf-8") as out:
            out.write(text)

    def make(self, out):
        folder = os.path.join(self.folder, out)
        os.makedirs(folder)
        done = run("wheel.py", self.package, folder, SOURCE_DATE_EPOCH="1700000000")
        return done, os.path.join(folder, "horopter-1.2.3rc1-py3-none-any.whl")

    def test_without_the_generated_messages_there_is_none(self):
        done, path = self.make("a")
        self.assertEqual(done.returncode, 1)
        self.assertFalse(os.path.exists(path))

    def test_the_same_sources_make_the_same_bytes_and_the_record_is_true(self):
        self.write("horopter/v1/recognition_pb2.py", "X = 1\n")
        done, first = self.make("a")
        self.assertEqual(done.returncode, 0, done.stderr)
        os.utime(os.path.join(self.package, "horopter", "__init__.py"), (1, 1))
        _, second = self.make("b")
        self.assertEqual(read(first), read(second))
        with zipfile.ZipFile(first) as wheel:
            names = wheel.namelist()
            record = wheel.read("horopter-1.2.3rc1.dist-info/RECORD").decode().splitlines()
            self.assertEqual([line.split(",")[0] for line in record[:-1]], sorted(names[:-1]))
            for line in record[:-1]:
                name, _, size = line.rsplit(",", 2)
                self.assertEqual(len(wheel.read(name)), int(size))
            self.assertIn("Requires-Dist: numpy>=1.20", wheel.read("horopter-1.2.3rc1.dist-info/METADATA").decode())
            self.assertIn("horopter-1.2.3rc1.dist-info/LICENSE", names)

    def test_pip_takes_it_where_there_is_a_pip(self):
        self.write("horopter/v1/recognition_pb2.py", "X = 1\n")
        _, path = self.make("a")
        target = os.path.join(self.folder, "site")
        done = subprocess.run(["/usr/bin/python3", "-m", "pip", "install", "--quiet", "--no-index", "--no-deps", "--target", target, path],
                              capture_output=True, text=True, check=False)
        if "No module named pip" in done.stderr:
            self.skipTest("no pip")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertTrue(os.path.exists(os.path.join(target, "horopter", "v1", "recognition_pb2.py")))


class Changelog(unittest.TestCase):
    TEXT = ("# Changelog\n\n## Unreleased\n\n- not yet\n\n## 1.2.0 - 2026-01-02\n\n### Added\n\n- A [thing](x.md) of `code`\n  that goes on\n"
            "- another\n\n## 1.2.0-rc1\n\n- the candidate\n")

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.path = os.path.join(folder.name, "CHANGELOG.md")
        self.out = os.path.join(folder.name, "changelog.gz")
        with open(self.path, "w", encoding="utf-8") as out:
            out.write(self.TEXT)

    def section(self, version):
        return run("debian_changelog.py", "--section", self.path, version).stdout

    def test_each_version_has_its_section_and_a_new_one_what_is_not_released(self):
        self.assertIn("- another", self.section("1.2.0"))
        self.assertNotIn("candidate", self.section("1.2.0"))
        self.assertEqual(self.section("1.2.0-rc1"), "- the candidate\n")
        self.assertEqual(self.section("2.0.0"), "- not yet\n")

    def test_debian_reads_it(self):
        done = run("debian_changelog.py", self.path, "1.2.0", "1.2.0", "Authors <a@example.org>", self.out, SOURCE_DATE_EPOCH="1700000000")
        self.assertEqual(done.returncode, 0, done.stderr)
        first = read(self.out)
        run("debian_changelog.py", self.path, "1.2.0", "1.2.0", "Authors <a@example.org>", self.out, SOURCE_DATE_EPOCH="1700000000")
        self.assertEqual(first, read(self.out))
        text = gzip.decompress(first).decode()
        self.assertIn("  * A thing of code that goes on\n  * another\n", text)
        parsed = subprocess.run(["dpkg-parsechangelog", "-l-", "-SVersion"], input=text, capture_output=True, text=True, check=False)
        self.assertEqual(parsed.stdout.strip(), "1.2.0", parsed.stderr)


class Terms(unittest.TestCase):

    def test_every_file_has_a_licence_whose_text_is_here(self):
        reuse = tomllib.loads(read(os.path.join(ROOT, "REUSE.toml")).decode())
        listed = subprocess.run(["git", "-C", ROOT, "ls-files"], capture_output=True, text=True, check=False)
        if listed.returncode != 0:
            self.skipTest("no git")
        files = listed.stdout.splitlines()
        self.assertGreater(len(files), 100)
        annotations = reuse["annotations"]
        for path in files:
            last = [a for a in annotations if fnmatch.fnmatch(path, a["path"])]
            self.assertTrue(last, path)
            licence = last[-1]["SPDX-License-Identifier"]
            self.assertTrue(os.path.exists(os.path.join(ROOT, "LICENSES", licence + ".txt")), licence)
            self.assertTrue(last[-1]["SPDX-FileCopyrightText"])
        for annotation in annotations:
            self.assertTrue(any(fnmatch.fnmatch(path, annotation["path"]) for path in files), annotation["path"])
        self.assertEqual(read(os.path.join(ROOT, "LICENSES", "Apache-2.0.txt")), read(os.path.join(ROOT, "LICENSE")))

    def test_the_licence_is_the_one_of_the_system(self):
        system = "/usr/share/common-licenses/Apache-2.0"
        if not os.path.exists(system):
            self.skipTest("no Debian")
        self.assertEqual(hashlib.sha256(read(os.path.join(ROOT, "LICENSE"))).digest(), hashlib.sha256(read(system)).digest())


class Release(unittest.TestCase):
    """release.sh in a repository of its own, with a stand-in of package.sh."""

    def setUp(self):
        folder = tempfile.TemporaryDirectory(prefix="with a blank ")
        self.addCleanup(folder.cleanup)
        self.tree = folder.name
        os.makedirs(os.path.join(self.tree, "deploy"))
        for name in ("release.sh", "debian_changelog.py"):
            shutil.copy(os.path.join(DEPLOY, name), os.path.join(self.tree, "deploy"))
        self.write("CMakeLists.txt", 'project(horopter VERSION 1.2.0 LANGUAGES CXX)\nset(HOROPTER_PRERELEASE "rc1")\n')
        self.write("CHANGELOG.md", Changelog.TEXT)
        self.write(".gitignore", "/build/\n")
        self.package("echo $SOURCE_DATE_EPOCH >a.whl")
        self.git("init", "-q")
        self.commit()

    def write(self, name, text):
        with open(os.path.join(self.tree, name), "w", encoding="utf-8") as out:
            out.write(text)

    def package(self, makes):
        self.write("deploy/package.sh", '#!/bin/bash\nset -e\ncd "$2"\n%s\nsha256sum a.whl >SHA256SUMS\n' % makes)
        os.chmod(os.path.join(self.tree, "deploy", "package.sh"), 0o755)

    def git(self, *arguments):
        return subprocess.run(["git", "-C", self.tree, "-c", "user.name=a", "-c", "user.email=a@example.org", *arguments],
                              capture_output=True, text=True, check=True).stdout

    def commit(self):
        self.git("add", "-A")
        self.git("commit", "-q", "--allow-empty", "-m", "x")

    def release(self, *arguments):
        identity = {"GIT_%s_%s" % (who, what): "a@example.org" for who in ("AUTHOR", "COMMITTER") for what in ("NAME", "EMAIL")}
        return subprocess.run(["bash", os.path.join(self.tree, "deploy", "release.sh"), *arguments], capture_output=True, text=True,
                              check=False, env=dict(os.environ, **identity))

    def test_a_commit_is_made_into_archive_notes_and_sums_twice_alike(self):
        done = self.release("--check", "--tag")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("Twice the same bytes.", done.stdout)
        out = os.path.join(self.tree, "build", "release-1.2.0-rc1")
        self.assertEqual(sorted(os.listdir(out)), ["SHA256SUMS", "a.whl", "horopter-1.2.0-rc1.md", "horopter-1.2.0-rc1.tar.xz"])
        self.assertEqual(read(os.path.join(out, "horopter-1.2.0-rc1.md")), b"- the candidate\n")
        self.assertEqual(self.git("tag").split(), ["v1.2.0-rc1"])
        self.commit()
        self.assertIn("another commit", self.release("--tag").stderr)

    def test_other_bytes_and_uncommitted_changes_are_refused(self):
        self.package("date +%N >a.whl")
        self.assertIn("not committed", self.release().stderr)
        self.commit()
        done = self.release("--check")
        self.assertEqual(done.returncode, 1)
        self.assertIn("other bytes", done.stderr)


class Scripts(unittest.TestCase):

    def test_unknown_arguments_print_the_usage(self):
        for script in ("package.sh", "release.sh", "check_packages.sh", "credentials.sh"):
            said = subprocess.run(["bash", os.path.join(DEPLOY, script), "--no-such-option"], capture_output=True, text=True, check=False)
            self.assertEqual(said.returncode, 2, script)
            self.assertIn("deploy/" + script, said.stderr, script)


if __name__ == "__main__":
    unittest.main()
