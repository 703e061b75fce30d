#!/usr/bin/env python3
"""What is installed works from where it is installed: a C++ program by find_package, the Python package, the configuration.

    install_test.py CMAKE BUILD SOURCE MOCK_HOROPTERD
"""
import os
import re
import subprocess
import sys
import tempfile
import unittest

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "support"))
from mock_server import Mock  # noqa: E402

CMAKE = sys.argv[1]
BUILD, SOURCE, MOCK = map(os.path.abspath, sys.argv[2:5])
DATASET = os.path.join(SOURCE, "tests", "data", "parts")
IMAGE = os.path.join(DATASET, "val", "000005", "rgb", "000000.png")


def run(*command, **options):
    return subprocess.run(command, capture_output=True, text=True, check=False, **options)


class Install(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        cls.root = os.path.join(cls.folder.name, "root")
        for component in ("server", "client", "dev", "python"):
            done = run(CMAKE, "--install", BUILD, "--prefix", "/usr", "--component", component,
                       env=dict(os.environ, DESTDIR=cls.root))
            assert done.returncode == 0, done.stdout + done.stderr

    @classmethod
    def tearDownClass(cls):
        cls.folder.cleanup()

    def path(self, *parts):
        return os.path.join(self.root, *parts)

    def test_a_program_is_built_by_find_package_and_runs(self):
        build = os.path.join(self.folder.name, "example")
        done = run(CMAKE, "-G", "Ninja", "-S", os.path.join(SOURCE, "client", "example"), "-B", build,
                   "-DCMAKE_PREFIX_PATH=" + self.path("usr"))
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        done = run(CMAKE, "--build", build)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        with Mock(MOCK) as mock:
            added = run(self.path("usr", "bin", "horopter"), "--server", mock.address, "object", "add",
                        os.path.join(DATASET, "cad", "obj_000001.step"), "--id", "bracket")
            self.assertEqual(added.returncode, 0, added.stderr)
            said = run(os.path.join(build, "pick"), mock.address, IMAGE)
            self.assertEqual(said.stdout, "bracket 0.90: above at 0.0100 0.0200 0.5000 m\n", said.stderr)

    def test_the_python_package_is_imported_from_where_it_is(self):
        said = run("/usr/bin/python3", "-B", "-c", "import horopter; print(horopter.__version__)",
                   env=dict(os.environ, PYTHONPATH=self.path("usr", "lib", "python3", "dist-packages")))
        self.assertRegex(said.stdout, r"^\d+\.\d+\.\d+(rc\d+)?\n$", said.stderr)

    def test_the_sample_configuration_has_every_option_and_starts_a_server(self):
        server = self.path("usr", "bin", "horopterd")
        with open(self.path("etc", "horopter", "horopterd.toml"), encoding="utf-8") as file:
            config = file.read()
        options = set(re.findall(r"^ +(?:-\w,)?--([a-z-]+)", run(server, "--help").stdout, re.M))
        options -= {"help", "version", "config", "print-config", "copy-catalog-to"}  # what is done once
        self.assertGreater(len(options), 12)
        named = set(re.findall(r"^#?([a-z-]+) ?=", config, re.M))
        self.assertEqual(options - named, set())
        config = re.sub(r'^listen=.*$', 'listen="127.0.0.1:0"', config, flags=re.M)
        config = re.sub(r'^db=.*$', 'db="%s"' % os.path.join(self.folder.name, "parts.db"), config, flags=re.M)
        edited = os.path.join(self.folder.name, "edited.toml")
        with open(edited, "w", encoding="utf-8") as out:
            out.write(config)
        process = subprocess.Popen([server, "--config", edited], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        lines = []
        for line in process.stdout:
            lines.append(line)
            if "listening on" in line:
                break
        process.terminate()
        process.stdout.read()
        process.stdout.close()
        self.assertEqual(process.wait(), 0, lines)
        self.assertIn("listening on 127.0.0.1", lines[-1])

    def test_the_unit_starts_what_is_installed(self):
        with open(self.path("lib", "systemd", "system", "horopterd.service"), encoding="utf-8") as file:
            unit = file.read()
        start = re.search(r"^ExecStart=(\S+) --config (\S+)$", unit, re.M)
        self.assertTrue(os.access(self.path(start.group(1).lstrip("/")), os.X_OK))
        self.assertTrue(os.path.exists(self.path(start.group(2).lstrip("/"))))


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
