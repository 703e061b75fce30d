#!/usr/bin/env python3
"""The pages: what they link to is there, what they call is there, the first of them stays short."""
import os
import re
import subprocess
import unittest

ROOT = os.path.abspath(os.path.join(os.path.dirname(__file__), "..", ".."))
LINK = re.compile(r"\]\(([^)\s]+)\)")
# Diaries and decisions stay as they were written.
KEPT = ("docs/history/", "server/adr/", "tests/bench/history/")


def pages():
    listed = subprocess.run(["git", "-C", ROOT, "ls-files", "*.md"], capture_output=True, text=True, check=False)
    return listed.stdout.split() if listed.returncode == 0 else []


def read(path):
    with open(os.path.join(ROOT, path), encoding="utf-8") as file:
        return file.read()


def anchors(text):
    """Of the headings, as the hosts of repositories make them."""
    headings = re.findall(r"^#+ +(.*)$", text, flags=re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


class Pages(unittest.TestCase):

    def setUp(self):
        self.pages = pages()
        if not self.pages:
            self.skipTest("no git")

    def test_links_lead_somewhere(self):
        wrong, seen = [], 0
        for page in self.pages:
            for link in LINK.findall(read(page)):
                if re.match(r"[a-z]+:", link):
                    continue
                seen += 1
                path, _, anchor = link.partition("#")
                target = os.path.normpath(os.path.join(os.path.dirname(page), path)) if path else page
                if not os.path.exists(os.path.join(ROOT, target)):
                    wrong.append("%s: %s" % (page, link))
                elif anchor and anchor not in anchors(read(target)):
                    wrong.append("%s: %s has no such heading" % (page, link))
        self.assertEqual(wrong, [])
        self.assertGreater(seen, 50)

    def test_scripts_that_pages_call_are_there(self):
        wrong = []
        for page in self.pages:
            if page.startswith(KEPT):
                continue
            for script in re.findall(r"(?<![\w/])((?:deploy|tests|docs)/[\w/.-]+\.(?:sh|py|txt|cmake))\b", read(page)):
                if not os.path.exists(os.path.join(ROOT, script)):
                    wrong.append("%s: %s" % (page, script))
        self.assertEqual(wrong, [])

    def test_the_readme_is_read_in_minutes(self):
        self.assertLessEqual(len(read("README.md").split()), 900)


if __name__ == "__main__":
    unittest.main()
