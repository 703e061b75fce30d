#!/usr/bin/env python3
"""Makes a page of the sources into one of a package: what it shows or links to and no package installs is left out, its words stay.

    package_page.py PAGE.md OUT.md      PAGE.md relative to the sources' root
"""
import os
import re
import sys

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
# Of the sources -> as installed, from the folder of one package's papers (deploy/install.cmake).
INSTALLED = {
    "README.md": "../horopter-server/README.md",
    "CHANGELOG.md": "../horopter-server/CHANGELOG.md",
    "NOTICE": "../horopter-server/NOTICE",
    "LICENSE": "/usr/share/common-licenses/Apache-2.0",
    "docs/cell.md": "../horopter-server/cell.md",
    "docs/operations.md": "../horopter-server/operations.md",
    "docs/console.md": "../horopter-console/console.md",
    "proto/README.md": "../horopter-server/api.md",
    "client/example": "../horopter-dev/example",
    "client/python/examples/draw_answer.py": "../python3-horopter/examples/draw_answer.py",
    "client/python/examples/first_part.py": "../python3-horopter/examples/first_part.py",
}


def page(name, text):
    here = os.path.dirname(name)

    def link(found):
        image, words, target = found.groups()
        path, _, mark = target.partition("#")
        if re.match(r"[a-z]+://", target) or not path:
            return found.group()
        installed = INSTALLED.get(os.path.normpath(os.path.join(here, path)))
        if image or installed is None:
            return "" if image else words
        return "[%s](%s%s)" % (words, installed, "#" + mark if mark else "")

    # A picture goes with its caption.
    text = re.sub(r"(!\[[^\]]*\]\([^)\s]+\)\n\n)\*.*\*\n", r"\1", text)
    text = re.sub(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)", link, text)
    return re.sub(r"\n{3,}", "\n\n", text)


def main():
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    _, name, out = sys.argv
    with open(os.path.join(ROOT, name), encoding="utf-8") as file:
        text = page(name, file.read())
    os.makedirs(os.path.dirname(out) or ".", exist_ok=True)
    with open(out, "w", encoding="utf-8") as file:
        file.write(text)


if __name__ == "__main__":
    main()
