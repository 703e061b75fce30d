#!/usr/bin/env python3
"""Checks what is in the packages of a folder: each has its terms, nothing but what belongs there, no path of the machine that built it.

    check_contents.py FOLDER
"""
import glob
import os
import re
import subprocess
import sys
import tempfile
import zipfile

# Package -> patterns of all its files.
BELONGS = {
    "horopter-server": (r"/usr/bin/horopterd", r"/usr/libexec/horopter/horopter-cad-reader", r"/etc/horopter/horopterd\.toml", r"/etc/logrotate\.d/horopter-server",
                        r"/lib/systemd/system/horopterd\.service", r"/usr/share/man/man8/horopterd\.8\.gz",
                        r"/usr/share/horopter/deploy/credentials\.sh",
                        r"/usr/share/doc/horopter-server/[A-Za-z]+\.(md|json|yml)(\.gz)?"),
    "horopter-client": (r"/usr/bin/horopter", r"/usr/share/man/man1/horopter\.1\.gz", r"/usr/share/bash-completion/completions/horopter"),
    "horopter-console": (r"/usr/bin/horopter-console", r"/etc/horopter/horopter-console\.toml", r"/lib/systemd/system/horopter-console\.service",
                         r"/usr/share/horopter/console/(assets/[A-Za-z0-9_-]+\.(js|css)|index\.html|icon\.svg|(licences|libraries)\.txt)",
                         r"/usr/share/doc/horopter-console/console\.md(\.gz)?"),
    "horopter-dev": (r"/usr/lib/(?:[^/]+/)?horopter/lib[a-z_]+\.a", r"/usr/lib/(?:[^/]+/)?cmake/horopter_client/[A-Za-z_-]+\.cmake",
                     r"/usr/include/horopter_client/.*\.h", r"/usr/share/horopter/proto/horopter/v1/[a-z]+\.proto",
                     r"/usr/share/doc/horopter-dev/example/(CMakeLists\.txt|pick\.cc)"),
    "python3-horopter": (r"/usr/lib/python3/dist-packages/horopter/(v1/)?[a-z0-9_]+\.(py|pyi|typed)",
                         r"/usr/lib/python3/dist-packages/horopter/py\.typed", r"/usr/share/doc/python3-horopter/examples/[a-z_]+\.py"),
    "horopter-demo": (r"/usr/bin/horopter-demo", r"/usr/share/horopter/deploy/(demo\.sh|demo_verdict\.py)",
                      r"/usr/share/horopter/tests/data/(README\.md|parts/.*\.(png|jpg|json|step|ply))"),
}
PAPERS = ("copyright", "NOTICE(.gz)?", "changelog.gz")


def run(*command):
    return subprocess.run(command, check=True, capture_output=True).stdout


def check(deb, source):
    name = run("dpkg-deb", "-f", deb, "Package").decode().strip()
    wrong = []
    with tempfile.TemporaryDirectory() as folder:
        run("dpkg-deb", "-x", deb, folder)
        files = ["/" + os.path.relpath(os.path.join(where, f), folder) for where, _, names in os.walk(folder) for f in names]
        papers = "/usr/share/doc/%s/" % name
        for paper in PAPERS:
            if not any(re.fullmatch(papers + paper, f) for f in files):
                wrong.append("%s has no %s" % (name, paper))
        allowed = BELONGS[name] + tuple(papers + paper for paper in PAPERS)
        for f in files:
            if not any(re.fullmatch(pattern, f) for pattern in allowed):
                wrong.append("%s: %s does not belong there" % (name, f))
            path = os.path.join(folder, f.lstrip("/"))
            if os.path.islink(path):
                continue
            with open(path, "rb") as file:
                if source.encode() + b"/" in file.read():
                    wrong.append("%s: %s names the folder it was built in" % (name, f))
        for where, folders, _ in os.walk(folder):
            wrong += ["%s: %s may be written by others" % (name, d) for d in folders
                      if os.stat(os.path.join(where, d)).st_mode & 0o022]
    print("%-18s %4d files" % (name, len(files)))
    return name, wrong


def main():
    source = os.path.realpath(os.path.join(os.path.dirname(os.path.abspath(__file__)), ".."))
    found, wrong = set(), []
    for deb in sorted(glob.glob(os.path.join(sys.argv[1], "*.deb"))):
        name, of_deb = check(deb, source)
        found.add(name)
        wrong += of_deb
    wrong += ["there is no package %s" % name for name in sorted(set(BELONGS) - found)]
    for wheel in glob.glob(os.path.join(sys.argv[1], "*.whl")):
        names = zipfile.ZipFile(wheel).namelist()
        wrong += ["the wheel has no " + paper for paper in ("LICENSE", "NOTICE") if not any(n.endswith("/" + paper) for n in names)]
    for line in wrong:
        print(line, file=sys.stderr)
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
