#!/usr/bin/env python3
"""Writes the changelog of the Debian packages: the changes of this version, as CHANGELOG.md has them, compressed.

    debian_changelog.py CHANGELOG.md VERSION DEBIAN_VERSION MAINTAINER OUT.gz
    debian_changelog.py --section CHANGELOG.md VERSION         prints the version's section as it is

The section is `## VERSION ...`; without one, the one that is not released yet. The date is SOURCE_DATE_EPOCH.
"""
import email.utils
import gzip
import os
import re
import sys
import textwrap
import time


def section_of(text, version):
    """The lines below the version's heading, without blank ones at the ends."""
    sections = re.split(r"^## +", text, flags=re.M)[1:]
    for name in (re.escape(version), "Unreleased"):
        for section in sections:
            heading, _, body = section.partition("\n")
            if re.match(r"\[?" + name + r"\]?(\s|$)", heading):
                return body.strip("\n")
    raise SystemExit("debian_changelog.py: the changelog has no section for %s" % version)


def entries_of(section):
    """The items of its lists, each on one line, without marks of Markdown."""
    items = []
    for line in section.splitlines():
        if line.startswith("- "):
            items.append(line[2:])
        elif line.startswith("  ") and items:
            items[-1] += " " + line.strip()
    plain = [re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", item).replace("`", "").replace("**", "") for item in items]
    return plain or ["See CHANGELOG.md."]


def main():
    if sys.argv[1:2] == ["--section"]:
        with open(sys.argv[2], encoding="utf-8") as file:
            print(section_of(file.read(), sys.argv[3]))
        return
    path, version, debian_version, maintainer, out = sys.argv[1:6]
    with open(path, encoding="utf-8") as file:
        entries = entries_of(section_of(file.read(), version))
    lines = ["horopter (%s) unstable; urgency=medium" % debian_version, ""]
    for entry in entries:
        lines += textwrap.wrap(entry, 76, initial_indent="  * ", subsequent_indent="    ", break_long_words=False,
                               break_on_hyphens=False)
    when = int(os.environ.get("SOURCE_DATE_EPOCH", time.time()))
    lines += ["", " -- %s  %s" % (maintainer, email.utils.formatdate(when, localtime=False).replace("-0000", "+0000")), ""]
    with open(out, "wb") as raw, gzip.GzipFile(filename="", mode="wb", fileobj=raw, compresslevel=9, mtime=0) as file:
        file.write("\n".join(lines).encode())


if __name__ == "__main__":
    main()
