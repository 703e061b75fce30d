#!/usr/bin/env python3
"""Makes a Python wheel of the built package, without a network and with the same bytes each time.

    wheel.py PACKAGE_FOLDER OUT_FOLDER      PACKAGE_FOLDER holds horopter/ and pyproject.toml (build/PRESET/client/python)

Dates are SOURCE_DATE_EPOCH.
"""
import base64
import hashlib
import os
import sys
import time
import tomllib
import zipfile

ROOT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..")
WHEEL = "Wheel-Version: 1.0\nGenerator: horopter\nRoot-Is-Purelib: true\nTag: py3-none-any\n"


def metadata_of(project):
    lines = ["Metadata-Version: 2.1", "Name: " + project["name"], "Version: " + project["version"],
             "Summary: " + project["description"], "License: " + project["license"]["text"],
             "Requires-Python: " + project["requires-python"]]
    return "\n".join(lines + ["Requires-Dist: " + needed for needed in project["dependencies"]]) + "\n"


def files_of(folder, packages):
    """Name in the wheel -> bytes."""
    found = {}
    for package in packages:
        directory = package.replace(".", "/")
        for name in os.listdir(os.path.join(folder, directory)):
            if name.endswith((".py", ".pyi", ".typed")):
                with open(os.path.join(folder, directory, name), "rb") as file:
                    found["%s/%s" % (directory, name)] = file.read()
    return found


def digest(data):
    return "sha256=" + base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()


def main():
    folder, out = sys.argv[1:3]
    with open(os.path.join(folder, "pyproject.toml"), "rb") as file:
        pyproject = tomllib.load(file)
    project = pyproject["project"]
    stem = "%s-%s" % (project["name"], project["version"])
    files = files_of(folder, pyproject["tool"]["setuptools"]["packages"])
    if "horopter/v1/recognition_pb2.py" not in files:
        sys.exit("wheel.py: %s holds no generated messages: build horopter_python first" % folder)
    info = stem + ".dist-info/"
    files[info + "METADATA"] = metadata_of(project).encode()
    files[info + "WHEEL"] = WHEEL.encode()
    for name in ("LICENSE", "NOTICE"):
        with open(os.path.join(ROOT, name), "rb") as file:
            files[info + name] = file.read()
    record = "".join("%s,%s,%d\n" % (name, digest(files[name]), len(files[name])) for name in sorted(files))
    files[info + "RECORD"] = (record + info + "RECORD,,\n").encode()
    when = time.gmtime(max(int(os.environ.get("SOURCE_DATE_EPOCH", time.time())), 315532800))[:6]  # zip begins in 1980
    with zipfile.ZipFile(os.path.join(out, stem + "-py3-none-any.whl"), "w", zipfile.ZIP_DEFLATED, compresslevel=9) as wheel:
        # RECORD last, as the format advises.
        for name in sorted(files, key=lambda n: (n.endswith("RECORD"), n)):
            entry = zipfile.ZipInfo(name, when)
            entry.external_attr = 0o100644 << 16
            entry.compress_type = zipfile.ZIP_DEFLATED
            wheel.writestr(entry, files[name])


if __name__ == "__main__":
    main()
