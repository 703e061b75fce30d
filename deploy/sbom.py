#!/usr/bin/env python3
"""Writes the bill of materials of a folder of packages (SPDX 2.3, JSON): each package with its checksum and its files, and the
Debian packages that it was linked with or needs, in the versions of this machine.

    sbom.py FOLDER [LIBRARIES]   writes FOLDER/horopter-VERSION.spdx.json
      LIBRARIES: what the operator's page holds, one a line: NAME VERSION LICENCE
"""
import datetime
import glob
import hashlib
import json
import os
import re
import subprocess
import sys


def run(*command):
    return subprocess.run(command, check=True, capture_output=True, text=True, env=dict(os.environ, LC_ALL="C")).stdout


def sha256(path):
    with open(path, "rb") as file:
        return hashlib.sha256(file.read()).hexdigest()


def read_lines(path):
    """[] where there is no page."""
    if not os.path.exists(path):
        return []
    with open(path, encoding="utf-8") as file:
        return file.read().splitlines()


def identifier(text):
    return "SPDXRef-" + re.sub(r"[^A-Za-z0-9.-]", "-", text)


def package(name, version, licence, **more):
    return dict({"SPDXID": identifier(name), "name": name, "versionInfo": version, "downloadLocation": "NOASSERTION",
                 "licenseConcluded": licence, "licenseDeclared": licence, "copyrightText": "NOASSERTION",
                 "filesAnalyzed": False}, **more)


def installed(name):
    """(version, source) of an installed Debian package; None: it is not installed."""
    done = subprocess.run(["dpkg-query", "-W", "-f=${Version}\\t${source:Package}", name], capture_output=True, text=True, check=False)
    return tuple(done.stdout.split("\t")) if done.returncode == 0 and "\t" in done.stdout else None


def needs(deb):
    """Names of the Debian packages that it depends on, without alternatives and bounds."""
    words = run("dpkg-deb", "-f", deb, "Depends").replace("\n", " ").split(",")
    return [re.split(r"[\s:(|]", word.strip())[0] for word in words if word.strip()]


def main():
    folder = sys.argv[1]
    debs = sorted(glob.glob(os.path.join(folder, "*.deb")))
    wheels = sorted(glob.glob(os.path.join(folder, "*.whl")))
    if not debs:
        sys.exit("sbom.py: %s holds no packages" % folder)
    version = run("dpkg-deb", "-f", debs[0], "Version").strip()
    ours = {run("dpkg-deb", "-f", deb, "Package").strip(): deb for deb in debs}
    packages, relations, others = [], [], {}

    def relate(one, what, other):
        relations.append({"spdxElementId": one, "relationshipType": what, "relatedSpdxElement": other})

    for name, deb in sorted(ours.items()):
        packages.append(package(name, version, "Apache-2.0", supplier="Organization: The Horopter authors",
                                packageFileName=os.path.basename(deb),
                                checksums=[{"algorithm": "SHA256", "checksumValue": sha256(deb)}]))
        relate("SPDXRef-DOCUMENT", "DESCRIBES", identifier(name))
        for needed in needs(deb):
            if needed not in ours:
                others[needed] = installed(needed)
            relate(identifier(name), "DEPENDS_ON", identifier(needed))
    for wheel in wheels:
        name = os.path.basename(wheel)
        packages.append(package(name, version, "Apache-2.0", packageFileName=name,
                                checksums=[{"algorithm": "SHA256", "checksumValue": sha256(wheel)}]))
        relate("SPDXRef-DOCUMENT", "DESCRIBES", identifier(name))
    # Compiled in from headers.
    for header in ("libeigen3-dev", "libcli11-dev", "nlohmann-json3-dev"):
        others[header] = installed(header)
        for name in ("horopter-server", "horopter-client", "horopter-console"):
            if name in ours:
                relate(identifier(name), "CONTAINS" if header != "libeigen3-dev" else "STATIC_LINK", identifier(header))
    for line in read_lines(sys.argv[2]) if len(sys.argv) > 2 else []:
        name, of, licence = line.split(" ", 2)
        packages.append(package("npm-" + name, of, licence, externalRefs=[{
            "referenceCategory": "PACKAGE-MANAGER", "referenceType": "purl",
            "referenceLocator": "pkg:npm/%s@%s" % (name.replace("@", "%40"), of)}]))
        relate(identifier("horopter-console"), "CONTAINS", identifier("npm-" + name))
    for name, found in sorted(others.items()):
        told = {} if found is None else {"externalRefs": [{
            "referenceCategory": "PACKAGE-MANAGER", "referenceType": "purl",
            "referenceLocator": "pkg:deb/debian/%s@%s?distro=bookworm" % (name, found[0])}], "sourceInfo": "source " + found[1]}
        packages.append(package(name, "NOASSERTION" if found is None else found[0], "NOASSERTION", **told))
    when = int(os.environ.get("SOURCE_DATE_EPOCH", "0"))
    document = {
        "spdxVersion": "SPDX-2.3", "dataLicense": "CC0-1.0", "SPDXID": "SPDXRef-DOCUMENT", "name": "horopter-" + version,
        "documentNamespace": "urn:horopter:sbom:" + hashlib.sha256("".join(map(sha256, debs)).encode()).hexdigest(),
        "creationInfo": {"created": datetime.datetime.fromtimestamp(when, datetime.timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ"),
                         "creators": ["Organization: The Horopter authors", "Tool: deploy/sbom.py"]},
        "packages": packages, "relationships": relations}
    with open(os.path.join(folder, "horopter-%s.spdx.json" % version), "w", encoding="utf-8") as out:
        json.dump(document, out, indent=1, sort_keys=True)
        out.write("\n")


if __name__ == "__main__":
    main()
